"""What all simulated serial CAN adapters have in common: bytes that take time on the line, a bus, and what goes wrong.

With a baud rate each byte takes ten bits in either direction; without one (USB CDC) bytes take no time. The transmit
buffer is finite, and what does not fit is lost.

Not modelled: USB frame times.
"""

from __future__ import annotations

import heapq
import itertools
import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from sim.bus import Arrivals, Frame, Outbox
from sim.drives.ramp import NEVER

FLAG_RECEIVE_FULL, FLAG_TRANSMIT_FULL = 0x01, 0x02

Message = TypeVar("Message")
"""What the host's bytes mean to a kind of adapter."""


@dataclass(frozen=True)
class LineFault:
    """What happens to a share (0 to 1) of the frames on their way to the host.

    Attributes:
        kind: "twice", "late" or "cut".
        delay_ns: until the frame comes again, or at all, or the rest of it; None never.
        strikes: tells the frames it strikes; None all.
    """

    kind: Literal["twice", "late", "cut"]
    share: float
    delay_ns: int | None
    strikes: Callable[[Frame], bool] | None = None


class SerialAdapter(ABC, Generic[Message]):
    """A node of the bus whose other side is a serial port; its kind is a class of its own.

    Args:
        bus_bitrate: rate of the bus it is plugged into; at another rate it is deaf and dumb.
        baud: rate of a true UART, None for USB CDC.
        depth: frames its transmit buffer holds.
        echo: whether it reports its own transmissions as received frames.
        seed: of the corruption of bytes.

    Attributes:
        outbox: frames waiting for the bus.
        is_open: whether it is on the bus.
        refuses_open: fault, it does not go there.
        corruption: fault, share of bytes to the host that are changed.
        lost_frames: transmissions lost because the buffer was full.
        depth: frames its transmit buffer holds.
        line_faults: faults, what happens to frames on their way to the host.
        refusals: fault, share of transmissions that are lost, and refused by an adapter that can say so.
        takes_characters: fault if not, the host's bytes wait on the host's side: `feed` nothing.
        lost_receptions: received frames lost because the host's side of it was stuck.
    """

    def __init__(
        self,
        bus_bitrate: int,
        *,
        baud: int | None = None,
        depth: int = 64,
        echo: bool = False,
        seed: int = 0,
    ) -> None:
        self.outbox: Outbox = deque()
        self.wake_ns = NEVER
        self.listening = False
        self.address: int | None = None
        self.is_open = False
        self.refuses_open = False
        self.corruption = 0.0
        self.lost_frames = 0
        self.depth = depth
        self.line_faults: list[LineFault] = []
        self.refusals = 0.0
        self.takes_characters = True
        self.lost_receptions = 0
        self._stalled: list[bytes] | None = None
        self._stall_depth = 0
        self._held: list[tuple[int, int, bytes]] = []
        self._order = itertools.count()
        self._bus_bitrate = bus_bitrate
        self._bitrate: int | None = None
        self._byte_ns = 10_000_000_000 // baud if baud else 0
        self._echo = echo
        self._random = random.Random(seed)
        self._flags = 0
        self._messages: deque[tuple[int, Message]] = deque()
        self._received_ns = 0
        self._unheard = 0
        self._replies: deque[tuple[int, bytes]] = deque()
        self._free_ns = 0

    # -- what a kind of adapter does -------------------------------------------------------------------

    @abstractmethod
    def _split(self, data: bytes) -> Iterator[tuple[int, Message]]:
        """What the host's bytes mean, each with the number of these bytes at which it is complete."""

    @abstractmethod
    def _act(self, now_ns: int, message: Message) -> None:
        """Do what the host has asked for."""

    @abstractmethod
    def _spelt(self, now_ns: int, frame: Frame) -> bytes:
        """A received frame as the host is told of it; nothing where it is not."""

    # -- the host's side -----------------------------------------------------------------------------

    def feed(self, now_ns: int, data: bytes) -> None:
        """Bytes the host wrote at `now_ns`; what they ask for is done when the last of it has arrived."""
        begin_ns = max(now_ns, self._received_ns)
        self._received_ns = begin_ns + len(data) * self._byte_ns
        for position, message in self._split(data):
            if self._byte_ns:
                self._messages.append((begin_ns + position * self._byte_ns, message))
                self._schedule()
            else:
                self._act(now_ns, message)

    def arrivals(self, now_ns: int) -> Arrivals:
        """What is at the host by `now_ns`: whole lines, each with the time of its last byte, then a part of one."""
        parts = []
        while self._replies:
            due_ns, data = self._replies[0]
            if due_ns > now_ns:
                late = -((now_ns - due_ns) // self._byte_ns) if self._byte_ns else len(data)
                if late < len(data):
                    parts.append((now_ns, data[:-late]))
                    self._replies[0] = (due_ns, data[-late:])
                break
            parts.append(self._replies.popleft())
        return parts

    def next_due_ns(self) -> int:
        """When the next finished line has arrived at the host."""
        return self._replies[0][0] if self._replies else NEVER

    # -- the bus's side ------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> None:
        """A frame of another node, which is passed on to the host."""
        self._report(now_ns, frame)

    def sent(self, now_ns: int, frame: Frame) -> None:
        """A frame of its own went out."""
        if self._echo and self.is_open:
            self._report(now_ns, frame)

    def _report(self, now_ns: int, frame: Frame) -> None:
        line = self._spelt(now_ns, frame)
        if not line:
            return
        for fault in self.line_faults:
            if not line:
                break
            mine = fault.strikes is None or fault.strikes(frame)
            if mine and self._random.random() < fault.share:
                cut = {"twice": len(line), "late": 0, "cut": self._random.randrange(1, len(line))}[fault.kind]
                if fault.delay_ns is not None:
                    again = line if fault.kind == "twice" else line[cut:]
                    heapq.heappush(self._held, (now_ns + fault.delay_ns, next(self._order), again))
                    self._schedule()
                line = line[:cut]
        self._pass_on(now_ns, line)

    def wake(self, now_ns: int) -> None:
        """Do what the host has asked for with bytes that have arrived by now."""
        while self._messages and self._messages[0][0] <= now_ns:
            due_ns, message = self._messages.popleft()
            self._act(due_ns, message)
        while self._held and self._held[0][0] <= now_ns:
            due_ns, _, part = heapq.heappop(self._held)
            self._pass_on(due_ns, part)
        self._schedule()

    def _join(self) -> None:
        """Go on the bus, where its rate is that of the bus; a fault keeps it away."""
        if self.refuses_open or self._bitrate is None:
            return
        self.is_open = True
        self.listening = self._bitrate == self._bus_bitrate

    def _leave(self) -> None:
        """Leave the bus, and drop what was meant for it."""
        self.is_open = self.listening = False
        self.outbox.clear()
        self._unheard = 0

    def _transmit(self, now_ns: int, frame: Frame) -> bool:
        """Take a frame for the bus; False for one that is lost."""
        if self.refusals and self._random.random() < self.refusals:
            return False
        if len(self.outbox) + self._unheard >= self.depth:
            self._flags |= FLAG_TRANSMIT_FULL
            self.lost_frames += 1
            return False
        if self._bitrate != self._bus_bitrate:
            self._unheard += 1
        else:
            self.outbox.append((now_ns, frame))
        return True

    # -- what goes wrong -----------------------------------------------------------------------------

    def stall(self, depth: int) -> None:
        """Pass nothing on to the host any more; keep `depth` frames."""
        self._stalled, self._stall_depth = [], depth

    def recover(self, now_ns: int) -> None:
        """Say everything that was kept."""
        kept, self._stalled = self._stalled or [], None
        for line in kept:
            self._say(now_ns, line)

    # -- within ---------------------------------------------------------------------------------------

    def _schedule(self) -> None:
        message_ns = self._messages[0][0] if self._messages else NEVER
        held_ns = self._held[0][0] if self._held else NEVER
        self.wake_ns = min(message_ns, held_ns)

    def _pass_on(self, now_ns: int, line: bytes) -> None:
        """Say a received frame, unless the host's side is stuck."""
        if self._stalled is None:
            self._say(now_ns, line)
        elif len(self._stalled) < self._stall_depth:
            self._stalled.append(line)
        else:
            self.lost_receptions += 1
            self._flags |= FLAG_RECEIVE_FULL

    def _say(self, now_ns: int, data: bytes) -> None:
        if self.corruption:
            data = bytes(
                byte ^ (1 << self._random.randrange(8)) if self._random.random() < self.corruption else byte
                for byte in data
            )
        self._free_ns = max(now_ns, self._free_ns) + len(data) * self._byte_ns
        self._replies.append((self._free_ns, data))
