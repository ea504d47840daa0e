"""What kind of classic CAN frame one is, as bits; none of them: a data frame with a standard identifier (11 bits)."""

from config.frames import unchecked_frame_bits
from shm.jit import jit

STANDARD = 0
EXTENDED = 1
"""Its identifier has 29 bits."""
REMOTE = 2
"""It asks for data and has none; its length says how many are asked for."""

_data_frame_bits = jit(unchecked_frame_bits)


@jit
def frame_bits(kind: int, length: int) -> int:
    """Bits of a frame on the bus, with worst-case stuffing and the three bits of interframe space."""
    return int(_data_frame_bits(kind & EXTENDED != 0, 0 if kind & REMOTE else length))
