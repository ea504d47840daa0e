"""Bring-up and disabling of a RobStride motor or CyberGear.

Bring-up reads (nothing moves) the state, by setting the target of the speed mode to 0, which is answered with the state
in every mode; then the run mode. A motor that runs in control mode is told to hold its position, because its last
command may have been to turn, or to have no torque; the torque that it produces at that moment is taken for that of its
stiffness, so that a load does not sag. A motor that runs in its position loop gets its position as its target. A motor
that stands beyond the range of its frames is left alone: a command to stay would move it to the end of that range.

A stopped motor gets its run mode and, before it is enabled, what it shall hold, because it would begin with its last
command: in control mode a set-point at its position, and the same again together with the enabling; with its own
position loop a target at its position, and a speed limit with which it would only creep, whatever its target is.
"""

import math
from typing import NamedTuple

import numpy as np

from config.drives.robstride import CONTROL, ENABLE, FIELD_STEPS, READ, STOP, TYPE_BIT, WRITE, RobstrideDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives import fields
from rtloop.drives import robstride_protocol as protocol
from rtloop.drives.arming import Arming, stayed_armed
from rtloop.drives.asking import AskFrames, confirmed, say
from rtloop.drives.errors import error_words
from rtloop.drives.numbers import NO_VALUES, Bits, Values, packed, unpacked, word
from rtloop.drives.setup import CLEAR_OR_START, SAME_PLACE_RAD, Found, Host, PowerHost
from rtloop.drives.steps import answered, let_go, unanswered, without_error, written
from rtloop.service.conversation import TRIES, Dialogue, DialogueFailed, Part
from rtloop.service.port import Frame
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from shm.words import Unreferenced

USUAL_POSITION_GAIN_1_S = 30.0
CREEP_RAD_S = 0.01
STANDING_RAD_S = 0.03
"""A motor that is not faster than this is at rest."""
ALIKE = 1e-4
"""Rounding error that a written parameter may have when it is read back."""


class State(NamedTuple):
    """Contents of a feedback's identifier."""

    mode: int
    faults: int

    @property
    def fault_words(self) -> str:
        """The faults in words."""
        return error_words(self.faults, protocol.FAULTS) if self.faults else ""


def fill(row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
    """Write the parameters of a motor for the cycle; see `rtloop.drives.setup.Setup`."""
    drive = _drive(joint)
    row["command_per_rad"] = row["reading_per_rad"] = row["effort_per_unit"] = joint.direction * joint.ratio
    row["host_id"] = drive.host_id
    row["range_rad"], row["range_rad_s"] = drive.position_range_rad, drive.velocity_range_rad_s
    row["range_nm"] = drive.torque_range_nm
    if drive.mode == "control":
        row["gains_word"] = word(packed(_gains(drive)))
    else:
        row["position_gain_1_s"] = position_gain_1_s(drive)
        row["silence_deceleration_rad_s2"] = math.inf


def position_gain_1_s(drive: RobstrideDrive) -> float:
    """Gain of the motor's own position loop (1/s)."""
    return USUAL_POSITION_GAIN_1_S if drive.position_gain_1_s is None else drive.position_gain_1_s


def bring_up(host: Host, joint: int) -> Part[Found]:
    """See `rtloop.drives.setup.Setup.bring_up` and the head of this file."""
    config = host.arm.joints[joint]
    drive = _drive(config)
    state = yield from _asked_how_it_is(drive)
    if state is None:
        rate = f"the bit rate ({host.arm.bus_of(config).bitrate} bit/s; RobStrides come with 1000000)"
        raise unanswered(joint, config, f"motor_id {drive.motor_id}", f"its ID and {rate}")
    state = yield from without_error(
        host,
        joint,
        state,
        lambda state: state.fault_words,
        lambda: _said(joint, config, _frame(drive, STOP, {protocol.CLEAR: 1})),
        called="fault",
    )
    arming = Arming(host, joint, lambda: _is_running(drive))
    if (yield from arming.found(state.mode == protocol.RUN)) != (state.mode == protocol.RUN):  # which was garbled
        state = yield from _asked_again(joint, config)
    if state.mode == protocol.RUN:
        yield from _refuse_another_run_mode(joint, config)
    for _ in range(TRIES):
        standing = held = yield from confirmed(lambda: _where_it_stands(joint, config), SAME_PLACE_RAD * config.ratio)
        _require_within_its_field(joint, config, standing)
        if state.mode != protocol.RUN:
            arming.begins()
            yield from _prepare(joint, config, standing)
            state = yield from _enabled(joint, config, standing)
        elif drive.mode == "control":
            held = yield from _hold_as_it_is(host, joint, standing)
        else:
            yield from _aim(joint, config, standing)
        if state.mode == protocol.RUN:
            break
    else:
        why = f"its faults are {state.fault_words}" if state.faults else f"its state is {state.mode}"
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not run after being enabled ({why}): calibrate its encoder with the "
            f"maker's program, {CLEAR_OR_START}.",
        )
    standing = yield from confirmed(lambda: _where_it_stands(joint, config), SAME_PLACE_RAD * config.ratio)
    if drive.mode != "control":
        hold_rad_s = ERROR_SPEED_SHARE * config.max_velocity_rad_s * config.ratio
        yield from _said(joint, config, _write(drive, protocol.SPEED_LIMIT, hold_rad_s))
        held = standing
    if drive.knows_its_angle:
        return Found(standing, held)
    return Found(standing, held, Unreferenced.INCREMENTAL, kept_power=(yield from arming.kept_power()))


