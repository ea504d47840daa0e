"""A snapshot as plain Python reads it: its words are Python's numbers, and a table is read by columns or by numpy.

A thread that wakes up for each message finds its caches cold, and then every library it touches costs it 10 µs and
more. So words and columns are taken out of the bytes by `struct`, and numpy sees only what is asked of it.
"""

import struct
from functools import cache
from typing import Any, ClassVar

import numpy as np

from shm import layout
from shm.record import offset_of

_WORDS = [name for name in layout.Changing.dtype.names or () if name != "joints"]
_INDEX = {name: index for index, name in enumerate(_WORDS)}
_WORDS_AT = offset_of(layout.Snapshot, _WORDS[0])
_TABLES_AT = {name: offset_of(layout.Snapshot, name) for name in ("results", "answers", "joints")}


def _letters(dtype: np.dtype[np.void], names: list[str]) -> str:
    """The words of a record for `struct`: an i8 is a q, an f8 a d."""
    return "".join("q" if dtype[name].kind == "i" else "d" for name in names)


_FORM = struct.Struct("<" + _letters(layout.Snapshot.dtype, _WORDS))


class Snapshot:
    """A consistent copy of a `shm.layout.Snapshot`; nothing changes it."""

    __slots__ = ("_bytes", "_record", "_tables", "_words")

    __iter__: ClassVar = None  # it would try the numbers from 0 on as names
    __contains__: ClassVar = None

    def __init__(self, copy: bytes) -> None:
        """`copy` is the record from its CRC to the last joint in use."""
        self._bytes = copy
        self._words = _FORM.unpack_from(copy, _WORDS_AT)
        self._tables: dict[str, tuple[Any, ...]] = {}
        self._record: np.ndarray | None = None

    @property
    def record(self) -> np.ndarray:
        """All of it as numpy sees it, without dimensions and read-only; joints that are not in use are zero."""
        if self._record is None:
            whole = self._bytes.ljust(layout.Snapshot.dtype.itemsize, b"\0")
            self._record = np.ndarray((), layout.Snapshot.dtype, whole)
        return self._record

    def __getitem__(self, name: str) -> Any:
        """A word as an int or a float, and as an array of records `results`, `answers` and all `joints`."""
        index = _INDEX.get(name)
        return self.record[name] if index is None else self._words[index]

    def __repr__(self) -> str:
        return f"Snapshot({self.record})"

    def column(self, table: str, name: str) -> tuple[Any, ...]:
        """One word of each row of `results` or `answers`, or of each joint in use, as ints or floats."""
        names, form = _table(table, len(self._bytes))
        if table not in self._tables:
            self._tables[table] = form.unpack_from(self._bytes, _TABLES_AT[table])
        return self._tables[table][names[name] :: len(names)]

    def find(self, table: str, name: str, value: int) -> np.void | None:
        """The row of `results` or `answers` of which a word is `value`; None where there is none."""
        words = self.column(table, name)
        row: np.void | None = self.record[table][words.index(value)] if value in words else None
        return row


@cache
def _table(table: str, length: int) -> tuple[dict[str, int], struct.Struct]:
    """The place of each word in a table's row, and the form of all its rows in a copy of so many bytes."""
    dtype = layout.Snapshot.dtype[table]
    row, rows = dtype.base, dtype.shape[0]
    if table == "joints":
        rows = (length - _TABLES_AT[table]) // row.itemsize
    names = list(row.names or ())
    return {name: index for index, name in enumerate(names)}, struct.Struct("<" + _letters(row, names) * rows)
