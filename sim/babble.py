"""A node that sends without a pause: broken hardware, or software that has gone astray."""

from __future__ import annotations

from collections import deque

from sim.bus import Frame, Outbox
from sim.drives.ramp import NEVER


class Babbler:
    """A node of the bus that neither hears nor acknowledges; silent until it is told to begin."""

    def __init__(self) -> None:
        self.outbox: Outbox = deque()
        self.listening = False
        self.address: int | None = None
        self.wake_ns = NEVER
        self._babbles = False

    def begin(self, now_ns: int, frame: Frame) -> None:
        """Send this frame over and over, from now on."""
        self._babbles = True
        self.outbox.append((now_ns, frame))

    def end(self, _: int) -> None:
        """Be silent again."""
        self._babbles = False
        self.outbox.clear()

    def receive(self, now_ns: int, frame: Frame) -> None:
        """It does not listen."""

    def sent(self, now_ns: int, frame: Frame) -> None:
        """And again."""
        if self._babbles:
            self.outbox.append((now_ns, frame))

    def wake(self, now_ns: int) -> None:
        """It does nothing by itself."""