def kept_power(host: PowerHost, joint: int) -> Part[bool]:
    """See `rtloop.drives.setup.PowerProof.kept_power`."""
    return (yield from stayed_armed(host, joint, lambda: _is_running(_drive(host.arm.joints[joint]))))


def _is_running(drive: RobstrideDrive) -> Part[bool | None]:
    """Whether the motor runs; None if it does not answer."""
    state = yield from _asked_how_it_is(drive)
    return None if state is None else state.mode == protocol.RUN


def disable(arm: ArmConfig, joint: int) -> Dialogue:
    """Stop the motor, which switches its torque off, and check that it does not run; raises DialogueFailed."""
    config = arm.joints[joint]

    def told() -> Part[str]:
        state = yield from _said(joint, config, _frame(_drive(config), STOP))
        return "keeps running" if state.mode == protocol.RUN else ""

    yield from let_go(joint, config, told, "switch the drive off")


def _refuse_another_run_mode(joint: int, config: JointConfig) -> Part[None]:
    """Refuse a motor that runs in another run mode, which could only be changed by letting the joint fall."""
    run_mode = unpacked((yield from read_parameter(joint, config, protocol.RUN_MODE, "run mode")), protocol.BYTE)
    wanted = protocol.RUN_MODES[_drive(config).mode]
    if run_mode != wanted:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} runs in run mode {run_mode}, but mode {_drive(config).mode} is run mode "
            f"{wanted}, which is set while it is stopped: end the program that leads it, support the arm, switch the "
            f"drive off and on, {CLEAR_OR_START}.",
        )


def _require_within_its_field(joint: int, config: JointConfig, rad: float) -> None:
    """Refuse a motor that stands beyond the position range of its frames; raises DialogueFailed."""
    most = _drive(config).position_range_rad
    if abs(rad) <= most:
        return
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} stands at {rad:+.3f} rad of its shaft, beyond what its frames reach "
        f"(±{most:.6g} rad), so it would be moved if it were told to stay: turn the joint back by hand while the drive "
        f"is off, or set its zero with the maker's program, {CLEAR_OR_START}.",
    )


