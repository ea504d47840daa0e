"""Bring-up and disabling of a Damiao motor; `rtloop.drives.damiao` describes its frames.

Bring-up reads, with frames that move nothing: the feedback with the motor's status; the ranges of its fields, without
which no position means anything; its mode, its ramp and its alarm time. Where one of the last three differs, it is
written to volatile memory and read back. Then the motor is enabled, with a command to stay where it stands right before
and right after that, so that no old target counts. A motor that was enabled already gets that command alone. In mode
mit the torque that it produces at that moment is taken for that of its stiffness, so that a load does not sag.

The ramp (ACC, DEC) is written in rad/s² of the output shaft, as the makers' manuals define it. The one firmware whose
source was read (umeow0716/damiao_firmware, app/src/motor_control.c) moves at KP_APR / GR × the distance to its target,
and takes ACC and DEC as rad/s of the rotor per millisecond. To this firmware the manuals' numbers are no ramp at all;
what brakes a joint in silence is then the shrinking distance. Numbers for this firmware would be a hundredth of the
ramp to the others (GR / 1000), which would run far past their targets. So the manuals' number is safe with both; motors
with this firmware lag behind their setpoints (docs/hardware/drive-families.md has the figures).

The alarm time (register 9) switches the motor's torque off when no command comes for so long, and the arm falls. A
request for feedback does not count as a command (as far as is known), so the torque would go before the first goal.
Without an alarm time a motor that receives nothing more keeps its last target, which is a stop. So the alarm time is
set to 0, until the power is lost.
"""

import math
import struct
from typing import NamedTuple

import numpy as np

from config.drives.damiao import (
    HIGHEST_KD,
    HIGHEST_KP,
    POSITION_STEPS,
    POSITION_VELOCITY_OFFSET,
    REGISTERS_ID,
    DamiaoDrive,
    Ranges,
)
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.arming import Arming, stayed_armed
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import ErrorCode, code_words
from rtloop.drives.fields import field, of_field
from rtloop.drives.setup import SAME_PLACE_RAD, Found, Host, PowerHost
from rtloop.drives.steps import answered, let_go, unanswered, without_error, written
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from shm.words import Unreferenced

READ, WRITE, STORE, FEEDBACK = 0x33, 0x55, 0xAA, 0xCC
"""Operations of frames on 7FF."""
CLEAR_ERROR, ENABLE, DISABLE = 0xFB, 0xFC, 0xFD
"""Last byte of a command whose other bytes are FF."""

