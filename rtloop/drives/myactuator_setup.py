"""Bring-up and release of a MyActuator RMD motor; what its frames are is said in `rtloop.drives.myactuator`.

What it is asked (nothing moves): its angle, its errors, how fast it is, and the ramp of its position planning. One that
is on its way is stopped (81). The ramp is written (43) only where it is another one, since that goes to its ROM; it is
what brakes the joint when the motor hears nothing more, so it must be the one that the arm file asks for. Then the
motor gets where it stands as its target, at one degree a second, and a brake that it says is locked is released (77).

Errors that end by themselves are waited for; the others (stall, over-current, lost parameters, the encoder's) end with
a restart only (V4.2 and V4.3, 8), for which a person's `rtarm clear-fault` is taken: the motor holds nothing then
anyway.

The communication timeout (B3) is not used: it cuts the motor's output (V4.2, 2.30), so a joint without a brake falls,
when a control process ends orderly too; nor can it be read. Silence is a stop on the ramp without it.

Its last answer is its uptime (B1), by which a motor that was silent proves that it had power: it began before its mark
was given, and went on since as the clock did.
"""

import math
import struct
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from config.drives.myactuator import RAMP_DPS_S, REPLY, REQUEST, MyactuatorDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import ErrorBit, error_words
from rtloop.drives.setup import (
    ERROR_AT_START,
    SAME_PLACE_RAD,
    Found,
    Host,
    PowerHost,
    ReferencingHost,
    settle_mark,
)
from rtloop.drives.steps import answered, unanswered, written
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part, silent_amid
from rtloop.service.port import Frame
from shm.words import Unreferenced

