"""Damiao motors: commands, fields of their frames, registers and errors, as cycle and dialogues use them.

Protocol facts (damiao-motor 1.0.6; the makers' DM-J4310-2EC manual): standard identifiers. A command of mode mit goes
to the motor's ID and packs, the highest bits first, position (16 bits), velocity, stiffness, damping and torque (12
each). A command of mode position_velocity goes to that ID + 100 (hex) and holds two little-endian floats (rad, rad/s).
Both are answered by feedback on the motor's master ID: status and the motor's ID in four bits each, position, velocity
and torque packed likewise, then the temperatures of power stage and rotor. Registers are accessed through 7FF: the
motor's ID, operation (CC requests the same feedback and moves nothing), register, value; answers come on the master ID
too, in the same form.
"""

from typing import NamedTuple

from rtloop.drives.errors import ErrorCode
from rtloop.drives.numbers import Bits, Number, Single
from rtloop.memory import status as status_bits

# of a command of mode mit: fields, 0 the lower end of their range (`rtloop.drives.fields`)
PLACE, SPEED = Bits(0, 16), Bits(16, 12)
STIFFNESS, DAMPING = Bits(28, 12), Bits(40, 12)
TORQUE = Bits(52, 12)

# of a command of mode position_velocity: rad and rad/s of the output shaft
TARGET, HIGHEST_SPEED = Single(0), Single(4)

# whole commands, in either mode
CLEAR_ERROR, ENABLE, DISABLE = (b"\xff" * 7 + last for last in (b"\xfb", b"\xfc", b"\xfd"))

# of a feedback
CODE, MOTOR = Bits(0, 4), Bits(4, 4)
LIMP, ENABLED = 0, 1
ERRORS = (
    ErrorCode(0xF, 8, "over-voltage", status_bits.OVER_VOLTAGE),
    ErrorCode(0xF, 9, "under-voltage", status_bits.UNDER_VOLTAGE),
    ErrorCode(0xF, 10, "over-current", status_bits.OVER_CURRENT),
    ErrorCode(0xF, 11, "power stage too hot", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xF, 12, "motor too hot", status_bits.OVER_TEMPERATURE),
    ErrorCode(0xF, 13, "communication lost", status_bits.COMMUNICATION),
    ErrorCode(0xF, 14, "overload", status_bits.OVER_CURRENT),
)
"""Codes; every other than these two and those is an error without a name."""
TOLD_PLACE, TOLD_SPEED, TOLD_TORQUE = Bits(8, 16), Bits(24, 12), Bits(36, 12)
STAGE_C, ROTOR_C = Number(6, 1), Number(7, 1)

# on 7FF, and of its answers
OWNER, OPERATION, REGISTER = Number(0, 2), Number(2, 1), Number(3, 1)
READ, WRITE, STORE, FEEDBACK = 0x33, 0x55, 0xAA, 0xCC


class Register(NamedTuple):
    """A register: its number, and its value's place in a frame (table of damiao-motor 1.0.6)."""

    number: int
    value: Number | Single

    def __str__(self) -> str:
        return f"register {self.number}"


FLOAT, WHOLE = Single(4), Number(4, 4)
UNDER_VOLTAGE_V, TORQUE_CONSTANT = Register(0, FLOAT), Register(1, FLOAT)
OVER_TEMPERATURE_C, OVER_CURRENT_SHARE = Register(2, FLOAT), Register(3, FLOAT)
ACC, DEC = Register(4, FLOAT), Register(5, FLOAT)
"""Ramps (rad/s², negative for braking)."""
MOST_SPEED = Register(6, FLOAT)
MASTER_ID, ESC_ID = Register(7, WHOLE), Register(8, WHOLE)
TIMEOUT = Register(9, WHOLE)
TIMEOUT_UNIT_S = 50e-6
CONTROL_MODE = Register(10, WHOLE)
MODES = {"mit": 1, "position_velocity": 2}
VERSION, SUB_VERSION = Register(14, WHOLE), Register(36, WHOLE)
GEAR, POSITION_GAIN = Register(20, FLOAT), Register(27, FLOAT)
PMAX, VMAX, TMAX = Register(21, FLOAT), Register(22, FLOAT), Register(23, FLOAT)
"""What the fields of position, velocity and torque reach either way."""
OVER_VOLTAGE_V, SUPPLY_V = Register(29, FLOAT), Register(60, FLOAT)
BIT_RATE = Register(35, WHOLE)
BIT_RATES = {0: 125_000, 1: 200_000, 2: 250_000, 3: 500_000, 4: 1_000_000}
