"""The CAN bus: how long frames take, who goes first, and who hears what.

Every frame occupies the bus for its real number of bits: header, data and CRC-15 with the stuff bits
they happen to need, then delimiters, acknowledge, end of frame and the three bits of interframe space.
When several nodes want to send, the lowest identifier wins; one node's frames leave in their order.
A frame is received at the end of its end-of-frame field. A sender that nobody acknowledges repeats
itself until somebody does.

Not modelled: bit errors, error frames and bus-off; two nodes sending the same identifier at once.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from typing import NamedTuple, Protocol

from sim.drives.ramp import NEVER


class Frame(NamedTuple):
    """One classic CAN frame; of a remote frame `data` gives only the length."""

    can_id: int
    data: bytes
    extended: bool = True
    remote: bool = False


Outbox = deque[tuple[int, Frame]]
"""Frames a node wants to send, in its order, each with the time from which it is ready [ns]."""
Arrivals = list[tuple[int, bytes]]
"""Bytes for the host in their order, each with the time at which they were there [ns]."""


def joined(arrivals: Arrivals) -> bytes:
    """The bytes alone."""
    return b"".join(data for _, data in arrivals)


class Node(Protocol):
    """Something on the bus.

    Attributes:
        outbox: what it wants to send.
        listening: whether it hears frames and acknowledges them.
        address: None hears every frame. A number hears extended frames alone, those whose identifier is that number
            or 0 above its lowest byte (as ZDT drives are spoken to): it is only spared the others, and still checks.
        wake_ns: when it next does something of its own accord that others could notice.
    """

    outbox: Outbox
    listening: bool
    address: int | None
    wake_ns: int

    def receive(self, now_ns: int, frame: Frame) -> None:
        """A frame of another node has ended."""

    def sent(self, now_ns: int, frame: Frame) -> None:
        """A frame of its own has been sent and acknowledged."""

    def wake(self, now_ns: int) -> None:
        """`wake_ns` has come."""


_CRC_POLYNOMIAL = 0x4599
_INTERFRAME_BITS = 3
_SHORTEST_FRAME_BITS = 44
"""A standard frame without data nor stuff bits, up to the end of its end-of-frame field."""
_TAIL_BITS = 13
"""CRC delimiter, acknowledge slot and delimiter, end of frame, interframe space."""


def _crc_step(value: int) -> int:
    for _ in range(8):
        value = (value << 1) ^ (_CRC_POLYNOMIAL if value & 0x4000 else 0)
    return value & 0x7FFF


_CRC_TABLE = [_crc_step(top << 7) for top in range(256)]


def _stuff(last: int, run: int, byte: int, bits: int) -> tuple[int, int]:
    """Send the low `bits` of a byte after `run` bits equal to `last`: the new state, stuff bits needed.

    A state is (last bit * 4 + run - 1) * 256: where the row of the stuff table begins that goes on.
    """
    stuffed = 0
    for shift in range(bits - 1, -1, -1):
        bit = byte >> shift & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = 1 - bit, 1
    return (last * 4 + run - 1) * 256, stuffed


_STUFF_TABLE = [_stuff(last, run, byte, 8) for last in (0, 1) for run in (1, 2, 3, 4) for byte in range(256)]
_FIRST_BYTE = {idle: [_stuff(1, 0, byte, 8 - idle) for byte in range(1 << (8 - idle))] for idle in (1, 5)}


def frame_bits(frame: Frame) -> int:
    """Bits the frame occupies on the bus, stuff bits and interframe space included."""
    length = len(frame.data)
    if frame.extended:
        base, low = frame.can_id >> 18, frame.can_id & 0x3FFFF
        header, idle, size = base << 27 | 0b11 << 25 | low << 7 | frame.remote << 6 | length, 1, 5
    else:
        header, idle, size = frame.can_id << 7 | frame.remote << 6 | length, 5, 3
    # Start bit to data, after the `idle` bits that are missing to whole bytes; zeros leave the CRC at 0.
    content = header.to_bytes(size, "big") + (b"" if frame.remote else frame.data)
    crc = _CRC_TABLE[content[0]]
    state, stuffed = _FIRST_BYTE[idle][content[0]]
    for byte in content[1:]:
        crc = (crc << 8 & 0x7FFF) ^ _CRC_TABLE[(crc >> 7) ^ byte]
        state, more = _STUFF_TABLE[state + byte]
        stuffed += more
    # Fifteen bits of CRC, and one that fills the byte without prolonging the last run.
    for byte in (crc >> 7, crc << 1 & 0xFE | ~crc & 1):
        state, more = _STUFF_TABLE[state + byte]
        stuffed += more
    return len(content) * 8 - idle + 15 + stuffed + _TAIL_BITS


@lru_cache(maxsize=4096)
def frame_ns(frame: Frame, bitrate: int) -> int:
    """Time the frame occupies a bus."""
    return frame_bits(frame) * 1_000_000_000 // bitrate


def interframe_ns(bitrate: int) -> int:
    """Time between the end of a frame, when it is received, and the next."""
    return _INTERFRAME_BITS * 1_000_000_000 // bitrate


def began_ns(frame: Frame, received_ns: int, bitrate: int) -> int:
    """When a frame that was received at a time has begun."""
    return received_ns + interframe_ns(bitrate) - frame_ns(frame, bitrate)


class Bus:
    """The wire between the nodes; advanced by `run_until`.

    Attributes:
        bitrate: bits per second.
        busy_ns: time the bus has carried frames so far.
        frames: number of frames that have been on it.
    """

    def __init__(self, bitrate: int, start_ns: int) -> None:
        self.bitrate = bitrate
        self.nodes: list[Node] = []
        self.busy_ns = 0
        self.frames = 0
        self._clock_ns = start_ns
        self._free_ns = start_ns
        self._flying: tuple[int, Frame, Node] | None = None

    def run_until(self, now_ns: int) -> None:
        """Let everything happen that is due up to and including `now_ns`."""
        while True:
            waker: Node | None = None
            event_ns = NEVER
            senders = []
            for node in self.nodes:
                if node.wake_ns < event_ns:
                    event_ns, waker = node.wake_ns, node
                if node.outbox:
                    senders.append(node)
            if self._flying is None and senders and (winner := self._arbitrate(senders, min(event_ns, now_ns + 1))):
                self._start(*winner)
            if self._flying is not None and self._flying[0] <= event_ns:
                if self._flying[0] > now_ns:
                    return
                self._deliver(*self._flying)
                continue
            if waker is None or event_ns > now_ns:
                return
            self._clock_ns = max(self._clock_ns, event_ns)
            waker.wake(event_ns)

    def quiet_until_ns(self, listener: Node, answer_ns: int) -> int:
        """A time before which `listener` certainly receives nothing, unless it sends something new.

        Args:
            answer_ns: the least time any node takes to answer a frame.
        """
        free_ns, gap_ns = self._free_ns, interframe_ns(self.bitrate)
        answer_ns += _SHORTEST_FRAME_BITS * 1_000_000_000 // self.bitrate
        earliest = NEVER
        if self._flying is not None:
            ends_ns, _, sender = self._flying
            earliest = ends_ns + (answer_ns if sender is listener else 0)
        for node in self.nodes:
            due_ns = node.wake_ns
            if node.outbox and self._heard(node):
                ready_ns, frame = node.outbox[0]
                ends_ns = max(ready_ns, free_ns) + frame_ns(frame, self.bitrate) - gap_ns
                due_ns = min(due_ns, ends_ns + (answer_ns if node is listener else 0))
            earliest = min(earliest, due_ns)
        return earliest

    def _heard(self, sender: Node) -> bool:
        for node in self.nodes:  # noqa: SIM110 (asked for every frame, and this is twice as fast)
            if node.listening and node is not sender:
                return True
        return False

    def _arbitrate(self, senders: list[Node], before_ns: int) -> tuple[int, Node] | None:
        """The next frame to start on the free bus: when, and whose; None if not before `before_ns`."""
        earliest_ns, first, alone = NEVER, None, True
        for node in senders:
            if self._heard(node):
                alone = first is None
                first = first or node
                earliest_ns = min(earliest_ns, node.outbox[0][0])
        start_ns = max(earliest_ns, self._free_ns, self._clock_ns)
        if first is None or start_ns >= before_ns:
            return None
        if alone:
            return start_ns, first
        ready = [node for node in senders if node.outbox[0][0] <= start_ns and self._heard(node)]
        return start_ns, min(ready, key=_arbitration_rank)

    def _start(self, now_ns: int, winner: Node) -> None:
        frame = winner.outbox.popleft()[1]
        duration_ns = frame_ns(frame, self.bitrate)
        self._clock_ns = now_ns
        self._free_ns = now_ns + duration_ns
        self.busy_ns += duration_ns
        self.frames += 1
        ends_ns = self._free_ns - interframe_ns(self.bitrate)
        self._flying = (ends_ns, frame, winner)

    def _deliver(self, ends_ns: int, frame: Frame, sender: Node) -> None:
        self._flying = None
        self._clock_ns = ends_ns
        sender.sent(ends_ns, frame)
        heard = (None, frame.can_id >> 8) if frame.extended else (None,)
        everybody = frame.extended and frame.can_id < 0x100
        for node in self.nodes:
            if node is not sender and node.listening and (everybody or node.address in heard):
                node.receive(ends_ns, frame)


def _arbitration_rank(node: Node) -> int:
    """Bits of its next frame that are compared in arbitration, as a number: the lowest wins."""
    frame = node.outbox[0][1]
    if frame.extended:
        return (frame.can_id >> 18) << 21 | 0b11 << 19 | (frame.can_id & 0x3FFFF) << 1 | frame.remote
    return frame.can_id << 21 | frame.remote << 20
