"""RobStride motors and the Xiaomi CyberGear: frames, parameters, numbers and faults, as cycle and dialogues use them.

Protocol facts (the CyberGear's manual in belovictor/cybergear-docs; sirwart/robstride; RobStride/Python_Sample):
extended identifiers, type << 24 | data16 << 8 | receiver. Type 1 is a set-point with gains (position, velocity,
stiffness, damping: 16 bits each, highest byte first; torque in data16), 17 reads and 18 writes a parameter (index and
value lowest byte first). All but 17 are answered with type 2: position, velocity, torque, temperature (highest byte
first), and in the identifier the motor, its faults and whether it runs. A motor sends type 21 by itself when it fails.

Beyond an end of the position field, RobStrides go on at its other end (their manuals of 2026, 4.2.3), other motors stay
at its end. Parameter 7019 goes on in both, and so does the meaning of 7016. So a motor that is told to stay where such
a field says would turn by twice the field's range. A field is therefore decoded as the position next to the one that
was just measured.
"""

from rtloop.drives.errors import ErrorBit
from rtloop.drives.numbers import Bits, Number, Single
from rtloop.memory import status as status_bits

FEEDBACK, FAULT = 2, 21
"""Types of frames that only a motor sends."""
RUN_MODE, SPEED_TARGET, POSITION_TARGET, SPEED_LIMIT = 0x7005, 0x700A, 0x7016, 0x7017
POSITION, VELOCITY, VOLTAGE, POSITION_GAIN = 0x7019, 0x701B, 0x701C, 0x701E
TORQUE_LIMIT, CURRENT_LIMIT, TIMEOUT, ZERO_STA, ZERO_OFFSET = 0x700B, 0x7018, 0x7028, 0x7029, 0x702B
"""Indexes of parameters; values written with type 18 are lost without power."""
TIMEOUT_UNIT_S = 50e-6
RESET, RUN = 0, 2
"""Values of bits 22 and 23 of a feedback's identifier; 1 is calibrating."""
MODE_BIT, FAULT_BIT = 22, 16
FAULTS = (
    ErrorBit(0x01, "under-voltage", status_bits.UNDER_VOLTAGE),
    ErrorBit(0x02, "over-current", status_bits.OVER_CURRENT),
    ErrorBit(0x04, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x08, "magnetic encoder", status_bits.ENCODER),
    ErrorBit(0x10, "Hall or stall", status_bits.ENCODER),  # a stall on RobStrides
    ErrorBit(0x20, "uncalibrated", status_bits.ENCODER),
)
"""What bits 16 to 21 of a feedback's identifier say."""
RUN_MODES = {"control": 0, "position": 1, "csp": 5}

FAULT_MEANINGS = (
    (0x01, status_bits.OVER_TEMPERATURE),
    (0x04, status_bits.UNDER_VOLTAGE),
    (0x08, status_bits.OVER_VOLTAGE),
    (0x10 | 0x20 | 0x10000, status_bits.OVER_CURRENT),  # of phases B, C and A
    (0x80, status_bits.ENCODER),
)
"""Bits of the word that type 21 says, which has an order of its own."""

# of 1 and 2: fields, 0 the lower end of their range (`rtloop.drives.fields`)
PLACE, SPEED = Bits(0, 16), Bits(16, 16)
# of 1
STIFFNESS, DAMPING = Bits(32, 16), Bits(48, 16)
NO_TORQUE = 0x7FFF
"""In the identifier of 1: a feed-forward torque of about 0."""
# of 2
TORQUE = Bits(32, 16)
TEMPERATURE_C = Number(6, 2, signed=True, big_endian=True, step=0.1)

CLEAR = Number(0, 1)
"""Of 4 (stop): 1 clears the faults."""

# of 17 and 18
INDEX = Number(0, 2)
VALUE = Single(4)
BYTE, WHOLE = Number(4, 1), Number(4, 4)
"""The value of a parameter that is a whole number, of one byte or four."""

# of 21
FAULT_WORD = Number(0, 4)
