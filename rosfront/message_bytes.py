"""Messages that are serialised once and afterwards only patched: for numbers that change and names that do not.

Building and serialising a Python message costs ten times what replacing its numbers does, and a front does it at the
rate of the control cycle. The offsets of the numbers are found in a first message with unmistakable numbers, so this
module needs to know the layout of no message. CDR is little-endian, and offsets are constant while all lengths are.
"""

import math
import struct
from collections.abc import Callable, Sequence

from rosfront.plan import NS

Instant = tuple[int, int]
"""sec, nanosec of a builtin_interfaces Time or Duration."""
_INSTANT = struct.Struct("<iI")


class MessageBytes:
    """A serialised message whose times and rows of numbers are replaced in place."""

    def __init__(
        self,
        serialised: Callable[[Sequence[Instant], Sequence[list[float]]], bytes],
        times: int,
        row_lengths: Sequence[int],
    ) -> None:
        """`serialised` makes the message of `times` instants and rows of these lengths; it is called once.

        Raises ValueError unless its result contains each of them exactly once.
        """
        instants = [(0x5A5B5C5D + index, 0x3A2B1C0D + index) for index in range(times)]
        rows = [
            [1e3 * (index + 1) + place + 0.123456789 for place in range(length)]
            for index, length in enumerate(row_lengths)
        ]
        self._bytes = bytearray(serialised(instants, rows))
        self._times_at = [self._find(_INSTANT.pack(*instant)) for instant in instants]
        structs = [struct.Struct(f"<{length}d") for length in row_lengths]
        self._rows_at = [(form, self._find(form.pack(*row))) for form, row in zip(structs, rows, strict=True)]

    def _find(self, marker: bytes) -> int:
        if self._bytes.count(marker) != 1:
            raise ValueError("A serialised message does not hold its numbers once each, little-endian.")
        return self._bytes.index(marker)

    def replace(self, place: bytes, value: bytes) -> None:
        """Replace the bytes `place` by as many others; raises ValueError unless they occur exactly once."""
        at = self._find(place)
        self._bytes[at : at + len(place)] = value

    def fill(self, times_ns: Sequence[int], rows: Sequence[Sequence[float]]) -> bytes:
        """The message with these times (ns) and numbers."""
        for at, time_ns in zip(self._times_at, times_ns, strict=True):
            _INSTANT.pack_into(self._bytes, at, *divmod(time_ns, NS))
        for (form, at), row in zip(self._rows_at, rows, strict=True):
            form.pack_into(self._bytes, at, *row)
        return bytes(self._bytes)


def finite(values: Sequence[float]) -> list[float]:
    """The values, with 0 for NaN and infinity: a velocity is never NaN in a message."""
    return [value if math.isfinite(value) else 0.0 for value in values]
