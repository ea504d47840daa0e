"""Nemo N23 in the cycle: it follows set-points, and answers each with its state (`rtloop.drives.nemo_protocol`)."""

from compilation.jit import jit
from config.drives.nemo import COUNTS_PER_TURN, REQUEST
from rtloop.drives import following, receiving, words
from rtloop.drives import nemo_protocol as protocol
from rtloop.drives.errors import meanings
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile

MEANINGS = meanings(protocol.ERRORS, every=0xFF & ~protocol.HOLDS)
ASK_STATE = protocol.STATE


@jit
def set_point(counts: float, counts_s: float) -> int:
    """Data of GO: where to, and the speed to have there."""
    speed = words.bounded(counts_s / COUNTS_PER_TURN * protocol.SPEED_STEPS_PER_TURN_S, protocol.HIGHEST_SPEED)
    data = words.placed(protocol.FUNCTION, protocol.GO) | words.placed(protocol.WANTED_SPEED, speed)
    return int(data | words.placed(protocol.WANTED_COUNTS, words.bounded(counts, protocol.HIGHEST_COUNT)))


@jit
def say(loop: Loop, joint: int, shared: StateFile, data: int, stops: int) -> bool:
    """Send a request, which the drive answers with its position; False if the transmit buffer has no room."""
    frame_id = REQUEST + loop.joints[joint].address
    if not outgoing.send(loop, shared, joint, frame_id, STANDARD, 8, data, 0, stops):
        return False
    loop.axes[joint].sent.asked_cycle = loop.timing.cycle
    receiving.note_question(loop, joint)
    return True


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send the set-point of this cycle; a drive that got none for a while catches up gradually."""
    row, axis = loop.joints[joint], loop.axes[joint]
    position_rad, velocity_rad_s = following.setpoint(loop, joint)
    position_rad -= following.still_behind_rad(loop, joint, position_rad)
    velocity_rad_s -= axis.sent.behind_rad_s
    if setpoint_check.may_be_sent(loop, shared, joint, position_rad, velocity_rad_s):
        counts = (position_rad + row.zero_rad) * row.command_per_rad
        say(loop, joint, shared, set_point(counts, velocity_rad_s * row.command_per_rad), -1)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the drive to hold its measured position; without more set-points it stands at its last one anyway."""
    row, axis = loop.joints[joint], loop.axes[joint]
    if not monitor.knows_where_it_stands(loop, joint):
        return True
    counts = (axis.measured.position_rad + row.zero_rad) * row.command_per_rad
    return say(loop, joint, shared, set_point(counts, 0.0), joint)


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if loop.axes[joint].sent.asked_cycle != loop.timing.cycle:
        say(loop, joint, shared, ASK_STATE, -1)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing: the status comes with every position."""


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the drive by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Every request is answered with a position."""
    receiving.note_question(loop, joint)


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store what an answer tells."""
    row = loop.joints[joint]
    if length != 8:
        return
    position_rad = words.whole(data, protocol.COUNTS) / row.reading_per_rad - row.zero_rad
    receiving.receive_position(loop, joint, position_rad, time_ns)
    receiving.receive_temperature(loop, joint, words.quantity(data, protocol.TEMPERATURE_C))
    receiving.receive_voltage(loop, joint, words.quantity(data, protocol.VOLTAGE_V))
    flags = words.whole(data, protocol.FLAGS)
    enabled = status_bits.ENABLED if flags & protocol.HOLDS else 0
    receiving.receive_status(loop, joint, enabled | words.meaning(flags, MEANINGS))
