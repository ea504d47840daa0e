"""Bring-up and disabling of a MyActuator RMD motor.

Bring-up reads (nothing moves): angle, errors, speed, and the ramp of the position planning. A moving motor is stopped
(81). The ramp brakes the joint when the motor receives nothing more, so it must be the one that the arm file asks for;
it is written (43) only if it differs, because it goes to the motor's ROM. Then the motor gets its own position as its
target, at one degree a second, and a brake that it reports as locked is released (77).

Errors that end by themselves are waited for, over a few readings, if the operator has asked to clear them. The others
(stall, over-current, lost parameters, the encoder's) end with a restart only (V4.2 and V4.3, 8). The operator's
`rtarm clear-fault` is taken as a request for that too: the motor holds nothing then anyway.

The communication timeout (B3) is not used. It cuts the motor's output (V4.2, 2.30), so a joint without a brake would
fall, also after an orderly end of the control process; and it cannot be read. Without it, silence means a stop along
the ramp.

The last thing read is the uptime (B1), by which a motor that was silent proves that it had power: the uptime began
before the mark was given, and has grown since as the clock did.
"""

import math
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from config.drives.myactuator import RAMP_RANGE_DPS_S, REPLY, REQUEST, MyactuatorDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import myactuator_protocol as protocol
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import error_words
from rtloop.drives.numbers import NO_VALUES, Values, packed, unpacked
from rtloop.drives.setup import (
    CLEAR_OR_START,
    ERROR_AT_START,
    SAME_PLACE_RAD,
    Found,
    Host,
    PowerHost,
    ReferencingHost,
    settle_mark,
)
from rtloop.drives.steps import answered, unanswered, written
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, silent_amid
from rtloop.service.port import Frame
from shm.words import Unreferenced

CREEP_DPS = 1
ENABLED_BY_A_TARGET = True
"""A motor that lost its power has no torque until its first target, so no target is sent to it without a request."""
RESTART_S = 5.0
"""Timeout of a restart, which takes 1.1 s."""
CLOCK_TOLERANCE = 0.0158
"""Largest relative deviation of a motor's clock that CAN's specification (2.0, oscillator tolerance) allows."""
UPTIME_STEP_MS = 1.0
UPTIME_ROUND_MS = 1 << 32
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Uptime(NamedTuple):
    """A motor's uptime (B1, ms), when it was asked for and when the answer came (ns), and the boot of this machine."""

    boot: str
    ms: int
    asked_ns: int
    heard_ns: int

    @classmethod
    def of_mark(cls, mark: str | None) -> "Uptime | None":
        """The uptime that was stored as a mark; None if `mark` is none."""
        try:
            boot, *numbers = (mark or "").split()
            return cls(boot, *map(int, numbers))
        except (ValueError, TypeError):
            return None

    @property
    def mark(self) -> str:
        """This uptime as a mark to be stored."""
        return " ".join(map(str, self))

    def goes_on_from(self, before: "Uptime") -> bool:
        """Whether the uptime has grown by the time since `before`; it starts anew with the power or at 49.7 days."""
        return self.least_ms_since(before) <= self.ms - before.ms <= self.most_ms_since(before)

    def proves_power_since(self, before: "Uptime") -> bool:
        """Whether the uptime shows that the motor started before `before`, and did not lose its power since."""
        return self.boot == before.boot and self.goes_on_from(before) and self.ms > self.most_ms_since(before)

    def began_since(self, before: "Uptime") -> bool:
        """Whether the motor has surely restarted since `before`.

        That is so if its uptime has grown too little, is no longer than the time since, and cannot have wrapped around.
        """
        most_ms = self.most_ms_since(before)
        behind = self.ms - before.ms < self.least_ms_since(before)
        return self.boot == before.boot and behind and self.ms <= most_ms and before.ms + most_ms < UPTIME_ROUND_MS

    def least_ms_since(self, before: "Uptime") -> float:
        """The least time since `before` by a motor's clock (ms)."""
        return (self.asked_ns - before.heard_ns) * 1e-6 * (1.0 - CLOCK_TOLERANCE) - UPTIME_STEP_MS

    def most_ms_since(self, before: "Uptime") -> float:
        """The longest time since `before` by a motor's clock (ms)."""
        return (self.heard_ns - before.asked_ns) * 1e-6 * (1.0 + CLOCK_TOLERANCE) + UPTIME_STEP_MS


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a motor for the cycle; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["silence_deceleration_rad_s2"] = math.radians(ramp_dps_s(joint, arm)) / joint.ratio
    if drive.nm_per_ampere is not None:
        row["effort_per_unit"] = joint.direction * joint.ratio * drive.nm_per_ampere / protocol.STEPS_PER_AMPERE


