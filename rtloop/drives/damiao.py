"""Damiao motors in the cycle: they follow set-points (mode mit) or go to targets (mode position_velocity).

`rtloop.drives.damiao_protocol` says what stands in their frames.
"""

import math

from compilation.jit import jit
from config.drives.damiao import HIGHEST_KD, HIGHEST_KP, POSITION_VELOCITY_OFFSET, REGISTERS_ID
from rtloop.drives import damiao_protocol as protocol
from rtloop.drives import following, leading, receiving, words
from rtloop.drives.errors import code_meanings
from rtloop.drives.numbers import Bits
from rtloop.memory import status as status_bits
from rtloop.memory.axis import JointParams
from rtloop.memory.frame_words import STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.trajectory.correction import ERROR_SPEED_SHARE
from rtloop.wire import outgoing
from shm.layout import StateFile

ERROR_MEANINGS = code_meanings(protocol.ERRORS)


@jit
def setpoint_data(row: JointParams, rad: float, rad_s: float, nm: float) -> int:
    """Data of a command of mode mit, for the motor's shaft; `row` has the fields' ranges, stiffness and damping."""
    data = words.placed_field(protocol.PLACE, rad, row.range_rad)
    data |= words.placed_field(protocol.SPEED, rad_s, row.range_rad_s)
    # stiffness and damping are the upper halves of ranges that begin at 0
    data |= words.placed_field(protocol.STIFFNESS, 2.0 * row.stiffness_nm_rad - HIGHEST_KP, HIGHEST_KP)
    data |= words.placed_field(protocol.DAMPING, 2.0 * row.damping_nm_s_rad - HIGHEST_KD, HIGHEST_KD)
    return int(data | words.placed_field(protocol.TORQUE, nm, row.range_nm))


@jit
def target_data(rad: float, rad_s: float) -> int:
    """Data of a command of mode position_velocity: target and highest speed of the motor's shaft."""
    return int(words.placed_single(protocol.TARGET, rad) | words.placed_single(protocol.HIGHEST_SPEED, rad_s))


@jit
def following_data(row: JointParams, rad: float, rad_s: float) -> int:
    """Data of a command of mode mit whose torque makes up for the rounding of position and velocity.

    Position and velocity are rounded down to whole steps, which would tug at the joint at every step. The steps of the
    torque field are finer than the stiffness times a step of position.
    """
    lost_rad = rad - rounded(protocol.PLACE, rad, row.range_rad)
    lost_rad_s = rad_s - rounded(protocol.SPEED, rad_s, row.range_rad_s)
    return setpoint_data(row, rad, rad_s, row.stiffness_nm_rad * lost_rad + row.damping_nm_s_rad * lost_rad_s)


