"""MKS SERVO42D/57D: their commands, numbers and answers, as cycle and dialogues use them.

Protocol facts (manual V1.0.6; mks-servo-can): standard identifiers, the drive's CanID in both directions; big-endian;
the last byte is the sum of the identifier and all bytes before it. 16384 counts a motor turn.
- `F5 rpm16 acc counts24`: go to an absolute target with at most that speed and a ramp of 1 rpm every (256 - acc) · 50
  µs, also in mid-move; with rpm 0 it is a halt along that ramp, after which the drive holds;
- `31` → `31 counts48`; `3A` → `3A enabled`; `3E` → `3E stalled`, which is a tripped protection only if one is turned on
  (V1.0.9); `F7` stops at once, homing runs too;
- results are `F5 code`: 0 refused, 1 begun, 2 done, 3 stopped at a limit, 5 waits for others.
For every function that is decoded here, request and answer differ in length, which tells an answer from an echo.
"""

from rtloop.drives.numbers import Number

READ_PARAMETER = 0x00
READ_POSITION, READ_ERROR = 0x31, 0x39
READ_ENABLED, READ_HOMED, CLEAR_PROTECTION, READ_STALLED = 0x3A, 0x3B, 0x3D, 0x3E
WORK_MODE, MICROSTEPS, PROTECT, ANSWERS, HOME, ERROR_GUARD = 0x82, 0x84, 0x88, 0x8C, 0x91, 0x9D
READ_STATE, ENABLE, MOVE, EMERGENCY_STOP = 0xF1, 0xF3, 0xF5, 0xF7

# of every frame, in both directions
CODE = Number(0, 1)

# of an answer of three bytes
VALUE = Number(1, 1)

# of F5
TARGET_RPM = Number(1, 2, big_endian=True)
TARGET_ACC = Number(3, 1)
TARGET_COUNTS = Number(4, 3, signed=True, big_endian=True)
TARGET_BYTES = 7
"""Without its checksum."""

# of the answer to 31
COUNTS = Number(1, 6, signed=True, big_endian=True)

# of the answer to 39
ERROR_STEPS = Number(1, 4, signed=True, big_endian=True)
"""How far the drive is from its target."""
ERROR_STEPS_PER_REVOLUTION = 51_200

REFUSED, BEGUN, STOPPED_AT_LIMIT = 0, 1, 3
"""Results of a command."""
STANDS, HOMING, CALIBRATING = 1, 5, 6
"""Answers to READ_STATE; the values between STANDS and HOMING mean that the drive moves."""
HOMING_FAILED = 2
SR_VFOC = 5
UNKNOWN = b"\xff\xff"
"""Answer to a request for a setting that the drive does not have."""
HIGHEST_RPM = 3000
"""In SR_vFOC."""
TRUE_SPEED_MICROSTEPS = (16, 32, 64)
"""Microsteps with which the speed in a command is in rpm; with others it is not (manual V1.0.6, 6.1)."""


def sealed(can_id: int, data: bytes) -> bytes:
    """The data of a frame with its checksum."""
    return data + bytes(((can_id + sum(data)) & 0xFF,))
