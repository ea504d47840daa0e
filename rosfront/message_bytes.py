"""Messages that are serialised once and afterwards only filled: for numbers that change and names that do not.

Building and serialising a Python message costs ten times what replacing its numbers does, and a front does it at the
rate of the control cycle. The offsets of the numbers are found in a first message with unmistakable numbers, so this
module needs to know the layout of no message. CDR is little-endian, and offsets are constant while all lengths are.
"""

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from rosfront.plan import NS

Instant = tuple[int, int]
"""sec, nanosec of a builtin_interfaces Time or Duration."""
_INSTANT = struct.Struct("<iI")


class MessageBytes:
    """A serialised message as the bytes that stay and the numbers between them; one call puts both together."""

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
        message = serialised(instants, rows)
        numbers = [*(_INSTANT.pack(*instant) for instant in instants), *(_packed(row) for row in rows)]
        places = sorted((_only(message, found), index) for index, found in enumerate(numbers))
        form, end = "<", 0
        self._parts: list[tuple[bytes, int]] = []
        """What stands before each group of numbers, and its index among times and rows."""
        for at, index in places:
            self._parts.append((message[end:at], index))
            form += f"{at - end}s" + (_INSTANT.format[1:] if index < times else f"{row_lengths[index - times]}d")
            end = at + len(numbers[index])
        self._rest = message[end:]
        self._form = struct.Struct(f"{form}{len(self._rest)}s")

    def replace(self, place: bytes, value: bytes) -> None:
        """Replace bytes that stay, `place`, by as many others; raises ValueError unless they occur exactly once."""
        fixed = [*(before for before, _ in self._parts), self._rest]
        if len(value) != len(place) or sum(part.count(place) for part in fixed) != 1:
            raise ValueError(f"The {len(place)} bytes to be replaced by {len(value)} do not occur exactly once.")
        *befores, self._rest = (part.replace(place, value) for part in fixed)
        self._parts = [(before, index) for before, (_, index) in zip(befores, self._parts, strict=True)]

    def fill(self, times_ns: Sequence[int], rows: Sequence[Sequence[float]]) -> bytes:
        """The message with these times (ns) and numbers; raises ValueError or struct.error unless all are given."""
        numbers = [*(divmod(time_ns, NS) for time_ns in times_ns), *rows]
        if len(numbers) != len(self._parts):
            raise ValueError(f"{len(numbers)} times and rows are given, and the message has {len(self._parts)}.")
        values: list[Any] = []
        for before, index in self._parts:
            values.append(before)
            values.extend(numbers[index])
        return self._form.pack(*values, self._rest)


def _packed(row: Sequence[float]) -> bytes:
    return struct.pack(f"<{len(row)}d", *row)


def _only(message: bytes, found: bytes) -> int:
    """Where the bytes stand; raises ValueError unless they occur exactly once."""
    if message.count(found) != 1:
        raise ValueError("A serialised message does not hold its numbers once each, little-endian.")
    return message.index(found)


def finite(values: Sequence[float]) -> list[float]:
    """The values, with 0 for NaN and infinity: a velocity is never NaN in a message."""
    return [value if math.isfinite(value) else 0.0 for value in values]
