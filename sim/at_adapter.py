"""The serial adapter that RobStride and CyberGear drives come with (can-adapters.md section 3).

It answers its handshake with OK [inf] and is on the bus from then on, at 1 Mbit/s. Frames with standard identifiers and
remote frames it does not carry [inf]. What ends wrongly is dropped whole [inf, the worst case].
"""

from __future__ import annotations

from collections.abc import Iterator

from sim.bus import Frame
from sim.serial_adapter import SerialAdapter

HANDSHAKE = b"AT+AT\r\n"
AGREED = b"OK\r\n"
BITRATE = 1_000_000
HEAD = b"AT"
TAIL = b"\r\n"
EXTENDED = 4


class AtAdapter(SerialAdapter[Frame | None]):
    """An AT adapter; see `SerialAdapter`. What the host asks for is a frame, or None for the handshake."""

    def __init__(
        self, bus_bitrate: int, *, baud: int | None = None, depth: int = 64, echo: bool = False, seed: int = 0
    ) -> None:
        super().__init__(bus_bitrate, baud=baud, depth=depth, echo=echo, seed=seed)
        self._rest = b""
        self._bitrate = BITRATE

    def _split(self, data: bytes) -> Iterator[tuple[int, Frame | None]]:
        before = len(self._rest)
        waiting = self._rest + data
        at = 0
        while (at := waiting.find(HEAD[:1], at)) >= 0:
            piece = waiting[at : at + 17]
            if HANDSHAKE.startswith(piece[:7]) or (HEAD.startswith(piece[:2]) and len(piece) < 7):
                if len(piece) < 7:
                    break
                at += len(HANDSHAKE)
                yield max(at - before, 0), None
                continue
            size = 9 + piece[6] if piece[:2] == HEAD and piece[6] <= 8 else 0
            if len(piece) < size:
                break
            word = int.from_bytes(piece[2:6], "big")
            at += max(size, 1)
            if size and piece[size - 2 : size] == TAIL and word & 7 == EXTENDED:
                yield max(at - before, 0), Frame(word >> 3, piece[7 : size - 2])
        self._rest = b"" if at < 0 else waiting[at:]

    def _act(self, now_ns: int, message: Frame | None) -> None:
        if message is not None:
            if self.is_open:
                self._transmit(now_ns, message)
            return
        self._join()
        if self.is_open:
            self._say(now_ns, AGREED)

    def _spelt(self, now_ns: int, frame: Frame) -> bytes:
        if not frame.extended or frame.remote:
            return b""
        word = (frame.can_id << 3 | EXTENDED).to_bytes(4, "big")
        return HEAD + word + bytes((len(frame.data),)) + frame.data + TAIL
