"""The two wires a scan speaks through: a serial adapter's lines, and a CAN interface of the system.

A scan is over before any control process is there, so these are ordinary Python and wait for what they want to know.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import socket
import struct
import time
from collections import deque
from typing import NamedTuple, Protocol

from config.frames import STANDARD_MASK
from config.serial_adapters import SLCAN_BITRATES
from rtloop.wire.can_words import ERROR_FLAG, EXTENDED_FLAG, EXTENDED_MASK

ANSWER_S = 0.15
"""For an adapter's answer to a command; as `rtloop.wire.tty` waits."""
BEL, CR = b"\x07", b"\r"
PASSIVE, BUS_ERROR = 0x20, 0x80
"""Bits of an adapter's flags (can-adapters.md 1): nobody acknowledges what it sends."""
FOREIGN = re.compile(rb"(?:t[0-7][0-9A-Fa-f]{2}|r[0-7][0-9A-Fa-f]{2}|R[01][0-9A-Fa-f]{7})[0-8]")
"""How the line of a frame begins that no drive sends (can-adapters.md 1)."""
MOST_STANDARD = 4096
"""Frames that are looked at for drives that speak by themselves: as many as half a second of a full, quick bus."""
_CAN_FRAME = struct.Struct("=IB3x8s")
_READ_BYTES = 4096


class Frame(NamedTuple):
    """A data frame."""

    id: int
    data: bytes
    extended: bool = True
    """Whether its identifier has 29 bits."""


class Wire(Protocol):
    """What a scan needs of a bus.

    Attributes:
        foreign: frames that came since it was opened and are none of a ZDT drive: standard identifiers, remote frames.
        standard: the newest of them that are data frames, at most `MOST_STANDARD`.
    """

    foreign: int
    standard: deque[Frame]

    def send(self, frame: Frame) -> None:
        """Send one frame; what does not leave is lost."""

    def receive(self, patience_s: float) -> list[Frame]:
        """Everything that comes within that time; returns when it is over."""

    def troubled(self) -> bool:
        """Whether the controller says that nobody acknowledges; False where it says nothing."""

    def now_s(self) -> float:
        """Some clock (s)."""


class Port(Protocol):
    """A serial port: characters in and out."""

    def write(self, data: bytes) -> None:
        """Give characters to it."""

    def read(self, patience_s: float) -> bytes:
        """What comes; empty when nothing did within that time."""

    def now_s(self) -> float:
        """Some clock (s)."""


