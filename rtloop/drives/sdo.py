"""CANopen's service data objects (SDO), as a drive's dialogue uses them: one transfer at a time (CiA 301).

Request and reply have eight bytes: command, index (little-endian), sub-index, and four bytes of data or of abort code.
A reply is recognised by index and sub-index, which it repeats. A value is a number of one to four bytes, or a text,
which comes in segments of seven bytes if it is longer than four; what a toggle bit tells apart are the segments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from config.drives.cia402 import SDO_REPLY, SDO_REQUEST
from config.joint import JointConfig
from rtloop.drives.asking import AskFrames
from rtloop.drives.setup import CLEAR_OR_START
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import DialogueFailed, Part, silent_amid
from rtloop.service.port import Frame

READ, WRITTEN, ABORT = 0x40, 0x60, 0x80
WRITE = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}
"""Command byte of a write, by the size of the value in bytes."""
SIZE_SHOWN = 0x01
READ_REPLY, READ_REPLY_MASK = 0x42, 0xE2
EXPEDITED = 0x02
TEXT_REPLY, TEXT_REPLY_MASK = 0x40, 0xE0
READ_SEGMENT, SEGMENT_TOGGLE, LAST_SEGMENT, MOST_SEGMENTS = 0x60, 0x10, 0x01, 20
SDO_BYTES = 8

NO_OBJECT, NO_SUBINDEX = 0x0602_0000, 0x0609_0011
ABORTS = {
    0x0503_0000: "the toggle bit did not change",
    0x0504_0000: "it waited too long for the rest of a transfer",
    0x0504_0001: "it does not know that command",
    0x0504_0005: "it has no memory left for that",
    0x0601_0000: "that access is not supported",
    0x0601_0001: "the object can only be written",
    0x0601_0002: "the object can only be read",
    NO_OBJECT: "it has no such object",
    0x0604_0041: "the object cannot be mapped into a PDO",
    0x0604_0042: "a PDO cannot hold so much",
    0x0604_0043: "the parameters do not go together",
    0x0604_0047: "an inconsistency within the drive",
    0x0606_0000: "a hardware error hinders the access",
    0x0607_0010: "the value has the wrong length",
    0x0607_0012: "the value is too long",
    0x0607_0013: "the value is too short",
    NO_SUBINDEX: "the object has no such part",
    0x0609_0030: "it does not allow that value",
    0x0609_0031: "the value is too high",
    0x0609_0032: "the value is too low",
    0x0609_0036: "its highest value would be below its lowest",
    0x060A_0023: "what it needs for that is not available",
    0x0800_0000: "a general error",
    0x0800_0020: "it cannot take or store that",
    0x0800_0021: "something within the drive keeps that to itself (local control)",
    0x0800_0022: "not in the state in which it is now",
    0x0800_0023: "its list of objects is missing",
}
"""Abort codes of CiA 301."""


@dataclass(frozen=True)
class Object:
    """An entry of a drive's object dictionary that holds a number."""

    index: int
    sub: int
    size: int
    """Bytes, 1 to 4."""
    what: str
    """Its name in messages to the operator."""
    signed: bool = False

    @property
    def name(self) -> str:
        """Index, sub-index and name, as one looks the entry up in a manual."""
        return f"{self.index:04X}:{self.sub:02X} ({self.what})"


class Aborted(DialogueFailed):
    """The drive refuses to read or write an object; `code` is its abort code."""

    def __init__(self, joint: int, sentence: str, code: int) -> None:
        super().__init__(joint, sentence)
        self.code = code


def abort_words(code: int) -> str:
    """An abort code in words."""
    return f"{ABORTS.get(code, 'a reason of its own')}, abort code {code:08X}"


def reading(node: int, entry: Object) -> AskFrames:
    """The request to read an object."""
    return _asked(node, entry, READ, b"", lambda command: command & READ_REPLY_MASK == READ_REPLY)


def writing(node: int, entry: Object, value: int) -> AskFrames:
    """The request to write a value into an object."""
    data = (value % (1 << 8 * entry.size)).to_bytes(entry.size, "little")
    return _asked(node, entry, WRITE[entry.size], data, lambda command: command == WRITTEN)


def value_in(frame: Frame, entry: Object) -> int:
    """The value in the reply to a read request; if the reply states the value's size, that size counts."""
    command = frame.data[0]
    size = 4 - (command >> 2 & 3) if command & SIZE_SHOWN else entry.size
    return int.from_bytes(frame.data[4 : 4 + size], "little", signed=entry.signed)


