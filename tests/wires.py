"""Every wire as the tests know it: how it is spelt, by its protocol's documents and nothing of ours.

A new wire is one more entry of WIRES; `tests/rtloop/wire/test_wire_conformance.py` then asks of it what it asks of all.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from can_records import RECORD

from sim.bus import Frame

ANSWER_OF_DRIVE_1 = bytes.fromhex("36 00 00 01 00 00 6B")
"""A position (36) of one motor turn, as a ZDT drive sends it."""


@dataclass(frozen=True, repr=False)
class Wire:
    """A wire.

    Attributes:
        bus: what an arm file says of it.
        spell: the bytes of a frame.
        read: the frames in bytes that are whole; fails on what is none.
        opening: what opens a simulated adapter for a bus of 1 Mbit/s.
        opening_standard: the same for standard identifiers, where that is another thing.
        left_open: what opens it for another bus, where it can be.
        golden: bytes with their source, and what they mean.
        noise: bytes that are no frame, and how many errors they count for when sound frames follow.
        kinds: (extended, remote) of the frames it carries.
        answered: bytes that the adapter says to each frame of ours.
        stamp: characters that the adapter adds to each frame.
        cut_costs: sound frames that are lost behind one that was cut.
        options: of the simulated arm.
        unit: bytes that leave together, at the least.
    """

    name: str
    bus: dict[str, Any]
    spell: Callable[[Frame], bytes]
    read: Callable[[bytes], list[Frame]]
    opening: bytes
    left_open: bytes
    golden: Sequence[tuple[bytes, Frame]]
    noise: Sequence[tuple[bytes, int]]
    kinds: Sequence[tuple[bool, bool]] = ((False, False), (True, False), (False, True), (True, True))
    opening_standard: bytes | None = None
    answered: int = 0
    stamp: int = 0
    cut_costs: int = 0
    options: dict[str, Any] = field(default_factory=dict)
    unit: int = 1

    def __repr__(self) -> str:
        return self.name


# --- SLCAN: characters (can-adapters.md, section 1) ------------------------------------------------------------

_LINE = re.compile(rb"(?:([TR])([0-9A-F]{8})|([tr])([0-9A-F]{3}))([0-8])((?:[0-9A-F]{2})*)")


def spell_slcan(frame: Frame) -> bytes:
    letter = ("R" if frame.remote else "T") if frame.extended else ("r" if frame.remote else "t")
    number = f"{frame.can_id:0{8 if frame.extended else 3}X}"
    return f"{letter}{number}{len(frame.data)}{'' if frame.remote else frame.data.hex().upper()}\r".encode()


def read_slcan(data: bytes) -> list[Frame]:
    found = []
    *lines, rest = data.split(b"\r")
    assert rest == b""
    for line in lines:
        match = _LINE.fullmatch(line)
        assert match is not None, line
        letter, number, length = match[1] or match[3], match[2] or match[4], int(match[5])
        content = bytes.fromhex(match[6].decode())
        remote = letter in b"Rr"
        assert len(content) == (0 if remote else length), line
        found.append(Frame(int(number, 16), bytes(length) if remote else content, letter in b"TR", remote))
    return found


SLCAN_GOLDEN = [
    (b"T12ABCDEF2AA55\r", Frame(0x12ABCDEF, b"\xaa\x55")),
    (b"t4563112233\r", Frame(0x456, b"\x11\x22\x33", extended=False)),
    # as a ZDT drive and its master exchange them
    (b"T000001002366B\r", Frame(0x100, b"\x36\x6b")),
    (b"T0000010073601000100006B\r", Frame(0x100, bytes.fromhex("36 01 00 01 00 00 6B"))),
    (b"T000001008FD010FA0000001FA\r", Frame(0x100, bytes.fromhex("FD 01 0F A0 00 00 01 FA"))),
    (b"T000001015FD0000006B\r", Frame(0x101, bytes.fromhex("FD 00 00 00 6B"))),
    (b"t7FF0\r", Frame(0x7FF, b"", extended=False)),
    (b"T1FFFFFFF8FFFFFFFFFFFFFFFF\r", Frame(0x1FFFFFFF, b"\xff" * 8)),
    (b"R000001002\r", Frame(0x100, bytes(2), remote=True)),
    (b"r7FF8\r", Frame(0x7FF, bytes(8), extended=False, remote=True)),
]
SLCAN_NOISE = [
    (b"\x07", 1),
    (b"z\rZ\r\r\r", 0),
    (b"V1013\rNA123\rFA4\r", 0),
    (b"CANable2-b158aa7 github.com/normaldotcom/canable2-fw.git\r", 0),
    (b"T0000\r", 1),
    (b"T00000100736\x07", 1),
    (b"x" * 500 + b"\r", 1),
    (b"T" + b"0" * 500 + b"\r", 1),
    (b"\x00\xff\r", 0),
]


def slcan(name: str, *, dialect: str, answered: int, before: bytes = b"", stamp: int = 0) -> Wire:
    return Wire(
        name=name,
        bus={"interface": "slcan"},
        spell=spell_slcan,
        read=read_slcan,
        opening=b"C\rS8\r" + before + b"O\r",
        left_open=b"C\rS6\r" + before + b"O\r",
        golden=SLCAN_GOLDEN,
        noise=SLCAN_NOISE,
        answered=answered,
        stamp=stamp,
        cut_costs=1,
        options={"dialect": dialect},
    )


# --- SocketCAN: struct can_frame (section 6) -------------------------------------------------------------------


def spell_record(frame: Frame) -> bytes:
    word = frame.can_id | (0x80000000 if frame.extended else 0) | (0x40000000 if frame.remote else 0)
    return RECORD.pack(word, len(frame.data), b"" if frame.remote else frame.data)


def read_records(data: bytes) -> list[Frame]:
    found = []
    for word, length, content in RECORD.iter_unpack(data):
        assert length <= 8 and not word & 0x20000000
        extended, remote = bool(word & 0x80000000), bool(word & 0x40000000)
        assert content[0 if remote else length :].strip(b"\0") == b""
        found.append(Frame(word & (0x1FFFFFFF if extended else 0x7FF), content[:length], extended, remote))
    return found


# --- USB-CAN-A, variable length (section 2) --------------------------------------------------------------------


def spell_seeed(frame: Frame) -> bytes:
    head = 0xC0 + (0x20 if frame.extended else 0) + (0x10 if frame.remote else 0) + len(frame.data)
    number = frame.can_id.to_bytes(4 if frame.extended else 2, "little")
    return b"\xaa" + bytes([head]) + number + (b"" if frame.remote else frame.data) + b"\x55"


def read_seeed(data: bytes) -> list[Frame]:
    found, at = [], 0
    while at < len(data):
        start, head = data[at], data[at + 1]
        assert start == 0xAA and head >= 0xC0
        extended, remote, length = bool(head & 0x20), bool(head & 0x10), head & 0x0F
        begin = at + (6 if extended else 4)
        end = begin if remote else begin + length
        assert length <= 8 and data[end] == 0x55
        number = int.from_bytes(data[at + 2 : begin], "little")
        found.append(Frame(number, bytes(length) if remote else data[begin:end], extended, remote))
        at = end + 1
    return found


SEEED_GOLDEN = [
    (bytes.fromhex("AA C8 23 01 11 22 33 44 55 66 77 88 55"), Frame(0x123, bytes.fromhex("1122334455667788"), False)),
    # by the same rules, with the framing's own bytes as data
    (bytes.fromhex("AA E3 AA 55 AA 15 55 AA 55 55"), Frame(0x15AA55AA, b"\x55\xaa\x55")),
    (bytes.fromhex("AA E2 00 01 00 00 36 6B 55"), Frame(0x100, b"\x36\x6b")),
    (bytes.fromhex("AA C0 FF 07 55"), Frame(0x7FF, b"", False)),
    (bytes.fromhex("AA D8 64 00 55"), Frame(0x064, bytes(8), False, True)),
]
SEEED_NOISE = [
    (bytes.fromhex("AA 55 04 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 04"), 0),  # status, as it is asked for
    (bytes.fromhex("AA 55 01 02 01 00 01 00 00 02 36 6B 00 00 00 00 00 00 00 A8"), 0),  # fixed framing, sum right
    (bytes.fromhex("AA 55 01 02 01 00 01 00 00 02 36 6B 00 00 00 00 00 00 00 A9"), 1),  # wrong
    (b"\x00", 1),
    (b"\xaa", 1),
    (b"\x55" * 40, 1),
    (bytes.fromhex("AA C9 00 01"), 1),  # nine bytes do not exist
    (bytes.fromhex("AA 88 00 01"), 1),
    (bytes.fromhex("AA E0 00 00 00 20 55"), 1),  # 30 bits of identifier
    (bytes.fromhex("AA C0 00 08 55"), 1),  # 12 bits
    (bytes.fromhex("AA D2 64 00 01 02 55"), 0),  # a remote frame with the bytes that it asks for
]

# --- AT (section 3) --------------------------------------------------------------------------------------------


def spell_at(frame: Frame) -> bytes:
    assert frame.extended and not frame.remote
    return b"AT" + (frame.can_id * 8 + 4).to_bytes(4, "big") + bytes([len(frame.data)]) + frame.data + b"\r\n"


def read_at(data: bytes) -> list[Frame]:
    found, at = [], 0
    while at < len(data):
        number, kind = divmod(int.from_bytes(data[at + 2 : at + 6], "big"), 8)
        end = at + 7 + data[at + 6]
        assert data[at : at + 2] == b"AT" and kind == 4 and data[at + 6] <= 8 and data[end : end + 2] == b"\r\n"
        found.append(Frame(number, data[at + 7 : end]))
        at = end + 2
    return found


AT_GOLDEN = [
    (bytes.fromhex("41 54 18 07 E8 0C 08 00 00 00 00 00 00 00 00 0D 0A"), Frame(0x0300FD01, bytes(8))),
    # c7chord/Robstride_CH340: who is motor 1
    (bytes.fromhex("41 54 00 07 E8 0C 01 00 0D 0A"), Frame(0x0000FD01, b"\0")),
    # by the same rules, with the framing's own bytes as data
    (bytes.fromhex("41 54 00 00 08 04 06 0D 0A 41 54 0D 0A 0D 0A"), Frame(0x100, b"\r\nAT\r\n")),
    (bytes.fromhex("41 54 FF FF FF FC 00 0D 0A"), Frame(0x1FFFFFFF, b"")),
]
AT_NOISE = [
    (b"OK\r\n", 1),
    (b"AT+AT\r\n", 1),
    (b"A", 1),
    (b"\r\n" * 20, 1),
    (bytes.fromhex("41 54 00 00 08 04 09 00 00"), 1),  # nine bytes do not exist
    (bytes.fromhex("41 54 20 00 00 00 02 36 6B 0D 0A"), 0),  # a standard identifier
    (bytes.fromhex("41 54 00 00 08 06 00 0D 0A"), 0),  # a remote frame
]

SOCKETCAN = Wire(
    name="socketcan",
    bus={"interface": "socketcan", "channel": "can0", "usb_index": None},
    spell=spell_record,
    read=read_records,
    opening=b"",
    left_open=b"",
    golden=[
        (bytes.fromhex("EFCDAB92 02 000000 AA55000000000000"), Frame(0x12ABCDEF, b"\xaa\x55")),
        (bytes.fromhex("56040000 03 000000 1122330000000000"), Frame(0x456, b"\x11\x22\x33", False)),
        (bytes.fromhex("64000040 08 000000 0000000000000000"), Frame(0x064, bytes(8), False, True)),
    ],
    noise=[
        (bytes.fromhex("00010080 09 000000 0000000000000000"), 1),  # nine bytes do not exist
        (bytes.fromhex("00080000 00 000000 0000000000000000"), 1),  # 12 bits of identifier
    ],
    unit=RECORD.size,
)
"""The same records pass the bridge to python-can; what it makes of them: `tests/rtloop/wire/test_bridge.py`."""

WIRES = [
    slcan("slcan", dialect="lawicel", answered=2),
    slcan("slcan-stamped", dialect="lawicel", answered=2, before=b"Z1\r", stamp=4),
    slcan("slcan-canable", dialect="canable", answered=0),
    slcan("slcan-canable2", dialect="canable2", answered=2),
    slcan("slcan-canable2-stamped", dialect="canable2", answered=2, before=b"Z2\r", stamp=8),
    SOCKETCAN,
    replace(
        SOCKETCAN,
        name="python-can",
        bus={
            "interface": "python-can",
            "channel": "here",
            "usb_index": None,
            "python_can": {"interface": "virtual"},
        },
    ),
    Wire(
        name="seeedstudio",
        bus={"interface": "seeedstudio", "bitrate": 1_000_000},
        spell=spell_seeed,
        read=read_seeed,
        opening=bytes.fromhex("AA 55 12 01 02 00000000 00000000 00 00 00000000 15"),
        opening_standard=bytes.fromhex("AA 55 12 01 01 00000000 00000000 00 00 00000000 14"),
        # as python-can sets it up, which has frames sent once only
        left_open=bytes.fromhex("AA 55 12 03 01 00000000 00000000 00 01 00000000 17"),
        golden=SEEED_GOLDEN,
        noise=SEEED_NOISE,
    ),
    Wire(
        name="ch340-at",
        bus={"interface": "ch340-at", "bitrate": 1_000_000},
        spell=spell_at,
        read=read_at,
        opening=bytes.fromhex("41 54 2B 41 54 0D 0A"),
        left_open=bytes.fromhex("41 54 2B 41 54 0D 0A"),
        golden=AT_GOLDEN,
        noise=AT_NOISE,
        kinds=((True, False),),
    ),
]