def _hold_as_it_is(host: Host, joint: int, standing: float) -> Part[float]:
    """Command a motor that runs in control mode to hold its position with its present torque; raises DialogueFailed.

    Returns:
        The position that it is commanded to hold (rad of its shaft).
    """
    config = host.arm.joints[joint]
    drive = _drive(config)
    question = AskFrames((_write(drive, protocol.SPEED_TARGET, 0.0),), is_feedback)
    answer = yield from answered(joint, config, question, "state")
    speed, torque = unpacked(answer.data, protocol.SPEED), unpacked(answer.data, protocol.TORQUE)
    held = standing
    if abs(fields.of_field(speed, drive.velocity_range_rad_s, protocol.SPEED.size)) <= STANDING_RAD_S:
        assert drive.kp is not None
        most = host.arm.limits.following_error_rad * config.ratio
        held += min(max(fields.of_field(torque, drive.torque_range_nm, protocol.TORQUE.size) / drive.kp, -most), most)
    # round to the nearest step, not down: a motor that was holding already gets the same command again
    reach = drive.position_range_rad
    bits = protocol.PLACE.size
    held = fields.of_field(fields.field(held + reach / FIELD_STEPS, reach, bits), reach, bits)
    yield from _said(joint, config, _hold(drive, held))
    return held


def _prepare(joint: int, config: JointConfig, standing: float) -> Part[None]:
    """Give a stopped motor its run mode, and the position to hold once it is enabled; raises DialogueFailed."""
    drive = _drive(config)
    wanted = protocol.RUN_MODES[drive.mode]
    found = yield from written(
        lambda: _said(joint, config, _frame(drive, WRITE, {protocol.INDEX: protocol.RUN_MODE, protocol.BYTE: wanted})),
        lambda: read_parameter(joint, config, protocol.RUN_MODE, "run mode"),
        lambda found: unpacked(found, protocol.BYTE) == wanted,
    )
    if unpacked(found, protocol.BYTE) != wanted:
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take run mode {wanted} (it stays at "
            f"{unpacked(found, protocol.BYTE)}): mode position is for CyberGears, csp for RobStrides; "
            "mode control is known to both.",
        )
    if drive.mode == "control":
        yield say(_hold(drive, standing))  # a stopped motor need not answer it
    else:
        yield from _aim(joint, config, standing)


def _aim(joint: int, config: JointConfig, standing: float) -> Part[None]:
    """Set the motor's position loop to hold its position, with a creeping speed limit; raises DialogueFailed."""
    drive = _drive(config)
    wanted = {
        protocol.SPEED_LIMIT: CREEP_RAD_S,
        protocol.POSITION_GAIN: position_gain_1_s(drive),
        protocol.POSITION_TARGET: standing,
    }
    for index, value in wanted.items():
        yield from write_parameter(joint, config, index, value)


def write_parameter(joint: int, config: JointConfig, index: int, value: float) -> Part[None]:
    """Write a parameter and read it back; raises DialogueFailed if the motor does not take it."""

    def is_taken(has: float) -> bool:
        return math.isclose(has, value, rel_tol=ALIKE, abs_tol=ALIKE)

    has = yield from written(
        lambda: _said(joint, config, _write(_drive(config), index, value)),
        lambda: _number(joint, config, index, f"parameter {index:X}"),
        is_taken,
    )
    if not is_taken(has):
        raise DialogueFailed(
            joint,
            f"The drive of {config.name} does not take {value:.6g} as its parameter {index:X} (it has {has:.6g}): give "
            "the joint mode control, or look at its firmware.",
        )


def _enabled(joint: int, config: JointConfig, standing: float) -> Part[State]:
    """Enable the motor, in control mode together with its first set-point; its state after that."""
    drive = _drive(config)
    hold = (_hold(drive, standing),) if drive.mode == "control" else ()
    yield from _said(joint, config, _frame(drive, ENABLE), *hold)
    return (yield from _asked_again(joint, config))


def _drive(config: JointConfig) -> RobstrideDrive:
    assert isinstance(config.drive, RobstrideDrive)
    return config.drive


