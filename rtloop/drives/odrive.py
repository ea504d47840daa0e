"""ODrive with CANSimple in the cycle: it follows set-points, with position and velocity in one frame.

Protocol facts (firmware 0.5.6: its CAN guide and DBC file; firmware 0.6: ODrive's CAN protocol page, and
can_simple_messages.hpp and odrive_enums.h in odriverobotics/ros_odrive): standard identifiers, node << 5 | command,
little-endian. 0C is an input position (float turns, velocity and torque feed-forward as int16 of 0.001). 09 are the
encoder's estimates (float turns, turns/s), 17 bus voltage and current, 14 motor current; the drive sends each of them
when a remote frame requests it. 01 is the heartbeat, which comes by itself: error word and axis state are its first
five bytes, whatever the firmware. The error's bits have another meaning with firmware 0.6, which answers a request for
its version (00); 0.5 does not answer that.

Firmware 0.5.6 answers 09 with 0.0 and 0.0 until its loop has been closed once since power came (can_simple.cpp of
odriverobotics/ODrive reads what start_closed_loop_control in axis.cpp connects).
"""

import math

from compilation.jit import jit
from rtloop.drives import following, receiving, words
from rtloop.drives.errors import meanings
from rtloop.drives.odrive_setup import (
    ANSWER_BYTES,
    BUS,
    CLOSED_LOOP,
    COMMANDS,
    CURRENT,
    ERRORS_0_5,
    ERRORS_0_6,
    ESTIMATES,
    FIRMWARE_0_6,
    HEARTBEAT,
    INPUT_POSITION,
    VERSION,
)
from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import REMOTE, STANDARD
from rtloop.memory.state import Loop
from rtloop.safety import monitor, setpoint_check
from rtloop.wire import outgoing
from shm.layout import StateFile

AHEAD_PER_UNIT = 1000.0
MOST_AHEAD = 32_767

MEANINGS_0_5, MEANINGS_0_6 = meanings(ERRORS_0_5, every=0xFFFFFFFF), meanings(ERRORS_0_6, every=0xFFFFFFFF)


@jit
def identifier(loop: Loop, joint: int, command: int) -> int:
    """The CAN identifier of a command to the joint's node."""
    return int(loop.joints[joint].address << 5 | command)


@jit
def input_position(turns: float, turns_s: float) -> int:
    """Data of 0C: a position (turns) and its velocity (turns/s)."""
    ahead = words.bounded(turns_s * AHEAD_PER_UNIT, MOST_AHEAD) & 0xFFFF
    return words.float_word(turns) | ahead << 32


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
    outgoing.send(loop, shared, identifier(loop, joint, INPUT_POSITION), STANDARD, 8, data)


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Command the axis to hold its measured position; its emergency stop (02) would let the joint fall.

    Without new targets the axis stands at its last one, so nothing is sent if its position is not known.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    if not monitor.knows_where_it_stands(loop, joint):
        return True
    data = input_position((axis.measured.position_rad + row.zero_rad) * row.command_per_rad, 0.0)
    return bool(outgoing.send(loop, shared, identifier(loop, joint, INPUT_POSITION), STANDARD, 8, data, 0, joint))


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    if outgoing.send(loop, shared, identifier(loop, joint, ESTIMATES), REMOTE, ANSWER_BYTES, 0):
        receiving.note_question(loop, joint)


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Ask for bus voltage and motor current in turn; the status comes by itself with the heartbeat."""
    turn = loop.timing.cycle // loop.params.joint_count
    what = CURRENT if turn & 1 and loop.joints[joint].effort_per_unit != 0.0 else BUS
    outgoing.send(loop, shared, identifier(loop, joint, what), REMOTE, ANSWER_BYTES, 0)


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
    command = frame_id & (COMMANDS - 1)
    if length != 8:
        return
    first, second = words.float_at(data, 0), words.float_at(data, 4)
    if command == ESTIMATES and math.isfinite(first) and math.isfinite(second):
        position_rad = first / row.reading_per_rad - row.zero_rad
        if data != 0 or tells_zeros(loop, joint, position_rad):
            receiving.receive_position(loop, joint, position_rad, time_ns)
            receiving.receive_velocity(loop, joint, second / row.reading_per_rad)
    elif command == BUS and math.isfinite(first):
        receiving.receive_voltage(loop, joint, first)
    elif command == CURRENT and math.isfinite(second) and row.effort_per_unit != 0.0:
        receiving.receive_effort(loop, joint, second * row.effort_per_unit)
    elif command == HEARTBEAT:
        error, state = words.unsigned(data, 0, 4), words.unsigned(data, 4, 1)
        receiving.receive_status(loop, joint, common_status(loop.axes[joint].drive.firmware, error, state))
    elif command == VERSION:
        loop.axes[joint].drive.firmware = words.unsigned(data, 4, 1) << 8 | words.unsigned(data, 5, 1)


@jit
def tells_zeros(loop: Loop, joint: int, position_rad: float) -> bool:
    """Whether estimates of 0.0 and 0.0 are the axis's position, and not what firmware 0.5.6 sends for "unknown".

    They are its position if it was just measured near there, or if, after its last measurement, it has reported that
    its loop is closed.
    """
    axis = loop.axes[joint]
    if axis.drive.firmware >= FIRMWARE_0_6:
        return True
    if monitor.knows_where_it_stands(loop, joint):
        return bool(abs(position_rad - axis.measured.position_rad) <= loop.params.position_jump_rad)
    return bool(axis.drive.status & status_bits.ENABLED != 0 and axis.drive.status_ns >= axis.measured.time_ns)


@jit
def common_status(firmware: int, error: int, state: int) -> int:
    """The heartbeat's error word and axis state in common bits; `firmware` as in `rtloop.memory.axis.DriveState`."""
    enabled = status_bits.ENABLED if state == CLOSED_LOOP else 0
    if firmware >= FIRMWARE_0_6:
        return words.meaning(error, MEANINGS_0_6) | enabled
    return words.meaning(error, MEANINGS_0_5) | enabled
