"""Where a number stands in a frame: said once, for the cycle (compiled by `words`) and for dialogues.

A family's protocol file names its numbers; who reads or writes one says its name. The cycle holds a frame's eight data
bytes as one 64-bit word with the first byte lowest.
"""

import operator
import struct
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple


class Number(NamedTuple):
    """A whole number in `size` bytes (1 to 6) from byte `at`."""

    at: int
    size: int
    signed: bool = False
    """In two's complement."""
    big_endian: bool = False
    step: float = 1.0
    """What one of it is in the unit of its name, for `words.quantity`; all else reads and writes whole numbers."""


class Single(NamedTuple):
    """An IEEE 754 single from byte `at`, lowest byte first."""

    at: int


Values = Mapping[Number | Single, float]
"""What stands in a frame; whole numbers are ints."""
NO_VALUES: Values = {}


def whole(data: int, number: Number) -> int:
    """The number in a frame's data."""
    value = 0
    for i in range(number.size):
        byte = (data >> 8 * (number.at + i)) & 255
        value |= byte << 8 * (number.size - 1 - i if number.big_endian else i)
    if number.signed and value >> (8 * number.size - 1) != 0:
        value -= 1 << 8 * number.size
    return value


def placed(number: Number, value: int) -> int:
    """Data in which the number is a value, and all other bytes 0; of a value that is too large, the lowest bytes."""
    data = 0
    for i in range(number.size):
        byte = (value >> 8 * (number.size - 1 - i if number.big_endian else i)) & 255
        data |= byte << 8 * (number.at + i)
    return data


def packed(values: Values, length: int = 8) -> bytes:
    """The data bytes of a frame in which some numbers have values; raises OverflowError for one that is too large."""
    data = bytearray(length)
    for number, value in values.items():
        if isinstance(number, Single):
            struct.pack_into("<f", data, number.at, value)
        else:
            data[number.at : number.at + number.size] = _bytes_of(number, value)
    return bytes(data)


def _bytes_of(number: Number, value: Any) -> bytes:
    """The bytes of a value, which must be a whole number."""
    order: Literal["big", "little"] = "big" if number.big_endian else "little"
    return operator.index(value).to_bytes(number.size, order, signed=number.signed)


def unpacked(data: bytes, number: Number) -> int:
    """The whole number in the data bytes of a frame, whose length the caller knows."""
    return whole(int.from_bytes(data, "little"), number)


def unpacked_single(data: bytes, single: Single) -> float:
    """The single in the data bytes of a frame."""
    return float(struct.unpack_from("<f", data, single.at)[0])
