"""MyActuator RMD motors: the maker's commands, numbers and errors, as cycle and dialogues use them.

Protocol facts (Motor Motion Protocol V4.2 and V4.3 for V3 drivers; 2b-t/myactuator_rmd and its tests): standard
identifiers, 140 + ID out and 240 + ID back, always 8 bytes, lowest byte first; an answer begins with the command's
byte. A4 is an absolute target of the output shaft with the highest speed of its trapezoid, answered with temperature,
current, speed and an angle of whole degrees; 9C is answered in the same way. 92 is answered with the angle; 9A with
temperature, brake, voltage and error word. 81 stops the motor and keeps its loop closed; 80 shuts it down.
"""

from rtloop.drives.errors import ErrorBit
from rtloop.drives.numbers import Number
from rtloop.memory import status as status_bits

READ_RAMP, WRITE_RAMP, RESET, RELEASE_BRAKE = 0x42, 0x43, 0x76, 0x77
SHUTDOWN, STOP, ANGLE, STATUS, FEEDBACK = 0x80, 0x81, 0x92, 0x9A, 0x9C
TARGET, UPTIME = 0xA4, 0xB1

# of every frame, in both directions
COMMAND = Number(0, 1)

# of A4
TARGET_SPEED_DPS = Number(2, 2)
"""0 would mean no limit at all, so the least that is sent is 1."""
TARGET_ANGLE = Number(4, 4, signed=True)
"""In hundredths of a degree."""
STEPS_PER_DEGREE = 100.0

# of 92
READ_ANGLE = Number(4, 4, signed=True)
"""In hundredths of a degree."""

# of the answers to 9A, 9C and A4
TEMPERATURE_C = Number(1, 1, signed=True)

# of the answers to 9C and A4
CURRENT = Number(2, 2, signed=True)
"""In hundredths of an ampere."""
STEPS_PER_AMPERE = 100.0
SPEED = Number(4, 2, signed=True, step=STEPS_PER_DEGREE)
"""Whole degrees a second, here as hundredths."""

# of the answer to 9A
BRAKE_RELEASED = Number(3, 1)
VOLTAGE_V = Number(4, 2, step=0.1)
ERROR = Number(6, 2)

# of 42 and 43
RAMP_INDEX = Number(1, 1)
RAMP_DPS_S = Number(4, 4)
RAMPS = ((0, "acceleration"), (1, "deceleration"))
"""The ramps of position planning: index, name."""

# of B1
UPTIME_MS = Number(4, 4)
"""It starts anew at 49.7 days."""

ERRORS = (
    ErrorBit(0x0002, "stall", status_bits.STALLED),
    ErrorBit(0x0004, "low voltage", status_bits.UNDER_VOLTAGE),
    ErrorBit(0x0008, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorBit(0x0010, "over-current", status_bits.OVER_CURRENT),
    ErrorBit(0x0040, "power", status_bits.OVER_CURRENT),  # the current that it takes from its supply
    ErrorBit(0x0080, "lost parameters"),
    ErrorBit(0x0100, "over-speed"),
    ErrorBit(0x0800, "over-temperature of its board", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x1000, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x2000, "encoder calibration", status_bits.ENCODER),
    ErrorBit(0x4000, "encoder data", status_bits.ENCODER),
)
"""Bits of the error word in the status (V4.3)."""
NEEDS_RESTART = 0x0002 | 0x0010 | 0x0080 | 0x2000 | 0x4000
"""Those that end with a restart only (V4.2 and V4.3, 8)."""
