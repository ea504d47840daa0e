"""A Seeed or Waveshare USB-CAN-A adapter in its variable-length framing (can-adapters.md section 2).

It answers nothing but a question for its status, and is not on the bus before it is set up. What it is set to, standard
or extended, is what it delivers; it sends both [inf]. What ends wrongly is dropped whole [inf, the worst case]. Byte 14
of its set-up says whether a frame that loses the bus to another is sent again (00) or lost (01).

Not modelled: the fixed framing (set to that it leaves the bus); that a frame sent once is lost, too, where no node
acknowledges it.
"""

from __future__ import annotations

from collections.abc import Iterator

from sim.bus import Frame, began_ns
from sim.serial_adapter import SerialAdapter

START, FIXED, END = 0xAA, 0x55, 0x55
FIXED_BYTES = 20
VARIABLE_SET_UP, FIXED_SET_UP, STATUS = 0x12, 0x02, 0x04
BITRATES = (1_000_000, 800_000, 500_000, 400_000, 250_000, 200_000, 125_000, 100_000, 50_000, 20_000, 10_000, 5_000)
"""In the order of their bytes, which count from 1."""
NORMAL = 0
SENT_ONCE = 1


def checked(content: bytes) -> bytes:
    """`AA 55`, 17 bytes and their sum."""
    return bytes((START, FIXED)) + content + bytes((sum(content) & 0xFF,))


class SeeedAdapter(SerialAdapter[Frame | bytes]):
    """A USB-CAN-A; see `SerialAdapter`. What the host asks for is a frame, or 20 bytes that manage the adapter.

    Attributes:
        lost_arbitrations: how often a frame of its lost the bus to another.
    """

    def __init__(
        self, bus_bitrate: int, *, baud: int | None = None, depth: int = 64, echo: bool = False, seed: int = 0
    ) -> None:
        super().__init__(bus_bitrate, baud=baud, depth=depth, echo=echo, seed=seed)
        self._rest = b""
        self._extended = False
        self._sends_once = False
        self.lost_arbitrations = 0

    def _split(self, data: bytes) -> Iterator[tuple[int, Frame | bytes]]:
        before = len(self._rest)
        waiting = self._rest + data
        at = 0
        while (at := waiting.find(START, at)) >= 0:
            size = _size(waiting[at:])
            if size is None or len(waiting) - at < size:
                break
            piece = waiting[at : at + size]
            at += max(size, 1)
            message = _meaning(piece) if size else None
            if message is not None:
                yield max(at - before, 0), message
        self._rest = b"" if at < 0 else waiting[at:]

    def _act(self, now_ns: int, message: Frame | bytes) -> None:
        if isinstance(message, Frame):
            if self.is_open:
                self._transmit(now_ns, message)
        elif message[2] == STATUS:
            errors = min(self._unheard, 255)
            self._say(now_ns, checked(bytes((STATUS, 0, errors)) + bytes(14)))
        elif message[2] in (VARIABLE_SET_UP, FIXED_SET_UP) and 1 <= message[3] <= len(BITRATES):
            self._leave()
            self._bitrate = BITRATES[message[3] - 1]
            self._extended = message[4] == 2
            self._sends_once = message[14] == SENT_ONCE
            if message[2] == VARIABLE_SET_UP and message[13] == NORMAL:
                self._join()

    def receive(self, now_ns: int, frame: Frame) -> None:
        """A frame of another node; the first of its own, if that was ready when this one began, lost the bus to it."""
        if self.outbox and self.outbox[0][0] <= began_ns(frame, now_ns, self._bus_bitrate):
            self.lost_arbitrations += 1
            if self._sends_once:
                self.outbox.popleft()
        super().receive(now_ns, frame)

    def _spelt(self, now_ns: int, frame: Frame) -> bytes:
        if frame.extended != self._extended:
            return b""
        kind = 0xC0 | frame.extended << 5 | frame.remote << 4 | len(frame.data)
        number = frame.can_id.to_bytes(4 if frame.extended else 2, "little")
        return bytes((START, kind)) + number + (b"" if frame.remote else frame.data) + bytes((END,))


def _size(piece: bytes) -> int | None:
    """Bytes of what begins here with AA; 0 if it is nothing, None if that is not known yet."""
    if len(piece) < 2:
        return None
    if piece[1] == FIXED:
        return FIXED_BYTES
    if piece[1] & 0xC0 != 0xC0 or piece[1] & 0x0F > 8:
        return 0
    return 3 + (4 if piece[1] & 0x20 else 2) + (0 if piece[1] & 0x10 else piece[1] & 0x0F)


def _meaning(piece: bytes) -> Frame | bytes | None:
    """A whole piece; None when its end is wrong."""
    if piece[1] == FIXED:
        return piece if piece == checked(piece[2:-1]) else None
    extended, remote, length = bool(piece[1] & 0x20), bool(piece[1] & 0x10), piece[1] & 0x0F
    number = int.from_bytes(piece[2 : 6 if extended else 4], "little")
    if piece[-1] != END or number > (0x1FFFFFFF if extended else 0x7FF):
        return None
    return Frame(number, bytes(length) if remote else piece[-1 - length : -1], extended, remote)
