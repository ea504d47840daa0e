"""VESC in the cycle: it follows set-points, and sends its position by itself (`rtloop.drives.vesc_protocol`).

Positions come round each turn. A joint has less than one (`config.drives.vesc.MOST_OF_A_TURN`), so a reading means the
angle that is nearest to the middle of the joint's range.

No frame tells whether the motor is driven. It is taken to be since its last position command, unless it was told to
coast, has a fault, or its time-out or kill switch has let it go.
"""

from compilation.jit import jit
from config.drives.vesc import HOST_BIT, PACKET_BIT, STEPS_PER_TURN
from rtloop.drives import following, receiving, words
from rtloop.drives import vesc_protocol as protocol
from rtloop.drives.errors import code_meanings
from rtloop.memory import status as status_bits
from rtloop.memory.axis import JointParams
from rtloop.memory.buses import round_of
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile
from shm.words import Unreferenced

_SILENT, _POWER_LOST = int(Unreferenced.SILENT), int(Unreferenced.POWER_LOST)
FAULT_MEANINGS = code_meanings(protocol.FAULTS)
HOTTEST_C = protocol.HOTTEST_C
SURE_AFTER = 2
"""Statuses in a row that say so after which a drive is taken to have let go."""

within_a_turn = jit(protocol.within_a_turn)
nearest = jit(protocol.nearest)


@jit
def set_position(turns: float) -> int:
    """Data of a position command for a place in any turn."""
    return int(words.placed(protocol.POSITION, round(within_a_turn(turns) * protocol.POSITION_PER_TURN)))


@jit
def send_position(loop: Loop, joint: int, shared: StateFile, position_rad: float, stops: int) -> bool:
    """Send the joint's position; False if the transmit buffer has no room."""
    row = loop.joints[joint]
    frame_id = protocol.SET_POSITION << PACKET_BIT | row.address
    data = set_position((position_rad + row.zero_rad) * row.command_per_rad / STEPS_PER_TURN)
    return bool(outgoing.send(loop, shared, joint, frame_id, EXTENDED, protocol.COMMAND_BYTES, data, 0, stops))


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send the set-point of this cycle; a drive that got none for a while catches up gradually."""
    position_rad, velocity_rad_s = following.setpoint(loop, joint)
    position_rad -= following.still_behind_rad(loop, joint, position_rad)
    if not setpoint_check.may_be_sent(loop, shared, joint, position_rad, velocity_rad_s):
        return
    if send_position(loop, joint, shared, position_rad, -1):
        loop.axes[joint].drive.is_disabled = 0


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the drive to hold its measured position; without more set-points it stands at its last one anyway.

    Nothing is sent to a drive that may have let go or lost its power, since a position enables it.
    """
    axis = loop.axes[joint]
    may_be_limp = axis.drive.is_disabled == 1 or axis.reference.unreferenced_reason in (_SILENT, _POWER_LOST)
    if may_be_limp or not monitor.knows_where_it_stands(loop, joint):
        return True
    return send_position(loop, joint, shared, axis.measured.position_rad, joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing: its position comes by itself."""


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask in turn for its fault, and whether its time-out or kill switch has let the motor go.

    After a first bad answer the same is asked again, so that the next one tells at once whether to believe it.
    """
    axis, row = loop.axes[joint], loop.joints[joint]
    mask = protocol.RELEASED if round_of(loop, joint) & 1 else protocol.FAULT
    if axis.checks.bad_statuses == 1:
        mask = protocol.RELEASED if axis.drive.error_code == 0 else protocol.FAULT
    data = words.placed(protocol.SENDER, row.address | HOST_BIT) | words.placed(protocol.HOW, protocol.TO_BE_ANSWERED)
    data |= words.placed(protocol.COMMAND, protocol.GET_VALUES_SELECTIVE) | words.placed(protocol.MASK, mask)
    frame_id = protocol.SHORT_BUFFER << PACKET_BIT | row.address
    outgoing.send(loop, shared, joint, frame_id, EXTENDED, protocol.QUESTION_BYTES, data)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the drive by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """A position enables the drive, and a current (none) lets it coast."""
    packet = frame_id >> PACKET_BIT
    if packet == protocol.SET_POSITION:
        loop.axes[joint].drive.is_disabled = 0
    elif packet == protocol.SET_CURRENT:
        loop.axes[joint].drive.is_disabled = 1


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store position and temperature, supply voltage, or the answer to a question."""
    row = loop.joints[joint]
    packet, number = frame_id >> PACKET_BIT, frame_id & ~(-1 << PACKET_BIT)
    if length != protocol.STATUS_BYTES:
        return
    if number == row.address and packet == protocol.STATUS_4:
        told = words.whole(data, protocol.TOLD_POSITION)
        if 0 <= told <= STEPS_PER_TURN:
            receiving.receive_position(loop, joint, joint_position_rad(row, told), time_ns)
        hottest_c = max(words.quantity(data, HOTTEST_C[0]), words.quantity(data, HOTTEST_C[1]))
        receiving.receive_temperature(loop, joint, hottest_c)
    elif number == row.address and packet == protocol.STATUS_5:
        receiving.receive_voltage(loop, joint, words.quantity(data, protocol.VOLTAGE_V))
    elif number == row.address | HOST_BIT and packet == protocol.SHORT_BUFFER:
        receive_answer(loop, joint, data)


@jit
def joint_position_rad(row: JointParams, told: int) -> float:
    """Where the joint stands that is told to be somewhere in a turn."""
    middle_rad = 0.5 * (row.lower_rad + row.upper_rad)
    middle = (middle_rad + row.zero_rad) * row.reading_per_rad / STEPS_PER_TURN
    return float(nearest(told / STEPS_PER_TURN, middle) * STEPS_PER_TURN / row.reading_per_rad - row.zero_rad)


@jit
def receive_answer(loop: Loop, joint: int, data: int) -> None:
    """Store the drive's fault, or that its time-out or kill switch has let the motor go."""
    axis = loop.axes[joint]
    is_answer = words.whole(data, protocol.HOW) == protocol.IS_ANSWER
    of_it = words.whole(data, protocol.SENDER) == loop.joints[joint].address
    if not (is_answer and of_it and words.whole(data, protocol.COMMAND) == protocol.GET_VALUES_SELECTIVE):
        return
    mask, value = words.whole(data, protocol.MASK), words.whole(data, protocol.VALUE)
    enabled = 0 if axis.drive.is_disabled == 1 else status_bits.ENABLED
    if mask == protocol.FAULT:
        axis.drive.error_code = value
        fault = 0 if value == 0 else status_bits.PROTECTED | words.meaning_of_code(value, FAULT_MEANINGS)
        receiving.receive_status(loop, joint, fault if value else enabled)
    elif mask == protocol.RELEASED:
        released = status_bits.COMMUNICATION if value & protocol.TIMED_OUT else 0
        receiving.receive_status(loop, joint, released if value else enabled)
    if value != 0 and axis.checks.bad_statuses >= SURE_AFTER:
        axis.drive.is_disabled = 1
