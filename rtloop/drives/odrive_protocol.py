"""ODrive with CANSimple: its commands, numbers and errors, as cycle and dialogues use them.

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

from rtloop.drives.errors import ErrorBit
from rtloop.drives.numbers import Number, Single
from rtloop.memory import status as status_bits

VERSION, HEARTBEAT, AXIS_STATE, ESTIMATES, MODES, INPUT_POSITION = 0x00, 0x01, 0x07, 0x09, 0x0B, 0x0C
CURRENT, BUS, CLEAR_ERRORS = 0x14, 0x17, 0x18
ANSWER_BYTES = 8
"""Length of every answer, which the remote frame states too."""

# of 0C
INPUT_TURNS = Single(0)
INPUT_AHEAD = Number(4, 2, signed=True)
"""Velocity feed-forward, in thousandths of a turn a second."""
AHEAD_PER_UNIT = 1000.0

# of 0B
CONTROL_MODE, INPUT_MODE = Number(0, 4), Number(4, 4)
POSITION_CONTROL, PASSTHROUGH = 3, 1

# of 07
WANTED_STATE = Number(0, 4)
IDLE, CLOSED_LOOP = 1, 8

# of 09
TURNS, TURNS_S = Single(0), Single(4)

# of 17
BUS_V = Single(0)

# of 14
CURRENT_A = Single(4)
"""Measured, of the motor."""

# of 01
ERROR, STATE, RESULT = Number(0, 4), Number(4, 1), Number(5, 1)
"""The result counts with firmware 0.6 only."""

# of 00
MAJOR, MINOR, REVISION = Number(4, 1), Number(5, 1), Number(6, 1)

FIRMWARE_0_6 = 6
"""Major version << 8 | minor version since which the error's bits are those of `ERRORS_0_6`."""
ERRORS_0_5 = (
    ErrorBit(1 << 0, "invalid state"),
    ErrorBit(1 << 6, "motor"),
    ErrorBit(1 << 7, "sensorless estimator", status_bits.ENCODER),
    ErrorBit(1 << 8, "encoder", status_bits.ENCODER),
    ErrorBit(1 << 9, "controller"),
    ErrorBit(1 << 11, "watchdog expired", status_bits.COMMUNICATION),
    ErrorBit(1 << 12, "minimum end stop"),
    ErrorBit(1 << 13, "maximum end stop"),
    ErrorBit(1 << 14, "emergency stop asked over CAN"),
    ErrorBit(1 << 17, "homing without an end stop"),
    ErrorBit(1 << 18, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 19, "position unknown", status_bits.ENCODER),
)
"""Bits of the heartbeat's error word (firmware 0.5.6)."""
ERRORS_0_6 = (
    ErrorBit(1 << 0, "initializing"),
    ErrorBit(1 << 1, "fault of the board"),
    ErrorBit(1 << 2, "timing"),
    ErrorBit(1 << 3, "no estimate of position or velocity", status_bits.ENCODER),
    ErrorBit(1 << 4, "bad configuration"),
    ErrorBit(1 << 5, "gate driver"),
    ErrorBit(1 << 6, "missing input"),
    ErrorBit(1 << 8, "over-voltage of the supply", status_bits.OVER_VOLTAGE),
    ErrorBit(1 << 9, "under-voltage of the supply", status_bits.UNDER_VOLTAGE),
    ErrorBit(1 << 10, "over-current from the supply", status_bits.OVER_CURRENT),
    ErrorBit(1 << 11, "over-current back into the supply", status_bits.OVER_CURRENT),
    ErrorBit(1 << 12, "over-current in the motor", status_bits.OVER_CURRENT),
    ErrorBit(1 << 13, "over-temperature of the motor", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 14, "over-temperature of the board", status_bits.OVER_TEMPERATURE),
    ErrorBit(1 << 15, "velocity limit"),
    ErrorBit(1 << 16, "position limit"),
    ErrorBit(1 << 24, "watchdog expired", status_bits.COMMUNICATION),
    ErrorBit(1 << 25, "emergency stop asked for"),
    ErrorBit(1 << 26, "spinout", status_bits.ENCODER),  # an encoder that slips or is offset
    ErrorBit(1 << 27, "brake resistor disarmed"),
    ErrorBit(1 << 28, "thermistor disconnected"),
    ErrorBit(1 << 30, "calibration"),
)
"""The same of firmware 0.6 (odrive_enums.h in odriverobotics/ros_odrive)."""
INITIALIZING = 1
"""Error word of a board with firmware 0.6 that has just got power."""
RESULTS = (
    "success",
    "busy",
    "cancelled",
    "disarmed",
    "no response",
    "pole pairs and encoder counts that do not fit",
    "phase resistance out of range",
    "phase inductance out of range",
    "unbalanced phases",
    "invalid motor type",
    "illegal Hall state",
    "timeout",
    "homing without an end stop",
    "invalid state",
    "not calibrated",
    "not converging",
)
"""Result, in the heartbeat of firmware 0.6, of the last request for a state (the same file)."""