def _frame(drive: RobstrideDrive, kind: int, values: Values = NO_VALUES, data16: int | None = None) -> Frame:
    data16 = drive.host_id if data16 is None else data16
    return Frame(kind << TYPE_BIT | data16 << 8 | drive.motor_id, packed(values))


def _write(drive: RobstrideDrive, index: int, value: float) -> Frame:
    return _frame(drive, WRITE, {protocol.INDEX: index, protocol.VALUE: value})


def _gain(where: Bits, value: float, most: float) -> Values:
    """A number from 0 to `most` in a field."""
    return {where: fields.field(2.0 * value - most, most, where.size)}


def _gains(drive: RobstrideDrive) -> Values:
    assert drive.kp is not None and drive.kd is not None
    stiffness = _gain(protocol.STIFFNESS, drive.kp, drive.kp_range)
    return {**stiffness, **_gain(protocol.DAMPING, drive.kd, drive.kd_range)}


def _hold(drive: RobstrideDrive, standing: float) -> Frame:
    """A set-point at rest, without feed-forward torque."""
    place = fields.field(standing, drive.position_range_rad, protocol.PLACE.size)
    middle = FIELD_STEPS >> 1
    return _frame(drive, CONTROL, {protocol.PLACE: place, protocol.SPEED: middle, **_gains(drive)}, data16=middle)


def _said(joint: int, config: JointConfig, *frames: Frame) -> Part[State]:
    """Send frames that are answered with a feedback, and return its state; raises DialogueFailed without an answer."""
    return _state((yield from answered(joint, config, AskFrames(frames, is_feedback), "state")))


def _asked_how_it_is(drive: RobstrideDrive) -> Part[State | None]:
    """Read the motor's state; None if it does not answer."""
    answer = yield AskFrames((_write(drive, protocol.SPEED_TARGET, 0.0),), is_feedback)
    return None if answer is None else _state(answer)


def _asked_again(joint: int, config: JointConfig) -> Part[State]:
    """Read the motor's state again; raises DialogueFailed if it no longer answers."""
    return (yield from _said(joint, config, _write(_drive(config), protocol.SPEED_TARGET, 0.0)))


def is_feedback(frame: Frame) -> bool:
    """Whether a frame of the motor tells its state."""
    return frame.id >> TYPE_BIT == protocol.FEEDBACK and len(frame.data) == 8


def _state(frame: Frame) -> State:
    return State(frame.id >> protocol.MODE_BIT & 3, frame.id >> protocol.FAULT_BIT & 0x3F)


def read_parameter(joint: int, config: JointConfig, index: int, what: str) -> Part[bytes]:
    """Read a parameter: the data of the answer; raises DialogueFailed."""
    request = _frame(_drive(config), READ, {protocol.INDEX: index})

    def is_answer(frame: Frame) -> bool:
        known = frame.id >> 16 & 0xFF == 0  # another value comes from a RobStride that has no such parameter
        return frame.id >> TYPE_BIT == READ and known and len(frame.data) == 8 and frame.data[:2] == request.data[:2]

    return bytes((yield from answered(joint, config, AskFrames((request,), is_answer), what)).data)


def _number(joint: int, config: JointConfig, index: int, what: str) -> Part[float]:
    """Read a parameter whose value is a float; raises DialogueFailed."""
    return unpacked((yield from read_parameter(joint, config, index, what)), protocol.VALUE)


def _where_it_stands(joint: int, config: JointConfig) -> Part[float]:
    """Read the angle of the motor's output shaft (rad); raises DialogueFailed."""
    for _ in range(TRIES):
        angle = yield from _number(joint, config, protocol.POSITION, "position")
        if math.isfinite(angle):
            return angle
    raise DialogueFailed(
        joint,
        f"The drive of {config.name} says that its position is no number: calibrate its encoder with the maker's "
        f"program, {CLEAR_OR_START}.",
    )