LIMP, ENABLED = 0, 1
ERRORS = (
    ErrorCode(0xF, 8, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorCode(0xF, 9, "under-voltage", status_bits.UNDER_VOLTAGE),
    ErrorCode(0xF, 10, "over-current", status_bits.OVER_CURRENT),
    ErrorCode(0xF, 11, "power stage too hot", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xF, 12, "motor too hot", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xF, 13, "communication lost", status_bits.COMMUNICATION),
    ErrorCode(0xF, 14, "overload", status_bits.OVER_CURRENT),
)
"""Status codes of the feedback; every other than these two and those is an error without a name."""

ACC, DEC, TIMEOUT, CONTROL_MODE, PMAX, VMAX, TMAX = 4, 5, 9, 10, 21, 22, 23
"""Registers (table of damiao-motor 1.0.6): ramps (rad/s², negative for braking), alarm time, mode, ranges."""
TIMEOUT_UNIT_S = 50e-6
MODES = {"mit": 1, "position_velocity": 2}
RANGES = ((PMAX, "PMAX", "position", "rad"), (VMAX, "VMAX", "velocity", "rad/s"), (TMAX, "TMAX", "torque", "N·m"))
RANGE_FIELDS = ("position_range_rad", "velocity_range_rad_s", "torque_range_nm")
SAME = 1e-4
"""Relative difference below which two values of a register are the same one, rounded (12.566 is 4π)."""
STANDING_STEPS = 2
"""A motor that reports no more steps of velocity than these is at rest."""


class Feedback(NamedTuple):
    """What a motor reports: status code, position (rad), velocity (rad/s) and torque (N·m) of its shaft."""

    code: int
    rad: float
    rad_s: float
    nm: float


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a Damiao motor for the cycle; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["command_per_rad"] = row["reading_per_rad"] = joint.direction * joint.ratio
    row["effort_per_unit"] = joint.direction * joint.ratio
    row["range_rad"], row["range_rad_s"], row["range_nm"] = drive.ranges
    row["stiffness_nm_rad"], row["damping_nm_s_rad"] = drive.kp or 0.0, drive.kd or 0.0
    row["plans_its_motion"] = drive.plans_its_motion
    row["knows_its_angle"] = joint.knows_its_angle


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    found = yield from _sound(host, joint)
    yield from _check_ranges(joint, config)
    _require_within_its_field(joint, config, found.rad)
    yield from _set_up(host, joint, enabled=found.code == ENABLED)
    arming = Arming(host, joint, lambda: _is_enabled(config))
    for _ in range(TRIES):
        found = yield from _confirmed_feedback(joint, config)
        stay = _stay(config, found, host.arm.limits.following_error_rad * config.ratio)
        if (yield from arming.found(found.code == ENABLED)):
            yield say(stay)
        else:
            arming.begins()
            yield say(stay, _command(drive, ENABLE), stay)
        found = yield from _confirmed_feedback(joint, config)
        if found.code == ENABLED:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not let itself be enabled (its status is {status_words(found.code)}): "
            "see what it says in the maker's tool, remove the cause, then `rtarm clear-fault`, or `rtarm up` where "
            "it has ended.",
        )
    held_rad = _held_rad(config, found, host.arm.limits.following_error_rad * config.ratio)
    if config.knows_its_angle:
        return Found(found.rad, held_rad)
    return Found(found.rad, held_rad, Unreferenced.INCREMENTAL, kept_power=(yield from arming.kept_power()))


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """See `rtloop.drives.setup.PowerProof.kept_power`."""
    return (yield from stayed_armed(host, joint, lambda: _is_enabled(host.arm.joints[joint])))


def _is_enabled(config: JointConfig) -> Part[bool | None]:
    """Whether the motor is enabled; None if it does not answer."""
    answer = yield _asked(config)
    return None if answer is None else feedback_of(answer.data, _drive(config).ranges).code == ENABLED


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Disable the motor, and check that it is disabled; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        yield say(_command(_drive(config), DISABLE))
        return "stays enabled" if (yield from _feedback(joint, config)).code == ENABLED else ""

    yield from let_go(joint, config, told, "switch the drive off, then on")


def status_words(code: int) -> str:
    """A status code in words."""
    return code_words(code, ERRORS) or {LIMP: "limp", ENABLED: "enabled"}.get(code, f"{code:#x}")


def feedback_of(data: bytes, ranges: Ranges) -> Feedback:
    """Decode 8 bytes of feedback."""
    packed = int.from_bytes(data, "big")
    return Feedback(
        data[0] >> 4,
        of_field(packed >> 40 & 0xFFFF, ranges.rad, 16),
        of_field(packed >> 28 & 0xFFF, ranges.rad_s, 12),
        of_field(packed >> 16 & 0xFFF, ranges.nm, 12),
    )


def setpoint_bytes(drive: DamiaoDrive, rad: float) -> bytes:
    """Data of a command of mode mit to stand at a position (rad, of the motor's shaft)."""
    ranges, kp, kd = drive.ranges, drive.kp or 0.0, drive.kd or 0.0
    packed = field(rad, ranges.rad, 16) << 48 | field(0.0, ranges.rad_s, 12) << 36
    packed |= field(2.0 * kp - HIGHEST_KP, HIGHEST_KP, 12) << 24 | field(2.0 * kd - HIGHEST_KD, HIGHEST_KD, 12) << 12
    return (packed | field(0.0, ranges.nm, 12)).to_bytes(8, "big")


def _drive(config: JointConfig) -> DamiaoDrive:
    assert isinstance(config.drive, DamiaoDrive)
    return config.drive


def _command(drive: DamiaoDrive, last: int) -> Frame:
    return Frame(drive.motor_id, b"\xff" * 7 + bytes([last]), kind=STANDARD)


