"""Errors of drives as tables: each bit or code once, with its words for people and what it means in common bits."""

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


class ErrorCode(NamedTuple):
    """A code, or those that are `value` where `mask` has ones."""

    mask: int
    value: int
    words: str
    status: int = 0
    """As an ErrorBit's."""


def code_words(code: int, table: Sequence[ErrorCode]) -> str | None:
    """A code for people, by the first row that fits; None where none does."""
    return next((row.words for row in table if code & row.mask == row.value), None)


def code_meanings(table: Sequence[ErrorCode]) -> tuple[tuple[int, int, int], ...]:
    """The table for `words.meaning_of_code`."""
    return tuple((row.mask, row.value, row.status) for row in table)
