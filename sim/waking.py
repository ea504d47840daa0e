"""What the servers of a simulated arm in real time share: whoever waits in `serve` can be woken, and `with` ends it."""

from __future__ import annotations

import os
from types import TracebackType
from typing import Self

READ_SIZE = 65536


class Waking:
    """A pipe whose other end makes `serve` look up; `close` belongs in a `finally` or to a `with`."""

    def __init__(self) -> None:
        self._wake_read, self._wake_write = os.pipe()
        for descriptor in (self._wake_read, self._wake_write):
            os.set_blocking(descriptor, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def wake_descriptor(self) -> int:
        """A byte written here, by a signal or another thread, makes `serve` look up."""
        return self._wake_write

    def close(self) -> None:
        """End the pipe."""
        for descriptor in (self._wake_read, self._wake_write):
            os.close(descriptor)

    def _awake(self) -> None:
        """Take the bytes that woke `serve`."""
        os.read(self._wake_read, READ_SIZE)