class TtyPort:
    """A serial port that `rtloop.wire.tty.open_port` has opened."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def write(self, data: bytes) -> None:
        while data:
            if not select.select((), (self._fd,), (), ANSWER_S)[1]:
                return
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._fd, data) :]

    def read(self, patience_s: float) -> bytes:
        if not select.select((self._fd,), (), (), max(patience_s, 0.0))[0]:
            return b""
        return os.read(self._fd, _READ_BYTES)

    def now_s(self) -> float:
        return time.monotonic()


class SlcanWire:
    """A serial adapter that speaks SLCAN.

    Attributes:
        answers: whether it has answered any command; the original canable firmware never does.
        foreign: frames that came since its channel was opened and are none of a ZDT drive.
        standard: the newest of them that are data frames with a standard identifier.
    """

    def __init__(self, port: Port) -> None:
        self._port = port
        self._rest = b""
        self.answers = False
        self.foreign = 0
        self.standard: deque[Frame] = deque(maxlen=MOST_STANDARD)
        self.now_s = port.now_s

    def greet(self) -> bool:
        """Ask who it is and close its channel; whether anything came back that an SLCAN adapter says."""
        said = self._say(b"\rC\r") + self._say(b"V\r")
        self.answers = bool(said) and (said[-1:] in (CR, BEL) or said[:1] == b"V")
        return self.answers

    def open(self, bitrate: int, *, listen_only: bool) -> bool:
        """Open its channel; False when it refuses."""
        self.close()
        self.foreign = 0
        self.standard.clear()
        refused = BEL in self._say(SLCAN_BITRATES[bitrate].encode() + CR)
        return not refused and BEL not in self._say(b"L\r" if listen_only else b"O\r")

    def close(self) -> None:
        """Close its channel; it drops what it has not sent."""
        self._say(b"C\r")
        self._rest = b""

    def send(self, frame: Frame) -> None:
        head = b"T%08X%d" if frame.extended else b"t%03X%d"
        self._port.write(head % (frame.id, len(frame.data)) + frame.data.hex().upper().encode() + CR)

    def receive(self, patience_s: float) -> list[Frame]:
        frames = []
        until_s = self.now_s() + patience_s
        while (left_s := until_s - self.now_s()) > 0:
            *lines, self._rest = (self._rest + self._port.read(left_s)).split(CR)
            frames += [frame for line in lines if (frame := frame_of(line)) is not None]
            self.foreign += sum(FOREIGN.match(line.lstrip(BEL)) is not None for line in lines)
            self.standard += [frame for line in lines if (frame := standard_frame_of(line)) is not None]
        return frames

    def troubled(self) -> bool:
        for line in self._say(b"F\r").split(CR):
            with contextlib.suppress(ValueError):
                if line[:1] == b"F" and int(line[1:3], 16) & (PASSIVE | BUS_ERROR):
                    return True
        return False

    def _say(self, command: bytes) -> bytes:
        """What comes back within a short while, up to a CR or BEL at its end."""
        self._port.write(command)
        answer = b""
        until_s = self.now_s() + ANSWER_S
        while not answer.endswith((CR, BEL)) and (left_s := until_s - self.now_s()) > 0:
            answer += self._port.read(left_s)
        return answer


def frame_of(line: bytes) -> Frame | None:
    """The frame with an extended identifier in a line without its CR; None for any other line (can-adapters.md 1)."""
    return _frame_in(line, b"T", 8, EXTENDED_MASK)


def standard_frame_of(line: bytes) -> Frame | None:
    """The same of a standard identifier."""
    return _frame_in(line, b"t", 3, STANDARD_MASK)


def _frame_in(line: bytes, letter: bytes, digits: int, highest: int) -> Frame | None:
    line, head = line.lstrip(BEL), 2 + digits
    if line[:1] != letter or len(line) < head:
        return None
    try:
        frame_id, length = int(line[1 : head - 1], 16), int(line[head - 1 : head], 16)
        data = bytes.fromhex(line[head : head + 2 * length].decode("ascii"))
    except ValueError:
        return None
    if length > 8 or len(data) != length or not 0 <= frame_id <= highest:
        return None
    return Frame(frame_id, data, letter == b"T")


class CanWire:
    """A CAN interface of the system, which must be up; raises OSError when it cannot be used."""

    def __init__(self, name: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.CAN_RAW)
        self._refused = False
        self.foreign = 0
        self.standard: deque[Frame] = deque(maxlen=MOST_STANDARD)
        try:
            self._socket.bind((name,))
        except OSError:
            self._socket.close()
            raise

    def close(self) -> None:
        self._socket.close()

    def send(self, frame: Frame) -> None:
        try:
            self._socket.send(
                _CAN_FRAME.pack(
                    frame.id | (EXTENDED_FLAG if frame.extended else 0), len(frame.data), frame.data.ljust(8, b"\0")
                ),
                socket.MSG_DONTWAIT,
            )
        except OSError as problem:
            if problem.errno not in (errno.ENOBUFS, errno.EAGAIN):
                raise
            self._refused = True

    def receive(self, patience_s: float) -> list[Frame]:
        frames = []
        until_s = self.now_s() + patience_s
        while (left_s := until_s - self.now_s()) > 0:
            if select.select((self._socket,), (), (), left_s)[0]:
                frame_id, length, data = _CAN_FRAME.unpack(self._socket.recv(_CAN_FRAME.size))
                if frame_id & ~EXTENDED_MASK == EXTENDED_FLAG:
                    frames.append(Frame(frame_id & EXTENDED_MASK, data[:length]))
                elif not frame_id & ERROR_FLAG:
                    self.foreign += 1
                    if frame_id <= STANDARD_MASK:  # no flag is set: neither extended nor remote
                        self.standard.append(Frame(frame_id, data[:length], extended=False))
        return frames

    def troubled(self) -> bool:
        """A full queue means that nobody takes what is sent."""
        return self._refused

    def now_s(self) -> float:
        return time.monotonic()
