"""Numbers in the eight data bytes of a frame, which the cycle holds as one 64-bit word with the first byte lowest."""

import numpy as np

from compilation.jit import jit
from rtloop.drives import fields, numbers


@jit
def bounded(value: float, most: int) -> int:
    """The nearest whole number within ±most; undefined for NaN, which `may_be_sent` keeps away."""
    return round(min(max(value, -float(most)), float(most)))


@jit
def meaning(bits: int, table: tuple[tuple[int, int], ...]) -> int:
    """An error word in common bits (`memory.status`); `table` has pairs of the drive's bits and the common bits."""
    found = 0
    for theirs, common in table:
        if bits & theirs:
            found |= common
    return found


@jit
def meaning_of_code(code: int, table: tuple[tuple[int, int, int], ...]) -> int:
    """What an error code is in common bits: those of the first row (mask, value, bits) that fits, 0 where none does."""
    for mask, value, common in table:
        if code & mask == value:
            return common
    return 0


whole = jit(numbers.whole)
placed = jit(numbers.placed)
bits = jit(numbers.bits)
placed_bits = jit(numbers.placed_bits)


@jit
def single(data: int, where: numbers.Single) -> float:
    """The single in a frame's data."""
    return float(np.uint32(data >> 8 * where.at & 0xFFFFFFFF).view(np.float32))


@jit
def placed_single(where: numbers.Single, value: float) -> int:
    """Data in which the single is a value, and all other bytes 0."""
    return (int(np.float32(value).view(np.int32)) & 0xFFFFFFFF) << 8 * where.at


@jit
def quantity(data: int, number: numbers.Number) -> float:
    """The number in a frame's data, in its unit."""
    return float(whole(data, number) * number.step)


field = jit(fields.field)
of_field = jit(fields.of_field)


@jit
def placed_field(where: numbers.Bits, value: float, most: float) -> int:
    """Data in which a number within ±most stands in a field (`rtloop.drives.fields`), and all else 0."""
    return int(placed_bits(where, field(value, most, where.size)))


@jit
def field_at(data: int, where: numbers.Bits, most: float) -> float:
    """The number within ±most that a field in a frame's data holds."""
    return float(of_field(bits(data, where), most, where.size))
