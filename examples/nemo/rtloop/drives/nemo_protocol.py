"""Nemo N23: functions, numbers and errors, as cycle and dialogues use them.

Protocol facts (the Nemo N23's manual, chapter 4): standard identifiers, 100 + address to the drive and 180 + address
from it; 8 bytes, lowest byte first. Every request is answered, with the same first byte, by the drive's state.
"""

from rtloop.drives.errors import ErrorBit
from rtloop.drives.numbers import Number
from rtloop.memory import status as status_bits

# of every frame
FUNCTION = Number(0, 1)
STATE, GO, HOLD, LET_GO, CLEAR = 1, 2, 3, 4, 5

# of GO
WANTED_SPEED = Number(2, 2, signed=True)
WANTED_COUNTS = Number(4, 4, signed=True)
SPEED_STEPS_PER_TURN_S = 100.0
HIGHEST_SPEED, HIGHEST_COUNT = 0x7FFF, 0x7FFFFFFF

# of an answer
FLAGS = Number(1, 1)
HOLDS = 0x01
ERRORS = (
    ErrorBit(0x02, "over-temperature", status_bits.OVER_TEMPERATURE),
    ErrorBit(0x04, "over-current", status_bits.OVER_CURRENT),
    ErrorBit(0x08, "encoder", status_bits.ENCODER),
)
TEMPERATURE_C = Number(2, 1, signed=True)
VOLTAGE_V = Number(3, 1, step=0.25)
COUNTS = Number(4, 4, signed=True)
