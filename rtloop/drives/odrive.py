"""ODrive with CANSimple in the cycle: it follows set-points, with position and velocity in one frame.

`rtloop.drives.odrive_protocol` says what stands in its frames.
"""

import math

from compilation.jit import jit
from config.drives.odrive import COMMAND_MASK, NODE_BIT
from rtloop.drives import following, receiving, words
from rtloop.drives import odrive_protocol as protocol
from rtloop.drives.errors import meanings
from rtloop.memory import status as status_bits
from rtloop.memory.buses import round_of
from rtloop.memory.frame_words import REMOTE, STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile

MOST_AHEAD = 32_767

MEANINGS_0_5 = meanings(protocol.ERRORS_0_5, every=0xFFFFFFFF)
MEANINGS_0_6 = meanings(protocol.ERRORS_0_6, every=0xFFFFFFFF)


@jit
def identifier(loop: Loop, joint: int, command: int) -> int:
    """The CAN identifier of a command to the joint's node."""
    return int(loop.joints[joint].address << NODE_BIT | command)


@jit
def input_position(turns: float, turns_s: float) -> int:
    """Data of 0C: a position (turns) and its velocity (turns/s)."""
    ahead = words.bounded(turns_s * protocol.AHEAD_PER_UNIT, MOST_AHEAD)
    return int(words.placed_single(protocol.INPUT_TURNS, turns) | words.placed(protocol.INPUT_AHEAD, ahead))


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send the set-point of this cycle; an axis that got no set-points for a while catches up gradually."""
    row, axis = loop.joints[joint], loop.axes[joint]
    position_rad, velocity_rad_s = following.setpoint(loop, joint)
    position_rad -= following.still_behind_rad(loop, joint, position_rad)
    velocity_rad_s -= axis.sent.behind_rad_s
    if not setpoint_check.may_be_sent(loop, shared, joint, position_rad, velocity_rad_s):
        return
    data = input_position((position_rad + row.zero_rad) * row.command_per_rad, velocity_rad_s * row.command_per_rad)
    outgoing.send(loop, shared, joint, identifier(loop, joint, protocol.INPUT_POSITION), STANDARD, 8, data)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the axis to hold its measured position; its emergency stop (02) would let the joint fall.

    Without new targets the axis stands at its last one, so nothing is sent if its position is not known.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    if not monitor.knows_where_it_stands(loop, joint):
        return True
    data = input_position((axis.measured.position_rad + row.zero_rad) * row.command_per_rad, 0.0)
    frame_id = identifier(loop, joint, protocol.INPUT_POSITION)
    return bool(outgoing.send(loop, shared, joint, frame_id, STANDARD, 8, data, 0, joint))


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if outgoing.send(
        loop, shared, joint, identifier(loop, joint, protocol.ESTIMATES), REMOTE, protocol.ANSWER_BYTES, 0
    ):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask for bus voltage and motor current in turn; the status comes by itself with the heartbeat."""
    turn = round_of(loop, joint)
    what = protocol.CURRENT if turn & 1 and loop.joints[joint].effort_per_unit != 0.0 else protocol.BUS
    outgoing.send(loop, shared, joint, identifier(loop, joint, what), REMOTE, protocol.ANSWER_BYTES, 0)


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Service dialogues stop the axis by other means."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Do nothing: a position that the cycle did not ask for is counted as a report, and nothing depends on that."""


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Store estimates, supply voltage, torque, the heartbeat's status, or the firmware's version."""
    row = loop.joints[joint]
    command = frame_id & COMMAND_MASK
    if length != 8:
        return
    volt, ampere = words.single(data, protocol.BUS_V), words.single(data, protocol.CURRENT_A)
    if command == protocol.ESTIMATES:
        receive_estimates(loop, joint, data, time_ns)
    elif command == protocol.BUS and math.isfinite(volt):
        receiving.receive_voltage(loop, joint, volt)
    elif command == protocol.CURRENT and math.isfinite(ampere) and row.effort_per_unit != 0.0:
        receiving.receive_effort(loop, joint, ampere * row.effort_per_unit)
    elif command == protocol.HEARTBEAT:
        error, state = words.whole(data, protocol.ERROR), words.whole(data, protocol.STATE)
        receiving.receive_status(loop, joint, common_status(loop.axes[joint].drive.firmware, error, state))
    elif command == protocol.VERSION:
        loop.axes[joint].drive.firmware = words.whole(data, protocol.MAJOR) << 8 | words.whole(data, protocol.MINOR)


@jit
def receive_estimates(loop: Loop, joint: int, data: int, time_ns: int) -> None:
    """Store position and velocity, unless they are no numbers or stand for "unknown"."""
    row = loop.joints[joint]
    turns, turns_s = words.single(data, protocol.TURNS), words.single(data, protocol.TURNS_S)
    if not (math.isfinite(turns) and math.isfinite(turns_s)):
        return
    position_rad = turns / row.reading_per_rad - row.zero_rad
    if data != 0 or tells_zeros(loop, joint, position_rad):
        receiving.receive_position(loop, joint, position_rad, time_ns)
        receiving.receive_velocity(loop, joint, turns_s / row.reading_per_rad)


@jit
def tells_zeros(loop: Loop, joint: int, position_rad: float) -> bool:
    """Whether estimates of 0.0 and 0.0 are the axis's position, and not what firmware 0.5.6 sends for "unknown".

    They are its position if it was just measured near there, or if, after its last measurement, it has reported that
    its loop is closed.
    """
    axis = loop.axes[joint]
    if axis.drive.firmware >= protocol.FIRMWARE_0_6:
        return True
    if monitor.knows_where_it_stands(loop, joint):
        return bool(abs(position_rad - axis.measured.position_rad) <= loop.params.position_jump_rad)
    return bool(axis.drive.status & status_bits.ENABLED != 0 and axis.drive.status_ns >= axis.measured.time_ns)


@jit
def common_status(firmware: int, error: int, state: int) -> int:
    """The heartbeat's error word and axis state in common bits; `firmware` as in `rtloop.memory.axis.DriveState`."""
    enabled = status_bits.ENABLED if state == protocol.CLOSED_LOOP else 0
    if firmware >= protocol.FIRMWARE_0_6:
        return words.meaning(error, MEANINGS_0_6) | enabled
    return words.meaning(error, MEANINGS_0_5) | enabled