def ramp_dps_s(joint: JointConfig, arm: ArmConfig) -> int:
    """The ramp along which a motor brakes when it receives nothing more (degrees/s² of its output shaft)."""
    wanted = joint.max_acceleration_rad_s2 * arm.limits.silence_brake_factor * joint.ratio
    return min(max(round(math.degrees(wanted)), RAMP_RANGE_DPS_S[0]), RAMP_RANGE_DPS_S[1])


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    if (yield asked(drive, protocol.ANGLE)) is None:
        rate = f"the bit rate ({host.arm.bus_of(config).bitrate} bit/s; motors come with 1000000)"
        raise unanswered(joint, config, f"motor_id {drive.motor_id}", f"its ID and {rate}")
    restarted = yield from _without_errors(host, joint)
    if host.heals and not (yield from kept_power(host, joint)):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not prove that it had power all the time, and the target that it would "
            "be told enables one that had not, which nobody has asked for: see whether it holds, then `rtarm "
            "clear-fault`, which enables it where it stands.",
        )
    yield from _at_rest(joint, config)
    yield from _with_its_ramp(host, joint)
    held = yield from _angle(joint, config)
    here: Values = {protocol.TARGET_SPEED_DPS: CREEP_DPS, protocol.TARGET_ANGLE: held}
    yield from _answered(joint, config, protocol.TARGET, "target", here)
    status = yield from _answered(joint, config, protocol.STATUS, "status")
    if unpacked(status, protocol.BRAKE_RELEASED) == 0:  # or it has no brake
        yield from _answered(joint, config, protocol.RELEASE_BRAKE, "brake")
    reading = yield from _angle(joint, config)
    reason = Unreferenced.POWER_LOST if restarted else Unreferenced.INCREMENTAL
    # The last question, so that it covers everything that was read before.
    up = yield from _agreed_uptime(host, joint)
    if drive.knows_its_angle:
        host.marks[joint] = up.mark if up else None
        return Found(reading, held)
    before = Uptime.of_mark(host.marks.known(joint))
    if up is not None and before is not None and up.began_since(before):
        reason = Unreferenced.POWER_LOST
    kept = settle_mark(host, joint, _proves(up, host.marks[joint]), up.mark if up else None)
    return Found(reading, held, reason, kept)


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """See `rtloop.drives.setup.PowerProof.kept_power`."""
    return _proves((yield from _agreed_uptime(host, joint)), host.marks[joint])


def place(host: ReferencingHost, joint: int, angle_rad: float) -> Dialogue:
    """See `rtloop.drives.setup.Places.place`; the mark is renewed, because it must not be older than the angle."""
    if not host.arm.joints[joint].drive.knows_its_angle:
        up = yield from _agreed_uptime(host, joint)
        host.marks[joint] = up.mark if up else None
    host.count_as_read(joint, angle_rad)


def _proves(up: Uptime | None, mark: str | None) -> bool:
    before = Uptime.of_mark(mark)
    return up is not None and before is not None and up.proves_power_since(before)


def _agreed_uptime(host: PowerHost, joint: int) -> Part[Uptime | None]:
    """The motor's uptime, confirmed by two readings in a row, as one alone may be garbled; else None."""
    before = None
    for _ in range(TRIES):
        found = yield from _uptime(host, joint)
        if found is None or (before is not None and found.goes_on_from(before)):
            return found
        before = found
    return None


def _uptime(host: PowerHost, joint: int) -> Part[Uptime | None]:
    """Read the motor's uptime once; None if it does not answer."""
    asked_ns = host.now_ns + suspended_ns()
    answer = yield asked(_drive(host.arm.joints[joint]), protocol.UPTIME)
    if answer is None:
        return None
    ms = unpacked(answer.data, protocol.UPTIME_MS)
    return Uptime(BOOT_ID.read_text().strip(), ms, asked_ns, host.now_ns + suspended_ns())


def suspended_ns() -> int:
    """How long this machine was suspended since it booted: the clock of `now_ns` stood still while motors ran on."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Shut the motor down, which it acknowledges; raises DialogueFailed."""
    config = arm.joints[joint]
    if (yield asked(_drive(config), protocol.SHUTDOWN)) is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not say that it has let go: keep clear of the arm, check its power and "
            "the CAN wires, then `rtarm clear-fault`, which brings all drives up again.",
        )


def _without_errors(host: Host, joint: int) -> Part[bool]:
    """Check that the motor has no error, restarting it if need be; whether it was restarted. Raises DialogueFailed."""
    config = host.arm.joints[joint]
    error = yield from _error(joint, config)
    if not error:
        return False
    words, restarts = error_words(error, protocol.ERRORS), bool(error & protocol.NEEDS_RESTART)
    if not host.clears_protection:
        ends = ", which ends with a restart of the drive only," if restarts else ""
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has an error ({words}){ends} and holds nothing: remove the "
            f"cause, {ERROR_AT_START}.",
        )
    if restarts:
        host.tell(f"{config.name}: its drive is restarted, because its error ({words}) ends with that only.")
        yield say(_frame(_drive(config), protocol.RESET))
        began_ns = host.now_ns
        while (yield asked(_drive(config), protocol.ANGLE)) is None:
            if host.now_ns - began_ns > RESTART_S * 1e9:
                raise DialogueFailed(joint, silent_amid(config, "restart"))
    for _ in range(TRIES):
        error = yield from _error(joint, config)
        if not error:
            return restarts
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} keeps its error ({error_words(error, protocol.ERRORS)})"
        f"{' after a restart' if restarts else ''}, so what caused it is still there: remove it, then `rtarm "
        "clear-fault`.",
    )


