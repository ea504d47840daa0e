"""The serial CAN adapter that speaks SLCAN: characters on one side, frames on the other.

Three dialects (can-adapters.md section 1). `lawicel` answers every command, CR (`z` CR, `Z` CR for a transmission) or
BEL for an error. `canable`, the original firmware, answers nothing whatever happens, has no `L`, and `M1` makes it
silent until `M0`. `canable2` (Nakakiyo) answers as lawicel does, says who it is in free text, has S9, stamps of
microseconds (Z2), and the first two bits of `F` the other way round. Rates are taken only while the channel is closed.

Commands: S0 to S8, O, L, C, t T r R, V, N, F, and Z0 Z1 for the stamps. Raw timing (`s`), filters and polling are not
modelled: they are errors. An empty line is answered like a command that did nothing [inf].
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from sim.bus import Frame
from sim.serial_adapter import FLAG_RECEIVE_FULL, FLAG_TRANSMIT_FULL, SerialAdapter

Dialect = Literal["lawicel", "canable", "canable2"]
DIALECTS: tuple[Dialect, ...] = ("lawicel", "canable", "canable2")

BITRATES = {
    b"0": 10_000,
    b"1": 20_000,
    b"2": 50_000,
    b"3": 100_000,
    b"4": 125_000,
    b"5": 250_000,
    b"6": 500_000,
    b"7": 800_000,
    b"8": 1_000_000,
}
OTHER_BITRATES: dict[Dialect, dict[bytes, int]] = {
    "lawicel": {},
    "canable": {b"7": 750_000},
    "canable2": {b"9": 83_333},
}
OK, ERROR = b"\r", b"\x07"
HEX_DIGITS = b"0123456789ABCDEFabcdef"
LONGEST_LINE = 64
CANABLE_BITRATE = 500_000
FLAG_PASSIVE, FLAG_BUS_ERROR = 0x20, 0x80
VERSION = {"lawicel": b"V1013\r", "canable2": b"VT canable2 b158aa7 github.com/Nakakiyo092\r"}


class SlcanAdapter(SerialAdapter[bytes | None]):
    """An SLCAN adapter; see `SerialAdapter`.

    Args:
        dialect: how it answers.
    """

    def __init__(
        self,
        bus_bitrate: int,
        *,
        dialect: Dialect = "lawicel",
        baud: int | None = None,
        depth: int = 64,
        echo: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__(bus_bitrate, baud=baud, depth=depth, echo=echo, seed=seed)
        self._dialect = dialect
        self._bitrate = CANABLE_BITRATE if dialect == "canable" else None
        self._listen_only = False
        self._is_silent = False
        self._stamps = b"0"
        self._line = bytearray()
        self._overlong = False

    def _split(self, data: bytes) -> Iterator[tuple[int, bytes | None]]:
        position = 0
        while (end := data.find(b"\r", position)) >= 0:
            self._gather(data[position:end])
            position = end + 1
            line = None if self._overlong else bytes(self._line)
            self._line.clear()
            self._overlong = False
            yield position, line
        self._gather(data[position:])

    def _spelt(self, now_ns: int, frame: Frame) -> bytes:
        if frame.extended:
            head = ("R" if frame.remote else "T") + f"{frame.can_id:08X}{len(frame.data)}"
        else:
            head = ("r" if frame.remote else "t") + f"{frame.can_id:03X}{len(frame.data)}"
        tail = "" if frame.remote else frame.data.hex().upper()
        stamp = {
            b"0": "",
            b"1": f"{now_ns // 1_000_000 % 60_000:04X}",
            b"2": f"{now_ns // 1_000 % (1 << 32):08X}",
        }[self._stamps]
        return f"{head}{tail}{stamp}\r".encode()

    def _gather(self, data: bytes) -> None:
        self._line += data
        if len(self._line) > LONGEST_LINE:
            self._line.clear()
            self._overlong = True

    def _act(self, now_ns: int, message: bytes | None) -> None:
        answer = ERROR
        if message is not None:
            name, rest = message[:1], message[1:]
            if name in (b"T", b"t", b"R", b"r"):
                answer = self._transmit_line(now_ns, name, rest)
            else:
                answer = self._manage(name, rest)
        if self._dialect != "canable":
            self._say(now_ns, answer)

    def _manage(self, name: bytes, rest: bytes) -> bytes:
        if name == b"":
            return OK
        if name == b"S" and not self.is_open:
            self._bitrate = {**BITRATES, **OTHER_BITRATES[self._dialect]}.get(rest, self._bitrate)
            return OK if rest in BITRATES or rest in OTHER_BITRATES[self._dialect] else ERROR
        if name in (b"O", b"L") and not rest and not self.is_open and (name == b"O" or self._dialect != "canable"):
            self._listen_only = name == b"L" or self._is_silent
            self._flags = 0
            self._join()
            return OK if self.is_open else ERROR
        if name == b"C" and not rest and self.is_open:
            self._leave()
            return OK
        if name == b"M" and self._dialect == "canable" and not self.is_open and rest in (b"0", b"1"):
            self._is_silent = rest == b"1"
            return OK
        if name == b"V" and not rest:
            return VERSION.get(self._dialect, b"")
        if name == b"N" and not rest:
            return b"NA123\r"
        if name == b"F" and not rest and self.is_open:
            return b"F%02X\r" % self._take_flags()
        if (
            name == b"Z"
            and not self.is_open
            and rest in ((b"0", b"1", b"2")[: 3 if self._dialect == "canable2" else 2])
        ):
            self._stamps = rest
            return OK
        return ERROR

    def _take_flags(self) -> int:
        flags, self._flags = self._flags, 0
        if self._dialect == "canable2":
            receive, transmit = flags & FLAG_RECEIVE_FULL, flags & FLAG_TRANSMIT_FULL
            flags = receive << 1 | transmit >> 1
        return flags | (FLAG_PASSIVE | FLAG_BUS_ERROR if self._unheard else 0)

    def _transmit_line(self, now_ns: int, name: bytes, rest: bytes) -> bytes:
        extended, remote = name in b"TR", name in b"rR"
        digits = 8 if extended else 3
        if len(rest) <= digits or rest.translate(None, HEX_DIGITS):
            return ERROR
        can_id, length = int(rest[:digits], 16), int(rest[digits : digits + 1], 16)
        if length > 8 or len(rest) != digits + 1 + (0 if remote else 2 * length):
            return ERROR
        data = bytes(length) if remote else bytes.fromhex(rest[digits + 1 :].decode())
        if can_id > (0x1FFFFFFF if extended else 0x7FF) or not self.is_open or self._listen_only:
            return ERROR
        if not self._transmit(now_ns, Frame(can_id, data, extended, remote)):
            return ERROR
        return b"Z\r" if extended else b"z\r"
