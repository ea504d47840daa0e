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
from rtloop.drives import damiao_protocol as protocol
from rtloop.drives.arming import Arming, stayed_armed
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.damiao_protocol import Register
from rtloop.drives.errors import code_words
from rtloop.drives.fields import field, of_field
from rtloop.drives.numbers import NO_VALUES, Values, packed, unpacked
from rtloop.drives.setup import CLEAR_OR_START, SAME_PLACE_RAD, Found, Host, PowerHost
from rtloop.drives.steps import answered, let_go, unanswered, without_error, written
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from shm.words import Unreferenced

RANGES = (
    (protocol.PMAX, "PMAX", "position", "rad"),
    (protocol.VMAX, "VMAX", "velocity", "rad/s"),
    (protocol.TMAX, "TMAX", "torque", "N·m"),
)
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
    yield from _set_up(host, joint, enabled=found.code == protocol.ENABLED)
    arming = Arming(host, joint, lambda: _is_enabled(config))
    for _ in range(TRIES):
        found = yield from _confirmed_feedback(joint, config)
        stay = _stay(config, found, host.arm.limits.following_error_rad * config.ratio)
        if (yield from arming.found(found.code == protocol.ENABLED)):
            yield say(stay)
        else:
            arming.begins()
            yield say(stay, _command(drive, protocol.ENABLE), stay)
        found = yield from _confirmed_feedback(joint, config)
        if found.code == protocol.ENABLED:
            break
    else:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not let itself be enabled (its status is {status_words(found.code)}): "
            f"see what it says in the maker's tool, remove the cause, {CLEAR_OR_START}.",
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
    answer = yield asked_feedback(config)
    return None if answer is None else feedback_of(answer.data, _drive(config).ranges).code == protocol.ENABLED


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Disable the motor, and check that it is disabled; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        yield say(_command(_drive(config), protocol.DISABLE))
        return "stays enabled" if (yield from _feedback(joint, config)).code == protocol.ENABLED else ""

    yield from let_go(joint, config, told, "switch the drive off, then on")


def status_words(code: int) -> str:
    """A status code in words."""
    states = {protocol.LIMP: "limp", protocol.ENABLED: "enabled"}
    return code_words(code, protocol.ERRORS) or states.get(code, f"{code:#x}")


def feedback_of(data: bytes, ranges: Ranges) -> Feedback:
    """Decode 8 bytes of feedback."""
    told = ((protocol.TOLD_PLACE, ranges.rad), (protocol.TOLD_SPEED, ranges.rad_s), (protocol.TOLD_TORQUE, ranges.nm))
    return Feedback(
        unpacked(data, protocol.CODE), *(of_field(unpacked(data, where), most, where.size) for where, most in told)
    )


def setpoint_bytes(drive: DamiaoDrive, rad: float) -> bytes:
    """Data of a command of mode mit to stand at a position (rad, of the motor's shaft)."""
    ranges, kp, kd = drive.ranges, drive.kp or 0.0, drive.kd or 0.0
    fields = (
        (protocol.PLACE, rad, ranges.rad),
        (protocol.SPEED, 0.0, ranges.rad_s),
        (protocol.STIFFNESS, 2.0 * kp - HIGHEST_KP, HIGHEST_KP),
        (protocol.DAMPING, 2.0 * kd - HIGHEST_KD, HIGHEST_KD),
        (protocol.TORQUE, 0.0, ranges.nm),
    )
    return packed({where: field(value, most, where.size) for where, value, most in fields})


def _drive(config: JointConfig) -> DamiaoDrive:
    assert isinstance(config.drive, DamiaoDrive)
    return config.drive


def _command(drive: DamiaoDrive, data: bytes) -> Frame:
    return Frame(drive.motor_id, data, kind=STANDARD)