def _at_rest(joint: int, config: JointConfig) -> Part[None]:
    """Stop the motor if it moves; raises DialogueFailed."""
    for _ in range(TRIES * TRIES):
        feedback = yield from _answered(joint, config, protocol.FEEDBACK, "speed")
        if unpacked(feedback, protocol.SPEED) == 0:
            return
        yield from _answered(joint, config, protocol.STOP, "stop")
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} turns and does not stop: end what leads or moves it, {CLEAR_OR_START}.",
    )


def _with_its_ramp(host: Host, joint: int) -> Part[None]:
    """Check the ramps of the motor's position planning, and write those that differ; raises DialogueFailed."""
    config = host.arm.joints[joint]
    wanted = ramp_dps_s(config, host.arm)
    up = yield from with_ramp(joint, config, *protocol.RAMPS[0], wanted)
    down = yield from with_ramp(joint, config, *protocol.RAMPS[1], wanted)
    if up != wanted or down != wanted:
        host.tell(
            f"{config.name}: the ramp of its drive was {up} °/s² up and {down} °/s² down, and is {wanted} °/s² now; "
            "its ROM keeps that."
        )


def with_ramp(joint: int, config: JointConfig, index: int, name: str, wanted: int) -> Part[int]:
    """Write a ramp where it is another one; what it was before (degrees/s²). Raises DialogueFailed."""
    before = found = yield from _ramp(joint, config, index, name)
    ramp: Values = {protocol.RAMP_INDEX: index, protocol.RAMP_DPS_S: wanted}
    if found != wanted:
        found = yield from written(
            lambda: _answered(joint, config, protocol.WRITE_RAMP, name, ramp),
            lambda: _ramp(joint, config, index, name),
            lambda found: found == wanted,
        )
    if found != wanted:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take {wanted} °/s² as the {name} of its position planning (it "
            f"stays at {found}): set it with the maker's program, {CLEAR_OR_START}.",
        )
    return before


def _drive(config: JointConfig) -> MyactuatorDrive:
    assert isinstance(config.drive, MyactuatorDrive)
    return config.drive


def _frame(drive: MyactuatorDrive, command: int, values: Values = NO_VALUES) -> Frame:
    return Frame(REQUEST + drive.motor_id, packed({protocol.COMMAND: command, **values}), kind=STANDARD)


def asked(drive: MyactuatorDrive, command: int, values: Values = NO_VALUES) -> AskFrames:
    """A command whose answer begins with the same byte, and for a ramp with the same index too."""
    request = _frame(drive, command, values)
    same = 2 if command in (protocol.READ_RAMP, protocol.WRITE_RAMP) else 1

    def is_answer(frame: Frame) -> bool:
        whose = frame.id == REPLY + drive.motor_id
        return whose and len(frame.data) == 8 and frame.data[:same] == request.data[:same]

    return AskFrames((request,), is_answer)


def _answered(joint: int, config: JointConfig, command: int, what: str, values: Values = NO_VALUES) -> Part[bytes]:
    """The data of the answer to a command; raises DialogueFailed if there is none."""
    return bytes((yield from answered(joint, config, asked(_drive(config), command, values), what)).data)


def _angle(joint: int, config: JointConfig) -> Part[int]:
    """Angle of the output shaft (0.01°), read twice in a row, to become a target; raises DialogueFailed."""

    def read() -> Part[int]:
        return unpacked((yield from _answered(joint, config, protocol.ANGLE, "position")), protocol.READ_ANGLE)

    return (yield from confirmed(read, math.degrees(SAME_PLACE_RAD) * config.ratio * protocol.STEPS_PER_DEGREE))


def _error(joint: int, config: JointConfig) -> Part[int]:
    """Read the error word; raises DialogueFailed."""
    return unpacked((yield from _answered(joint, config, protocol.STATUS, "status")), protocol.ERROR)


def _ramp(joint: int, config: JointConfig, index: int, name: str) -> Part[int]:
    """Read a ramp of the position planning (degrees/s²); raises DialogueFailed."""
    return unpacked(
        (yield from _answered(joint, config, protocol.READ_RAMP, name, {protocol.RAMP_INDEX: index})),
        protocol.RAMP_DPS_S,
    )
