"""A CAN interface of the system as a node of the simulated bus: frames as raw CAN sockets read and write them.

`struct can_frame` of linux/can.h, 16 bytes: identifier with its flags, length, data. What the host writes goes into a
queue of finite length (txqueuelen); what finds no room is lost, as ENOBUFS says of a real one.
"""

from __future__ import annotations

import struct
from collections import deque

from sim.bus import Arrivals, Frame, Outbox
from sim.drives.ramp import NEVER

RECORD = struct.Struct("=IB3x8s")
EXTENDED, REMOTE = 0x80000000, 0x40000000
EXTENDED_MASK, STANDARD_MASK = 0x1FFFFFFF, 0x7FF
LONGEST_DATA = 8


def packed(frame: Frame) -> bytes:
    """A frame as a raw CAN socket has it."""
    word = frame.can_id | (EXTENDED if frame.extended else 0) | (REMOTE if frame.remote else 0)
    return RECORD.pack(word, len(frame.data), b"" if frame.remote else frame.data)


def unpacked(record: bytes) -> Frame:
    """The frame in one record; raises ValueError for what is none."""
    word, length, content = RECORD.unpack(record)
    if length > LONGEST_DATA:
        raise ValueError(f"a CAN frame has at most {LONGEST_DATA} data bytes, not {length}.")
    extended = bool(word & EXTENDED)
    can_id = word & (EXTENDED_MASK if extended else STANDARD_MASK)
    remote = bool(word & REMOTE)
    return Frame(can_id, bytes(length) if remote else content[:length], extended, remote)


class CanInterface:
    """A node of the bus whose other side is a raw CAN socket.

    Args:
        queue: frames it holds back for the bus.

    Attributes:
        outbox: frames waiting for the bus.
        lost_frames: transmissions lost because the queue was full.
        queue: frames it holds back for the bus.
    """

    def __init__(self, queue: int = 128) -> None:
        self.outbox: Outbox = deque()
        self.wake_ns = NEVER
        self.listening = True
        self.address: int | None = None
        self.lost_frames = 0
        self.queue = queue
        self._records: deque[tuple[int, bytes]] = deque()

    def feed(self, now_ns: int, data: bytes) -> None:
        """Whole frames the host wrote at `now_ns`; raises ValueError for what is none."""
        if len(data) % RECORD.size:
            raise ValueError(f"{len(data)} bytes are no whole number of CAN frames of {RECORD.size} bytes.")
        for at in range(0, len(data), RECORD.size):
            frame = unpacked(data[at : at + RECORD.size])
            if len(self.outbox) >= self.queue:
                self.lost_frames += 1
                continue
            self.outbox.append((now_ns, frame))

    def arrivals(self, now_ns: int) -> Arrivals:
        """The frames that have arrived by `now_ns`, each with its time."""
        parts = []
        while self._records and self._records[0][0] <= now_ns:
            parts.append(self._records.popleft())
        return parts

    def next_due_ns(self) -> int:
        """When the next frame has arrived."""
        return self._records[0][0] if self._records else NEVER

    def receive(self, now_ns: int, frame: Frame) -> None:
        """Pass a frame on to the host."""
        self._records.append((now_ns, packed(frame)))

    def sent(self, now_ns: int, frame: Frame) -> None:
        """Its own frame went out; the sending socket does not hear it."""

    def wake(self, now_ns: int) -> None:
        """It does nothing of its own accord."""