def _stay(config: JointConfig, found: Feedback, most_rad: float) -> Frame:
    """The command to hold the present position; see `_held_rad`."""
    drive = _drive(config)
    rad = _held_rad(config, found, most_rad)
    if drive.mode == "mit":
        return Frame(drive.motor_id, setpoint_bytes(drive, rad), kind=STANDARD)
    rad_s = ERROR_SPEED_SHARE * config.max_velocity_rad_s * config.ratio
    return Frame(drive.motor_id + POSITION_VELOCITY_OFFSET, struct.pack("<ff", rad, rad_s), kind=STANDARD)


def _held_rad(config: JointConfig, found: Feedback, most_rad: float) -> float:
    """The target that an enabled motor in mode mit holds (rad of its shaft), at most `most_rad` from its position.

    Its stiffness acts like a spring: the torque tells how far the motor is from its target. In other cases, and for a
    motor that moves, it is the position.
    """
    drive = _drive(config)
    stands = abs(found.rad_s) <= STANDING_STEPS * 2.0 * drive.ranges.rad_s / 0xFFF
    if drive.kp is None or found.code != ENABLED or not stands:
        return found.rad
    return found.rad + min(max(found.nm / drive.kp, -most_rad), most_rad)


def _confirmed_feedback(joint: int, config: JointConfig) -> Part[Feedback]:
    """The motor's feedback with a position that was read twice in a row, to become a target; raises DialogueFailed."""
    return (
        yield from confirmed(
            lambda: _feedback(joint, config), SAME_PLACE_RAD * config.ratio, place=lambda found: found.rad
        )
    )


def _asked(config: JointConfig) -> AskFrames:
    """The request for a motor's feedback, which comes on its master ID with its own ID in the lowest bits."""
    drive = _drive(config)
    request = Frame(REGISTERS_ID, struct.pack("<HBB4x", drive.motor_id, FEEDBACK, 0), kind=STANDARD)
    return AskFrames((request,), lambda frame: is_feedback(drive, frame.data))


def is_feedback(drive: DamiaoDrive, data: bytes) -> bool:
    """Whether a frame on a motor's master ID is its feedback; see `rtloop.drives.damiao.tells_a_register`."""
    return len(data) == 8 and data[0] & 15 == drive.motor_id and not _tells_register(drive, data)


def _tells_register(drive: DamiaoDrive, data: bytes) -> bool:
    return data[:2] == struct.pack("<H", drive.motor_id) and data[2] in (READ, WRITE, STORE)


def _feedback(joint: int, config: JointConfig) -> Part[Feedback]:
    """Read the motor's feedback; raises DialogueFailed."""
    answer = yield from answered(joint, config, _asked(config), "feedback")
    return feedback_of(answer.data, _drive(config).ranges)


def _sound(host: Host, joint: int) -> Part[Feedback]:
    """Check that the motor answers and has no error; raises DialogueFailed.

    An error is cleared if the operator has asked for that.
    """
    config = host.arm.joints[joint]
    drive = _drive(config)
    answer = yield _asked(config)
    if answer is None:
        raise unanswered(
            joint,
            config,
            f"motor_id {drive.motor_id:#x}",
            "its ESC_ID and MST_ID (registers 8 and 7, in the maker's tool), its bit rate "
            f"({host.arm.bus.bitrate} bit/s, register 35)",
            f" on its master_id {drive.master_id:#x}",
        )

    def cleared() -> Part[Feedback]:
        yield say(_command(drive, CLEAR_ERROR))
        return (yield from _feedback(joint, config))

    return (
        yield from without_error(
            host,
            joint,
            feedback_of(answer.data, drive.ranges),
            lambda found: "" if found.code in (LIMP, ENABLED) else status_words(found.code),
            cleared,
            find="remove that",
        )
    )


def _check_ranges(joint: int, config: JointConfig) -> Part[None]:
    """Check that the fields of the motor's frames have the ranges that the arm file states; raises DialogueFailed."""
    drive = _drive(config)
    for (register, name, what, unit), field_name, expected in zip(RANGES, RANGE_FIELDS, drive.ranges, strict=True):
        value = yield from _read_float(joint, config, register)
        if math.isclose(value, expected, rel_tol=SAME):
            continue
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} says that its {what} range is ±{value:g} {unit} (register {register}, "
            f"{name}), but the arm file ±{expected:g}, so every {what} would be taken for another: set model or "
            f"{field_name} of {config.name} to what the motor has, or the register to {expected:g} with the maker's "
            "tool.",
        )