READ_RAMP, WRITE_RAMP, RESET, RELEASE_BRAKE = 0x42, 0x43, 0x76, 0x77
SHUTDOWN, STOP, ANGLE, STATUS, FEEDBACK = 0x80, 0x81, 0x92, 0x9A, 0x9C
TARGET, UPTIME = 0xA4, 0xB1
RAMPS = ((0, "acceleration"), (1, "deceleration"))
"""Indexes of 42 and 43: those of position planning."""
ERRORS = (
    ErrorBit(0x0002, "stall", status_bits.STALLED),
    ErrorBit(0x0004, "low voltage", status_bits.UNDER_VOLTAGE),
    ErrorBit(0x0008, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorBit(0x0010, "over-current", status_bits.OVER_CURRENT),
    ErrorBit(0x0040, "power", status_bits.OVER_CURRENT),  # the current that it takes from its supply
    ErrorBit(0x0080, "lost parameters"),
    ErrorBit(0x0100, "over-speed"),
    ErrorBit(0x0800, "over-temperature of its board", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x1000, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x2000, "encoder calibration", status_bits.ENCODER),
    ErrorBit(0x4000, "encoder data", status_bits.ENCODER),
)
"""Bits of the status' error word (V4.3)."""
NEEDS_RESTART = 0x0002 | 0x0010 | 0x0080 | 0x2000 | 0x4000
CREEP_DPS = 1
ENABLED_BY_A_TARGET = True
"""A motor that has lost its power is limp until its first target, so that one is not sent to it unasked."""
RESTART_S = 5.0
"""Patience with a restart, which takes 1.1 s."""
HUNDREDTHS = 100.0
CLOCK_TOLERANCE = 0.0158
"""Of a motor's clock beside ours: CAN's specification (2.0, oscillator tolerance) lets none be further off."""
UPTIME_STEP_MS = 1.0
UPTIME_ROUND_MS = 1 << 32
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Uptime(NamedTuple):
    """What a motor said of its uptime (B1), and between which times of this boot of this machine."""

    boot: str
    ms: int
    asked_ns: int
    heard_ns: int

    @classmethod
    def of_mark(cls, mark: str | None) -> "Uptime | None":
        """What was kept as a mark, if it is one."""
        try:
            boot, *numbers = (mark or "").split()
            return cls(boot, *map(int, numbers))
        except (ValueError, TypeError):
            return None

    @property
    def mark(self) -> str:
        """The same to be kept."""
        return " ".join(map(str, self))

    def goes_on_from(self, before: "Uptime") -> bool:
        """Whether it has grown by the time since, without having begun anew, which it also does after 49.7 days."""
        return self.least_ms_since(before) <= self.ms - before.ms <= self.most_ms_since(before)

    def proves_power_since(self, before: "Uptime") -> bool:
        """Whether it has gone on since: the motor began before that, not after a loss of power since."""
        return self.boot == before.boot and self.goes_on_from(before) and self.ms > self.most_ms_since(before)

    def began_since(self, before: "Uptime") -> bool:
        """Whether the motor has surely begun anew since: its uptime is behind, no longer than that, and not round."""
        most_ms = self.most_ms_since(before)
        behind = self.ms - before.ms < self.least_ms_since(before)
        return self.boot == before.boot and behind and self.ms <= most_ms and before.ms + most_ms < UPTIME_ROUND_MS

    def least_ms_since(self, before: "Uptime") -> float:
        """What a motor's clock makes of the time since at least (ms)."""
        return (self.asked_ns - before.heard_ns) * 1e-6 * (1.0 - CLOCK_TOLERANCE) - UPTIME_STEP_MS

    def most_ms_since(self, before: "Uptime") -> float:
        """What a motor's clock makes of the time since at most (ms)."""
        return (self.heard_ns - before.asked_ns) * 1e-6 * (1.0 + CLOCK_TOLERANCE) + UPTIME_STEP_MS


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """What the cycle needs of a motor; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["silence_deceleration_rad_s2"] = math.radians(ramp_dps_s(joint, arm)) / joint.ratio
    if drive.nm_per_ampere is not None:
        row["effort_per_unit"] = joint.direction * joint.ratio * drive.nm_per_ampere / HUNDREDTHS


def ramp_dps_s(joint: JointConfig, arm: ArmConfig) -> int:
    """The ramp with which a motor brakes in silence (degrees/s² of its output shaft)."""
    wanted = joint.max_acceleration_rad_s2 * arm.limits.silence_brake_factor * joint.ratio
    return min(max(round(math.degrees(wanted)), RAMP_DPS_S[0]), RAMP_DPS_S[1])


def bring_up(host: Host, joint: int) -> Part[Found]:
    """What `rtloop.drives.setup.Setup` says; see the head of this file."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    if (yield _asked(drive, ANGLE)) is None:
        rate = f"the bit rate ({host.arm.bus.bitrate} bit/s; motors come with 1000000)"
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
    yield from _answered(joint, config, TARGET, "target", struct.pack("<xHi", CREEP_DPS, held))
    status = yield from _answered(joint, config, STATUS, "status")
    if status[3] == 0:  # or it has no brake
        yield from _answered(joint, config, RELEASE_BRAKE, "brake")
    reading = yield from _angle(joint, config)
    reason = Unreferenced.POWER_LOST if restarted else Unreferenced.INCREMENTAL
    # The last question, so that it speaks for all that was read before.
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
    """What `rtloop.drives.setup.PowerProof` says."""
    return _proves((yield from _agreed_uptime(host, joint)), host.marks[joint])


def place(host: ReferencingHost, joint: int, angle_rad: float) -> Dialogue:
    """What `rtloop.drives.setup.Places` says: its mark is renewed, which must not be older than the angle."""
    if not host.arm.joints[joint].drive.knows_its_angle:
        up = yield from _agreed_uptime(host, joint)
        host.marks[joint] = up.mark if up else None
    host.count_as_read(joint, angle_rad)


def _proves(up: Uptime | None, mark: str | None) -> bool:
    before = Uptime.of_mark(mark)
    return up is not None and before is not None and up.proves_power_since(before)


def _agreed_uptime(host: PowerHost, joint: int) -> Part[Uptime | None]:
    """The second of two that go on from each other, since one alone may be garbled; None where it tells none."""
    before = None
    for _ in range(TRIES):
        found = yield from _uptime(host, joint)
        if found is None or (before is not None and found.goes_on_from(before)):
            return found
        before = found
    return None


def _uptime(host: PowerHost, joint: int) -> Part[Uptime | None]:
    """What it says of its uptime; None where it does not."""
    asked_ns = host.now_ns + suspended_ns()
    answer = yield _asked(_drive(host.arm.joints[joint]), UPTIME)
    if answer is None:
        return None
    ms = int.from_bytes(answer.data[4:], "little")
    return Uptime(BOOT_ID.read_text().strip(), ms, asked_ns, host.now_ns + suspended_ns())


def suspended_ns() -> int:
    """For how long this machine was suspended since it booted: the clock of `now_ns` stood, and motors ran."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Shut the motor down, which says so; raises DialogueFailed."""
    config = arm.joints[joint]
    if (yield _asked(_drive(config), SHUTDOWN)) is None:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not say that it has let go: keep clear of the arm, check its power and "
            "the CAN wires, then `rtarm clear-fault`, which brings all drives up again.",
        )