def _stay(config: JointConfig, found: Feedback, most_rad: float) -> Frame:
    """The command to hold the present position; see `_held_rad`."""
    drive = _drive(config)
    rad = _held_rad(config, found, most_rad)
    if drive.mode == "mit":
        return Frame(drive.motor_id, setpoint_bytes(drive, rad), kind=STANDARD)
    rad_s = ERROR_SPEED_SHARE * config.max_velocity_rad_s * config.ratio
    return Frame(
        drive.motor_id + POSITION_VELOCITY_OFFSET,
        packed({protocol.TARGET: rad, protocol.HIGHEST_SPEED: rad_s}),
        kind=STANDARD,
    )


def _held_rad(config: JointConfig, found: Feedback, most_rad: float) -> float:
    """The target that an enabled motor in mode mit holds (rad of its shaft), at most `most_rad` from its position.

    Its stiffness acts like a spring: the torque tells how far the motor is from its target. In other cases, and for a
    motor that moves, it is the position.
    """
    drive = _drive(config)
    stands = abs(found.rad_s) <= STANDING_STEPS * 2.0 * drive.ranges.rad_s / 0xFFF
    if drive.kp is None or found.code != protocol.ENABLED or not stands:
        return found.rad
    return found.rad + min(max(found.nm / drive.kp, -most_rad), most_rad)


def _confirmed_feedback(joint: int, config: JointConfig) -> Part[Feedback]:
    """The motor's feedback with a position that was read twice in a row, to become a target; raises DialogueFailed."""
    return (
        yield from confirmed(
            lambda: _feedback(joint, config), SAME_PLACE_RAD * config.ratio, place=lambda found: found.rad
        )
    )


def asked_feedback(config: JointConfig) -> AskFrames:
    """The request for a motor's feedback, which comes on its master ID with its own ID in the lowest bits."""
    drive = _drive(config)
    return AskFrames((registers(drive, protocol.FEEDBACK),), lambda frame: is_feedback(drive, frame.data))


def is_feedback(drive: DamiaoDrive, data: bytes) -> bool:
    """Whether a frame on a motor's master ID is its feedback; see `rtloop.drives.damiao.tells_a_register`."""
    return len(data) == 8 and unpacked(data, protocol.MOTOR) == drive.motor_id and not _tells_register(drive, data)


def _tells_register(drive: DamiaoDrive, data: bytes) -> bool:
    said_of = unpacked(data, protocol.OPERATION) in (protocol.READ, protocol.WRITE, protocol.STORE)
    return said_of and unpacked(data, protocol.OWNER) == drive.motor_id


def _feedback(joint: int, config: JointConfig) -> Part[Feedback]:
    """Read the motor's feedback; raises DialogueFailed."""
    answer = yield from answered(joint, config, asked_feedback(config), "feedback")
    return feedback_of(answer.data, _drive(config).ranges)


def _sound(host: Host, joint: int) -> Part[Feedback]:
    """Check that the motor answers and has no error; raises DialogueFailed.

    An error is cleared if the operator has asked for that.
    """
    config = host.arm.joints[joint]
    drive = _drive(config)
    answer = yield asked_feedback(config)
    if answer is None:
        raise unanswered(
            joint,
            config,
            f"motor_id {drive.motor_id:#x}",
            "its ESC_ID and MST_ID (registers 8 and 7, in the maker's tool), its bit rate "
            f"({host.arm.bus_of(config).bitrate} bit/s, register 35)",
            f" on its master_id {drive.master_id:#x}",
        )

    def cleared() -> Part[Feedback]:
        yield say(_command(drive, protocol.CLEAR_ERROR))
        return (yield from _feedback(joint, config))

    return (
        yield from without_error(
            host,
            joint,
            feedback_of(answer.data, drive.ranges),
            lambda found: "" if found.code in (protocol.LIMP, protocol.ENABLED) else status_words(found.code),
            cleared,
            find="remove that",
        )
    )


def _check_ranges(joint: int, config: JointConfig) -> Part[None]:
    """Check that the fields of the motor's frames have the ranges that the arm file states; raises DialogueFailed."""
    drive = _drive(config)
    for (register, name, what, unit), field_name, expected in zip(RANGES, RANGE_FIELDS, drive.ranges, strict=True):
        value = yield from read_register(joint, config, register)
        if math.isclose(value, expected, rel_tol=SAME):
            continue
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} says that its {what} range is ±{value:g} {unit} ({register}, "
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
        f"drive is off, or set its zero with the maker's tool, {CLEAR_OR_START}.",
    )