@dataclass(frozen=True)
class Node:
    """A joint's drive as a CANopen node; every transfer raises DialogueFailed if the drive does not answer."""

    joint: int
    config: JointConfig

    @property
    def number(self) -> int:
        """The node's number."""
        return self.config.drive.number

    def read(self, entry: Object) -> Part[int]:
        """Read an object's value; raises Aborted."""
        reply = yield reading(self.number, entry)
        return value_in(self._heard(entry, reply, "tell"), entry)

    def read_if_there(self, entry: Object) -> Part[int | None]:
        """Read an object that a drive need not have; None if it has none. Raises Aborted for any other abort code."""
        try:
            return (yield from self.read(entry))
        except Aborted as aborted:
            if aborted.code in (NO_OBJECT, NO_SUBINDEX):
                return None
            raise

    def read_text(self, entry: Object) -> Part[str]:
        """Read an object that holds a text, of 140 characters at most; raises Aborted."""
        reply = yield _asked(self.number, entry, READ, b"", lambda command: command & TEXT_REPLY_MASK == TEXT_REPLY)
        first = self._heard(entry, reply, "tell").data
        if first[0] & EXPEDITED:
            return _text(first[4 : 8 - (first[0] >> 2 & 3) if first[0] & SIZE_SHOWN else 8])
        text, toggle = b"", 0
        for _ in range(MOST_SEGMENTS):
            part = self._heard(entry, (yield _segment(self.number, toggle)), "tell").data
            text += part[1 : 8 - (part[0] >> 1 & 7)]
            if part[0] & LAST_SEGMENT:
                break
            toggle ^= SEGMENT_TOGGLE
        return _text(text)

    def write(self, entry: Object, value: int) -> Part[None]:
        """Write a value into an object; raises Aborted."""
        self.require_written(entry, value, (yield writing(self.number, entry, value)))

    def require_written(self, entry: Object, value: int, reply: Frame | None) -> None:
        """Check the reply to such a write; raises Aborted."""
        self._heard(entry, reply, f"take {value if entry.signed else hex(value)} for")

    def ensure(self, entry: Object, value: int) -> Part[None]:
        """Write a value if the object has another one; do nothing if the drive has no such object; raises Aborted."""
        found = yield from self.read_if_there(entry)
        if found is not None and found != value:
            yield from self.write(entry, value)

    def _heard(self, entry: Object, reply: Frame | None, wanted: str) -> Frame:
        if reply is None:
            raise DialogueFailed(self.joint, silent_amid(self.config, f"object {entry.name}"))
        if reply.data[0] == ABORT:
            code = int.from_bytes(reply.data[4:], "little")
            raise Aborted(
                self.joint,
                f"The drive of {self.config.name} does not {wanted} object {entry.name}: {abort_words(code)}. See what "
                f"its manual says of that object, {CLEAR_OR_START}.",
                code,
            )
        return reply


def _asked(node: int, entry: Object, command: int, data: bytes, fits: Callable[[int], bool]) -> AskFrames:
    place = bytes((entry.index & 0xFF, entry.index >> 8, entry.sub))
    request = Frame(SDO_REQUEST + node, bytes((command,)) + place + data.ljust(4, b"\0"), kind=STANDARD)

    def is_answer(frame: Frame) -> bool:
        if frame.id != SDO_REPLY + node or len(frame.data) != SDO_BYTES or frame.data[1:4] != place:
            return False
        return frame.data[0] == ABORT or fits(frame.data[0])

    return AskFrames((request,), is_answer)


def _segment(node: int, toggle: int) -> AskFrames:
    """The request for the next segment of a text."""
    request = Frame(SDO_REQUEST + node, bytes((READ_SEGMENT | toggle,)).ljust(SDO_BYTES, b"\0"), kind=STANDARD)

    def is_answer(frame: Frame) -> bool:
        if frame.id != SDO_REPLY + node or len(frame.data) != SDO_BYTES:
            return False
        return frame.data[0] == ABORT or frame.data[0] & (TEXT_REPLY_MASK | SEGMENT_TOGGLE) == toggle

    return AskFrames((request,), is_answer)


def _text(data: bytes) -> str:
    return data.rstrip(b"\0 ").decode("ascii", "replace")