def _without_errors(host: Host, joint: int) -> Part[bool]:
    """See that the motor has no error; whether it was restarted for that; raises DialogueFailed."""
    config = host.arm.joints[joint]
    error = yield from _error(joint, config)
    if not error:
        return False
    words, restarts = error_words(error, ERRORS), bool(error & NEEDS_RESTART)
    if not host.clears_protection:
        ends = ", which ends with a restart of the drive only," if restarts else ""
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} has an error ({words}){ends} and holds nothing: remove the "
            f"cause, {ERROR_AT_START}.",
        )
    if restarts:
        host.tell(f"{config.name}: its drive is restarted, because its error ({words}) ends with that only.")
        yield say(_frame(_drive(config), RESET))
        began_ns = host.now_ns
        while (yield _asked(_drive(config), ANGLE)) is None:
            if host.now_ns - began_ns > RESTART_S * 1e9:
                raise DialogueFailed(joint, silent_amid(config, "restart"))
    for _ in range(TRIES):
        error = yield from _error(joint, config)
        if not error:
            return restarts
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} keeps its error ({error_words(error, ERRORS)})"
        f"{' after a restart' if restarts else ''}, so what caused it is still there: remove it, then `rtarm "
        "clear-fault`.",
    )


def _at_rest(joint: int, config: JointConfig) -> Part[None]:
    """Stop a motor that is on its way; raises DialogueFailed."""
    for _ in range(TRIES * TRIES):
        feedback = yield from _answered(joint, config, FEEDBACK, "speed")
        if struct.unpack_from("<h", feedback, 4)[0] == 0:
            return
        yield from _answered(joint, config, STOP, "stop")
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} turns and does not stop: end what leads or moves it, then `rtarm clear-fault`, or "
        "`rtarm up` where it has ended.",
    )


def _with_its_ramp(host: Host, joint: int) -> Part[None]:
    """Have the motor brake in silence as the arm file says; raises DialogueFailed."""
    config = host.arm.joints[joint]
    wanted = ramp_dps_s(config, host.arm)
    up = yield from _with_ramp(joint, config, *RAMPS[0], wanted)
    down = yield from _with_ramp(joint, config, *RAMPS[1], wanted)
    if up != wanted or down != wanted:
        host.tell(
            f"{config.name}: the ramp of its drive was {up} °/s² up and {down} °/s² down, and is {wanted} °/s² now; "
            "its ROM keeps that."
        )


def _with_ramp(joint: int, config: JointConfig, index: int, name: str, wanted: int) -> Part[int]:
    """Write a ramp where it is another one; what it was before (degrees/s²). Raises DialogueFailed."""
    before = found = yield from _ramp(joint, config, index, name)
    if found != wanted:
        found = yield from written(
            lambda: _answered(joint, config, WRITE_RAMP, name, struct.pack("<BxxI", index, wanted)),
            lambda: _ramp(joint, config, index, name),
            lambda found: found == wanted,
        )
    if found != wanted:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take {wanted} °/s² as the {name} of its position planning (it "
            f"stays at {found}): set it with the maker's program, then `rtarm clear-fault`, or `rtarm up` where it "
            "has ended.",
        )
    return before


def _drive(config: JointConfig) -> MyactuatorDrive:
    assert isinstance(config.drive, MyactuatorDrive)
    return config.drive


def _frame(drive: MyactuatorDrive, command: int, data: bytes = b"") -> Frame:
    return Frame(REQUEST + drive.motor_id, bytes((command, *data)).ljust(8, b"\0"), kind=STANDARD)


def _asked(drive: MyactuatorDrive, command: int, data: bytes = b"") -> AskFrames:
    """A command, and its answer, which begins as it does."""
    request = _frame(drive, command, data)
    same = 2 if command in (READ_RAMP, WRITE_RAMP) else 1

    def is_answer(frame: Frame) -> bool:
        whose = frame.id == REPLY + drive.motor_id
        return whose and len(frame.data) == 8 and frame.data[:same] == request.data[:same]

    return AskFrames((request,), is_answer)


def _answered(joint: int, config: JointConfig, command: int, what: str, data: bytes = b"") -> Part[bytes]:
    """The data of the answer; raises DialogueFailed where there is none."""
    return bytes((yield from answered(joint, config, _asked(_drive(config), command, data), what)).data)


def _angle(joint: int, config: JointConfig) -> Part[int]:
    """Angle of its output shaft (0.01°), as it will be told to hold it; raises DialogueFailed."""

    def read() -> Part[int]:
        data = yield from _answered(joint, config, ANGLE, "position")
        return int(struct.unpack_from("<i", data, 4)[0])

    return (yield from confirmed(read, math.degrees(SAME_PLACE_RAD) * config.ratio * HUNDREDTHS))


def _error(joint: int, config: JointConfig) -> Part[int]:
    """The error word; raises DialogueFailed."""
    data = yield from _answered(joint, config, STATUS, "status")
    return int(struct.unpack_from("<H", data, 6)[0])


def _ramp(joint: int, config: JointConfig, index: int, name: str) -> Part[int]:
    """A ramp of its position planning (degrees/s²); raises DialogueFailed."""
    data = yield from _answered(joint, config, READ_RAMP, name, bytes((index,)))
    return int(struct.unpack_from("<I", data, 4)[0])