def _require_within_its_field(joint: int, config: JointConfig, rad: float) -> None:
    """Refuse a motor that reports an end of its position field; raises DialogueFailed.

    The motor may stand beyond that end, and a command to stay would move it.
    """
    most = _drive(config).ranges.rad
    if abs(rad) < most * (1.0 - 1.0 / POSITION_STEPS):
        return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} stands at or beyond an end of what its frames reach (±{most:g} rad of its shaft), "
        "so nobody knows where, and it would be moved if it were told to stay: turn the joint back by hand while the "
        "drive is off, or set its zero with the maker's tool, then `rtarm clear-fault`, or `rtarm up` where it has "
        "ended.",
    )


def _set_up(host: Host, joint: int, *, enabled: bool) -> Part[None]:
    """Set mode, ramp and alarm time in volatile memory where they differ, and report it; raises DialogueFailed."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    done: list[str] = []
    mode = yield from _read_whole(joint, config, CONTROL_MODE)
    if mode != MODES[drive.mode]:
        if enabled:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} is enabled in mode {mode} (register {CONTROL_MODE}), but the arm file "
                f"wants {MODES[drive.mode]} ({drive.mode}), and which target would count after a change is not known: "
                "support the arm, switch the drive off, then on, and `rtarm clear-fault`, or `rtarm up` where it has "
                "ended; or set mode in the arm file to what it is.",
            )
        yield from _write(joint, config, CONTROL_MODE, struct.pack("<I", MODES[drive.mode]))
        done.append(f"its mode from {mode} to {MODES[drive.mode]} ({drive.mode}, register {CONTROL_MODE})")
    if drive.plans_its_motion:
        ramp = config.max_acceleration_rad_s2 * host.arm.limits.silence_brake_factor * config.ratio
        for register, name, wanted in ((ACC, "acceleration", ramp), (DEC, "deceleration", -ramp)):
            value = yield from _read_float(joint, config, register)
            if not math.isclose(value, wanted, rel_tol=SAME):
                yield from _write(joint, config, register, struct.pack("<f", wanted))
                done.append(f"its {name} from {value:g} to {wanted:g} rad/s² (register {register})")
    timeout = yield from _read_whole(joint, config, TIMEOUT)
    if timeout:
        yield from _write(joint, config, TIMEOUT, bytes(4))
        done.append(
            f"its alarm time from {timeout * TIMEOUT_UNIT_S * 1e3:g} ms to none (register {TIMEOUT}: it would let go "
            "of the joint when it hears nothing for so long; without it the motor stays where it was told)"
        )
    if done:
        host.tell(f"The drive of {config.name} was set up until it loses its power: {', '.join(done)}.")


def _read(joint: int, config: JointConfig, register: int) -> Part[bytes]:
    """The four bytes of a register; raises DialogueFailed."""
    drive = _drive(config)
    request = Frame(REGISTERS_ID, struct.pack("<HBB4x", drive.motor_id, READ, register), kind=STANDARD)
    expected = request.data[:4]
    question = AskFrames((request,), lambda frame: len(frame.data) == 8 and frame.data[:4] == expected)
    return bytes((yield from answered(joint, config, question, f"register {register}")).data[4:])


def _read_float(joint: int, config: JointConfig, register: int) -> Part[float]:
    data = yield from _read(joint, config, register)
    return float(struct.unpack("<f", data)[0])


def _read_whole(joint: int, config: JointConfig, register: int) -> Part[int]:
    data = yield from _read(joint, config, register)
    return int.from_bytes(data, "little")


def _write(joint: int, config: JointConfig, register: int, value: bytes) -> Part[None]:
    """Write a register in volatile memory and read it back; raises DialogueFailed."""
    head = struct.pack("<HBB", _drive(config).motor_id, WRITE, register)

    def write() -> Dialogue:
        yield say(Frame(REGISTERS_ID, head + value, kind=STANDARD))

    found = yield from written(write, lambda: _read(joint, config, register), lambda found: found == value)
    if found == value:
        return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} keeps register {register} at {found.hex(' ')} although {value.hex(' ')} was "
        "written: set it with the maker's tool, then `rtarm clear-fault`, or `rtarm up` where it has ended.",
    )