@jit
def rounded(where: Bits, value: float, most: float) -> float:
    """What a motor takes a number for that was put into a field."""
    return words.field_at(words.placed_field(where, value, most), where, most)


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send a set-point in mode mit, or a target and a speed limit in mode position_velocity."""
    row, axis = loop.joints[joint], loop.axes[joint]
    if row.plans_its_motion == 0:
        position_rad, velocity_rad_s = following.setpoint(loop, joint)
        rad, rad_s = (position_rad + row.zero_rad) * row.command_per_rad, velocity_rad_s * row.command_per_rad
        if setpoint_check.may_be_sent(loop, shared, joint, rad, rad_s):
            command(loop, joint, shared, row.address, following_data(row, rad, rad_s), -1)
        return
    target_rad, speed_rad_s = leading.target_ahead(loop, joint, 0.0)
    if axis.commanded.velocity_rad_s == 0.0 and axis.commanded.next_velocity_rad_s == 0.0:
        speed_rad_s = holding_rad_s(row)
    rad, rad_s = (target_rad + row.zero_rad) * row.command_per_rad, abs(speed_rad_s * row.command_per_rad)
    if setpoint_check.may_be_sent(loop, shared, joint, rad, rad_s):
        command(loop, joint, shared, row.address + POSITION_VELOCITY_OFFSET, target_data(rad, rad_s), -1)


@jit
def holding_rad_s(row: JointParams) -> float:
    """Speed limit (rad/s) at which a standing joint returns after it was pushed away; at 0 it would not resist."""
    return float(ERROR_SPEED_SHARE * row.max_velocity_rad_s)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the motor to hold its measured position, or in mode position_velocity where its ramp ends.

    The motor stays enabled, because the joint would fall otherwise. A motor that gets no more commands stands at its
    last target, or goes on to it along its ramp; so nothing is sent if its position is not known.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    if not monitor.knows_where_it_stands(loop, joint):
        return True
    if row.plans_its_motion == 0:
        rad = (axis.measured.position_rad + row.zero_rad) * row.command_per_rad
        return command(loop, joint, shared, row.address, following_data(row, rad, 0.0), joint)
    told_rad_s = axis.drive.velocity_rad_s if math.isfinite(axis.drive.velocity_rad_s) else 0.0
    speed_rad_s = min(abs(told_rad_s), row.max_velocity_rad_s)
    way_rad = speed_rad_s * speed_rad_s / (2.0 * row.silence_deceleration_rad_s2)
    way_rad += speed_rad_s * loop.params.period_ns * 1e-9  # since it was measured
    target_rad = axis.measured.position_rad + math.copysign(way_rad, told_rad_s)
    rad = (target_rad + row.zero_rad) * row.command_per_rad
    rad_s = abs(max(speed_rad_s, holding_rad_s(row)) * row.command_per_rad)
    data = target_data(rad, rad_s)
    return command(loop, joint, shared, row.address + POSITION_VELOCITY_OFFSET, data, joint)


@jit
def command(loop: Loop, joint: int, shared: StateFile, frame_id: int, data: int, stops: int) -> bool:
    """Send a motion command, which the drive answers with its feedback; False if the transmit buffer has no room."""
    if not outgoing.send(loop, shared, joint, frame_id, STANDARD, 8, data, 0, stops):
        return False
    loop.axes[joint].sent.asked_cycle = loop.timing.cycle
    receiving.note_question(loop, joint)
    return True


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if loop.axes[joint].sent.asked_cycle == loop.timing.cycle:
        return
    data = words.placed(protocol.OWNER, loop.joints[joint].address)
    data |= words.placed(protocol.OPERATION, protocol.FEEDBACK)
    if outgoing.send(loop, shared, joint, REGISTERS_ID, STANDARD, 8, data):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing: the status is part of the feedback."""


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the motor by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Every frame except those about registers is answered with feedback, which holds a position."""
    if frame_id != REGISTERS_ID or words.whole(data, protocol.OPERATION) == protocol.FEEDBACK:
        receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store position, velocity, torque, temperature and status of a feedback."""
    row = loop.joints[joint]
    if length != 8 or tells_a_register(row.address, data) or words.bits(data, protocol.MOTOR) != row.address:
        return
    rad = words.field_at(data, protocol.TOLD_PLACE, row.range_rad)
    rad_s = words.field_at(data, protocol.TOLD_SPEED, row.range_rad_s)
    nm = words.field_at(data, protocol.TOLD_TORQUE, row.range_nm)
    receiving.receive_position(loop, joint, rad / row.reading_per_rad - row.zero_rad, time_ns)
    receiving.receive_velocity(loop, joint, rad_s / row.reading_per_rad)
    receiving.receive_effort(loop, joint, nm * row.effort_per_unit)
    hottest_c = max(words.whole(data, protocol.STAGE_C), words.whole(data, protocol.ROTOR_C))
    receiving.receive_temperature(loop, joint, float(hottest_c))
    receiving.receive_status(loop, joint, common_status(words.bits(data, protocol.CODE)))


@jit
def tells_a_register(address: int, data: int) -> bool:
    """Whether an answer is about a register.

    Such an answer begins with the motor's whole ID and an operation. Feedback of a motor that stands on one of three
    steps in the lowest hundredth of its range could begin in the same way; it is then ignored.
    """
    operation = words.whole(data, protocol.OPERATION)
    ours = words.whole(data, protocol.OWNER) == address
    return bool(ours and operation in (protocol.READ, protocol.WRITE, protocol.STORE))


@jit
def common_status(code: int) -> int:
    """The status code of a feedback in common bits (`memory.status`): 0 is disabled, 1 enabled, others are errors."""
    if code == protocol.ENABLED:
        return status_bits.ENABLED
    return 0 if code == protocol.LIMP else status_bits.PROTECTED | words.meaning_of_code(code, ERROR_MEANINGS)
