"""Where a number stands in a frame: said once, for the cycle (compiled by `words`) and for dialogues.

A family's protocol file names its numbers; who reads or writes one says its name. The cycle holds a frame's eight data
bytes as one 64-bit word with the first byte lowest.
"""

import operator
import struct
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, overload


class Number(NamedTuple):
    """A whole number in `size` bytes (1 to 6) from byte `at`."""

    at: int
    size: int
    signed: bool = False
    """In two's complement."""
    big_endian: bool = False
    step: float = 1.0
    """What one of it is in the unit of its name, for `words.quantity`; all else reads and writes whole numbers."""


class Bits(NamedTuple):
    """A whole number in `size` bits (1 to 16) from bit `at`, highest bit first; bit 0 is the highest of byte 0."""

    at: int
    size: int


class Single(NamedTuple):
    """An IEEE 754 single from byte `at`, lowest byte first."""

    at: int


Values = Mapping[Number | Bits | Single, float]
"""What stands in a frame; whole numbers are ints."""
NO_VALUES: Values = {}


def word(data: bytes) -> int:
    """Up to eight data bytes as the cycle holds them."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


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


def bits(data: int, where: Bits) -> int:
    """The number in a frame's data."""
    value, end = 0, where.at + where.size
    for i in range(where.at >> 3, end + 7 >> 3):
        value = value << 8 | data >> 8 * i & 255
    return value >> -end % 8 & (1 << where.size) - 1


def placed_bits(where: Bits, value: int) -> int:
    """Data in which the number is a value of no more bits, and all else 0."""
    data, end = 0, where.at + where.size
    rest = value << -end % 8
    for i in range((end + 7 >> 3) - 1, (where.at >> 3) - 1, -1):
        data |= (rest & 255) << 8 * i
        rest >>= 8
    return data - (data >> 63 << 63) * 2  # a word is signed where the cycle runs without its compiler, too


def packed(values: Values, length: int = 8) -> bytes:
    """The data bytes of a frame in which some numbers have values; raises OverflowError for one that is too large."""
    data = bytearray(length)
    for number, value in values.items():
        if isinstance(number, Single):
            struct.pack_into("<f", data, number.at, value)
        elif isinstance(number, Bits):
            _place(number, value, data)
        else:
            data[number.at : number.at + number.size] = _bytes_of(number, value)
    return bytes(data)


def _place(where: Bits, value: Any, data: bytearray) -> None:
    """Put a value, which must be a whole number, into its bits, which are 0."""
    value = operator.index(value)
    if value >> where.size != 0:
        raise OverflowError(f"{value} in {where.size} bits")
    whole = int.from_bytes(data, "big") | value << 8 * len(data) - where.at - where.size
    data[:] = whole.to_bytes(len(data), "big")


def _bytes_of(number: Number, value: Any) -> bytes:
    """The bytes of a value, which must be a whole number."""
    order: Literal["big", "little"] = "big" if number.big_endian else "little"
    return operator.index(value).to_bytes(number.size, order, signed=number.signed)


@overload
def unpacked(data: bytes, where: Number | Bits) -> int: ...
@overload
def unpacked(data: bytes, where: Single) -> float: ...
@overload
def unpacked(data: bytes, where: Number | Bits | Single) -> int | float: ...
def unpacked(data: bytes, where: Number | Bits | Single) -> float:
    """The number in the data bytes of a frame, whose length the caller knows."""
    if isinstance(where, Single):
        return float(struct.unpack_from("<f", data, where.at)[0])
    word = int.from_bytes(data, "little")
    return bits(word, where) if isinstance(where, Bits) else whole(word, where)
