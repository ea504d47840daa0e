"""The serial CAN adapter: SLCAN characters on one side, frames on the other.

Two dialects (can-adapters.md section 1): `lawicel` answers every command, CR (`z` CR, `Z` CR for a
transmission) or BEL for an error; `canable` answers nothing, whatever happens. Rates are taken only
while the channel is closed; the transmit buffer is finite, what does not fit is lost (BEL, and bit 1
of the flags that `F` reads). With a baud rate each character takes ten bits in either direction;
without one (USB CDC) characters take no time.

Commands: S0-S6 S8, O, L, C, t T r R, V, N, F, and Z0 Z1 for the stamps. S7 and S9 mean different rates
in different firmwares, and raw timing (`s`), filters and polling are not modelled: they are errors.
An empty line is answered like a command that did nothing [inf].

Not modelled: USB frame times.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from sim.bus import Frame, Outbox
from sim.drives.ramp import NEVER

Dialect = Literal["lawicel", "canable"]

BITRATES = {
    b"0": 10_000,
    b"1": 20_000,
    b"2": 50_000,
    b"3": 100_000,
    b"4": 125_000,
    b"5": 250_000,
    b"6": 500_000,
    b"8": 1_000_000,
}
OK, ERROR = b"\r", b"\x07"
HEX_DIGITS = b"0123456789ABCDEFabcdef"
LONGEST_LINE = 64
CANABLE_BITRATE = 500_000
FLAG_RECEIVE_FULL, FLAG_TRANSMIT_FULL, FLAG_PASSIVE, FLAG_BUS_ERROR = 0x01, 0x02, 0x20, 0x80


@dataclass(frozen=True)
class LineFault:
    """What happens to a share (0 to 1) of the lines of frames on their way to the host.

    Attributes:
        kind: "twice", "late" or "cut".
        delay_ns: until the line comes again, or at all, or the rest of it; None never.
        strikes: tells the frames it strikes; None all.
    """

    kind: Literal["twice", "late", "cut"]
    share: float
    delay_ns: int | None
    strikes: Callable[[Frame], bool] | None = None


class SlcanAdapter:
    """A node of the bus whose other side is a serial port.

    Args:
        bus_bitrate: rate of the bus it is plugged into; at another rate it is deaf and dumb.
        dialect: how it answers.
        baud: rate of a true UART, None for USB CDC.
        depth: frames its transmit buffer holds.
        echo: whether it reports its own transmissions as received frames.
        seed: of the corruption of bytes.

    Attributes:
        outbox: frames waiting for the bus.
        is_open: whether the channel is open.
        refuses_open: fault, `O` and `L` are errors.
        corruption: fault, share of bytes to the host that are changed.
        lost_frames: transmissions lost because the buffer was full.
        depth: frames its transmit buffer holds.
        line_faults: faults, what happens to lines on their way to the host.
        refusals: fault, share of transmissions that are answered BEL and lost.
        takes_characters: fault if not, the host's characters wait on the host's side: `feed` nothing.
        lost_receptions: received frames lost because the host's side of it was stuck.
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
        self._bitrate: int | None = CANABLE_BITRATE if dialect == "canable" else None
        self._answers = dialect == "lawicel"
        self._byte_ns = 10_000_000_000 // baud if baud else 0
        self._echo = echo
        self._random = random.Random(seed)
        self._listen_only = False
        self._stamped = False
        self._flags = 0
        self._line = bytearray()
        self._overlong = False
        self._lines: deque[tuple[int, bytes | None]] = deque()
        self._received_ns = 0
        self._unheard = 0
        self._replies: deque[tuple[int, bytes]] = deque()
        self._free_ns = 0

    # -- the host's side -----------------------------------------------------------------------------

    def feed(self, now_ns: int, data: bytes) -> None:
        """Characters the host wrote at `now_ns`; commands act when their last one has arrived."""
        begin_ns = max(now_ns, self._received_ns)
        self._received_ns = begin_ns + len(data) * self._byte_ns
        position = 0
        while (end := data.find(b"\r", position)) >= 0:
            self._gather(data[position:end])
            position = end + 1
            line = None if self._overlong else bytes(self._line)
            self._line.clear()
            self._overlong = False
            if self._byte_ns:
                self._lines.append((begin_ns + position * self._byte_ns, line))
                self._schedule()
            else:
                self._command(now_ns, line)
        self._gather(data[position:])

    def collect(self, now_ns: int) -> bytes:
        """The characters that have arrived at the host by `now_ns`."""
        parts = []
        while self._replies:
            due_ns, data = self._replies[0]
            if due_ns > now_ns:
                late = -((now_ns - due_ns) // self._byte_ns) if self._byte_ns else len(data)
                if late < len(data):
                    parts.append(data[:-late])
                    self._replies[0] = (due_ns, data[-late:])
                break
            parts.append(data)
            self._replies.popleft()
        return b"".join(parts)

    def next_due_ns(self) -> int:
        """When the next finished line has arrived at the host."""
        return self._replies[0][0] if self._replies else NEVER

    # -- the bus's side ------------------------------------------------------------------------------

    def receive(self, now_ns: int, frame: Frame) -> None:
        """Pass a frame on to the host."""
        if frame.extended:
            head = ("R" if frame.remote else "T") + f"{frame.can_id:08X}{len(frame.data)}"
        else:
            head = ("r" if frame.remote else "t") + f"{frame.can_id:03X}{len(frame.data)}"
        tail = "" if frame.remote else frame.data.hex().upper()
        stamp = f"{now_ns // 1_000_000 % 60_000:04X}" if self._stamped else ""
        line = f"{head}{tail}{stamp}\r".encode()
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

    def sent(self, now_ns: int, frame: Frame) -> None:
        """A frame of its own went out."""
        if self._echo and self.is_open:
            self.receive(now_ns, frame)

    def wake(self, now_ns: int) -> None:
        """Carry out the commands whose last character has arrived."""
        while self._lines and self._lines[0][0] <= now_ns:
            due_ns, line = self._lines.popleft()
            self._command(due_ns, line)
        while self._held and self._held[0][0] <= now_ns:
            due_ns, _, part = heapq.heappop(self._held)
            self._pass_on(due_ns, part)
        self._schedule()

    # -- what goes wrong -----------------------------------------------------------------------------

    def stall(self, depth: int) -> None:
        """Pass nothing on to the host any more; keep `depth` frames."""
        self._stalled, self._stall_depth = [], depth

    def recover(self, now_ns: int) -> None:
        """Say everything that was kept."""
        kept, self._stalled = self._stalled or [], None
        for line in kept:
            self._say(now_ns, line)

    # -- commands ------------------------------------------------------------------------------------

    def _gather(self, data: bytes) -> None:
        self._line += data
        if len(self._line) > LONGEST_LINE:
            self._line.clear()
            self._overlong = True

    def _command(self, now_ns: int, line: bytes | None) -> None:
        answer = ERROR
        if line is not None:
            name, rest = line[:1], line[1:]
            if name in (b"T", b"t", b"R", b"r"):
                answer = self._transmit(now_ns, name, rest)
            else:
                answer = self._manage(name, rest)
        if self._answers:
            self._say(now_ns, answer)

    def _manage(self, name: bytes, rest: bytes) -> bytes:
        if name == b"":
            return OK
        if name == b"S" and not self.is_open and rest in BITRATES:
            self._bitrate = BITRATES[rest]
            return OK
        if name in (b"O", b"L") and not rest and not self.is_open:
            if self.refuses_open or self._bitrate is None:
                return ERROR
            self.is_open = True
            self._listen_only = name == b"L"
            self.listening = self._bitrate == self._bus_bitrate
            self._flags = 0
            return OK
        if name == b"C" and not rest and self.is_open:
            self.is_open = self.listening = False
            self.outbox.clear()
            self._unheard = 0
            return OK
        if name == b"V" and not rest:
            return b"V1013\r"
        if name == b"N" and not rest:
            return b"NA123\r"
        if name == b"F" and not rest and self.is_open:
            flags, self._flags = self._flags, 0
            if self._unheard:
                flags |= FLAG_PASSIVE | FLAG_BUS_ERROR
            return b"F%02X\r" % flags
        if name == b"Z" and not self.is_open and rest in (b"0", b"1"):
            self._stamped = rest == b"1"
            return OK
        return ERROR

    def _transmit(self, now_ns: int, name: bytes, rest: bytes) -> bytes:
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
        if self.refusals and self._random.random() < self.refusals:
            return ERROR
        if len(self.outbox) + self._unheard >= self.depth:
            self._flags |= FLAG_TRANSMIT_FULL
            self.lost_frames += 1
            return ERROR
        if self._bitrate != self._bus_bitrate:
            self._unheard += 1
        else:
            self.outbox.append((now_ns, Frame(can_id, data, extended, remote)))
        return b"Z\r" if extended else b"z\r"

    def _schedule(self) -> None:
        line_ns = self._lines[0][0] if self._lines else NEVER
        held_ns = self._held[0][0] if self._held else NEVER
        self.wake_ns = min(line_ns, held_ns)

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
