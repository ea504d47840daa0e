"""VESC: packets, numbers and faults, as cycle and dialogues use them.

Protocol facts (vedderb/bldc at b9d287b3: comm/comm_can.c, comm/commands.c, datatypes.h, documentation/comm_can.md):
extended identifiers, packet << 8 | number, highest byte first. 4 is a position within a turn, in millionths of a
degree, which also enables the motor; 1 with no current lets it coast. Status packets come by themselves, each at one of
two rates: 16 (status 4) has temperatures and the PID position, 27 (status 5) the supply voltage. 8 carries a command of
up to 6 bytes beside the number of who asks, to whom it is answered in the same way. 17 is answered with 18. Command 50
is answered with the values of the mask's bits, and fits where that is one byte: bit 15 is the fault, bit 21 (firmware
since June 2021) whether the time-out or the kill switch has let the motor go.

The current (status 1) says with its sign whether the motor draws or generates power, not where its torque points, and
ERPM (the same) are turns of the field: neither is used.
"""

import math

from rtloop.drives.errors import ErrorCode
from rtloop.drives.numbers import Number
from rtloop.memory import status as status_bits

SET_CURRENT, SET_POSITION, SHORT_BUFFER, STATUS_4, PING, PONG, STATUS_5 = 1, 4, 8, 16, 17, 18, 27

# of SET_CURRENT
CURRENT = Number(0, 4, signed=True, big_endian=True)
"""In thousandths of an ampere; 0 lets the motor coast."""

# of SET_POSITION
POSITION = Number(0, 4, signed=True, big_endian=True)
"""In millionths of a degree."""
POSITION_PER_TURN = 360e6
COMMAND_BYTES = 4
"""Length of these two."""

# of STATUS_4
HOTTEST_C = (Number(0, 2, signed=True, big_endian=True, step=0.1), Number(2, 2, signed=True, big_endian=True, step=0.1))
"""Power stage, motor; a motor without a sensor tells less than any real one."""
TOLD_POSITION = Number(6, 2, signed=True, big_endian=True)
"""In fiftieths of a degree, from 0 to 360 degrees."""

# of STATUS_5
VOLTAGE_V = Number(4, 2, signed=True, big_endian=True, step=0.1)
STATUS_BYTES = 8

# of SHORT_BUFFER
SENDER, HOW = Number(0, 1), Number(1, 1)
COMMAND, MASK, VALUE = Number(2, 1), Number(3, 4, big_endian=True), Number(7, 1)
TO_BE_ANSWERED, IS_ANSWER = 0, 1
GET_VALUES_SELECTIVE = 50
FAULT, RELEASED = 1 << 15, 1 << 21
"""Bits of the mask."""
QUESTION_BYTES, ANSWER_BYTES = 7, 8
TIMED_OUT, KILLED = 1, 2
"""Bits of the value of RELEASED."""

# of PING and PONG, whose first byte is the number of who sends it
PING_BYTES, PONG_BYTES = 1, 2

FAULTS = tuple(
    ErrorCode(0xFF, code, words, status)
    for code, words, status in (
        (0, "none", 0),
        (1, "over-voltage", status_bits.OVER_VOLTAGE),
        (2, "under-voltage", status_bits.UNDER_VOLTAGE),
        (3, "gate driver", 0),
        (4, "over-current", status_bits.OVER_CURRENT),
        (5, "over-temperature of the power stage", status_bits.OVER_TEMPERATURE),
        (6, "over-temperature of the motor", status_bits.OVER_TEMPERATURE),
        (7, "over-voltage of the gate driver", status_bits.OVER_VOLTAGE),
        (8, "under-voltage of the gate driver", status_bits.UNDER_VOLTAGE),
        (9, "under-voltage of the processor", status_bits.UNDER_VOLTAGE),
        (10, "restart by its watchdog", 0),
        (11, "encoder bus", status_bits.ENCODER),
        (12, "weak sine and cosine of the encoder", status_bits.ENCODER),
        (13, "strong sine and cosine of the encoder", status_bits.ENCODER),
        (14, "flash corruption", 0),
        (15, "offset of current sensor 1", 0),
        (16, "offset of current sensor 2", 0),
        (17, "offset of current sensor 3", 0),
        (18, "unbalanced currents", status_bits.OVER_CURRENT),
        (19, "break input", 0),
        (20, "resolver: loss of tracking", status_bits.ENCODER),
        (21, "resolver: degraded signal", status_bits.ENCODER),
        (22, "resolver: loss of signal", status_bits.ENCODER),
        (23, "corrupt app configuration", 0),
        (24, "corrupt motor configuration", 0),
        (25, "encoder without a magnet", status_bits.ENCODER),
        (26, "too strong a magnet at the encoder", status_bits.ENCODER),
        (27, "phase filter", 0),
        (28, "encoder", status_bits.ENCODER),
        (29, "low-voltage output", 0),
        (30, "encoder slip", status_bits.ENCODER),
        (31, "over-speed", 0),
        (32, "under-speed", 0),
        (33, "absolute over-speed", 0),
    )
)
"""Fault codes (mc_fault_code in datatypes.h)."""


def within_a_turn(turns: float) -> float:
    """The same place in the turn that begins at 0."""
    return turns - math.floor(turns)


def nearest(turns: float, to: float) -> float:
    """The same place in the turn whose middle is `to`."""
    return turns - math.floor(turns - to + 0.5)