def _set_up(host: Host, joint: int, *, enabled: bool) -> Part[None]:
    """Set mode, ramp and alarm time in volatile memory where they differ, and report it; raises DialogueFailed."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    done: list[str] = []
    mode = yield from read_register(joint, config, protocol.CONTROL_MODE)
    wanted_mode = protocol.MODES[drive.mode]
    if mode != wanted_mode:
        if enabled:
            raise DialogueFailed(
                joint,
                f"The drive of {config.name} is enabled in mode {mode} ({protocol.CONTROL_MODE}), but the arm file "
                f"wants {wanted_mode} ({drive.mode}), and which target would count after a change is not known: "
                "support the arm, switch the drive off, then on, and `rtarm clear-fault`, or `rtarm up` where it has "
                "ended; or set mode in the arm file to what it is.",
            )
        yield from write_register(joint, config, protocol.CONTROL_MODE, wanted_mode)
        done.append(f"its mode from {mode} to {wanted_mode} ({drive.mode}, {protocol.CONTROL_MODE})")
    if drive.plans_its_motion:
        ramp = config.max_acceleration_rad_s2 * host.arm.limits.silence_brake_factor * config.ratio
        for register, name, wanted in ((protocol.ACC, "acceleration", ramp), (protocol.DEC, "deceleration", -ramp)):
            value = yield from read_register(joint, config, register)
            if not math.isclose(value, wanted, rel_tol=SAME):
                yield from write_register(joint, config, register, wanted)
                done.append(f"its {name} from {value:g} to {wanted:g} rad/s² ({register})")
    timeout = yield from read_register(joint, config, protocol.TIMEOUT)
    if timeout:
        yield from write_register(joint, config, protocol.TIMEOUT, 0)
        done.append(
            f"its alarm time from {timeout * protocol.TIMEOUT_UNIT_S * 1e3:g} ms to none ({protocol.TIMEOUT}: it would "
            "let go of the joint when it hears nothing for so long; without it the motor stays where it was told)"
        )
    if done:
        host.tell(f"The drive of {config.name} was set up until it loses its power: {', '.join(done)}.")


def registers(drive: DamiaoDrive, operation: int, values: Values = NO_VALUES) -> Frame:
    """A frame on 7FF."""
    said = {protocol.OWNER: drive.motor_id, protocol.OPERATION: operation, **values}
    return Frame(REGISTERS_ID, packed(said), kind=STANDARD)


def read_register(joint: int, config: JointConfig, register: Register) -> Part[float]:
    """The value of a register; raises DialogueFailed."""
    return unpacked((yield from _told_of(joint, config, register)), register.value)


def _told_of(joint: int, config: JointConfig, register: Register) -> Part[bytes]:
    """The data of a motor's answer about a register; raises DialogueFailed."""
    request = registers(_drive(config), protocol.READ, {protocol.REGISTER: register.number})
    expected = request.data[:4]
    question = AskFrames((request,), lambda frame: len(frame.data) == 8 and frame.data[:4] == expected)
    return bytes((yield from answered(joint, config, question, str(register))).data)


def write_register(joint: int, config: JointConfig, register: Register, value: float) -> Part[None]:
    """Write a register in volatile memory and read it back; raises DialogueFailed."""
    values: Values = {protocol.REGISTER: register.number, register.value: value}
    request = registers(_drive(config), protocol.WRITE, values)

    def write() -> Dialogue:
        yield say(request)

    wanted = request.data[4:]
    found = yield from written(write, lambda: _told_of(joint, config, register), lambda found: found[4:] == wanted)
    if found[4:] == wanted:
        return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} keeps {register} at {found[4:].hex(' ')} although "
        f"{wanted.hex(' ')} was written: set it with the maker's tool, {CLEAR_OR_START}.",
    )
