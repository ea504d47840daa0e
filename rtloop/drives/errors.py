"""Error words of drives as tables: each bit once, with its words for people and what it means in common bits."""

from collections.abc import Sequence
from typing import NamedTuple

from rtloop.memory import status as status_bits


class ErrorBit(NamedTuple):
    """A bit of an error word."""

    mask: int
    words: str
    status: int = 0
    """What it means in common bits (`rtloop.memory.status`), beside that the drive has an error."""


def error_words(error: int, table: Sequence[ErrorBit]) -> str:
    """An error word for people, its unknown bits in hexadecimal."""
    known = [bit.words for bit in table if error & bit.mask]
    unknown = error & ~sum(bit.mask for bit in table)
    return ", ".join([*known, *([f"{unknown:#x}"] if unknown else [])]) or "none"


def meanings(table: Sequence[ErrorBit], every: int) -> tuple[tuple[int, int], ...]:
    """The table for `words.meaning`; any bit of `every`, the whole error word, means that the drive has an error."""
    found: dict[int, int] = {}
    for bit in table:
        if bit.status:
            found[bit.status] = found.get(bit.status, 0) | bit.mask
    return ((every, status_bits.PROTECTED), *((mask, status) for status, mask in found.items()))
