"""CAN frames as raw sockets have them, packed and unpacked by Python's struct: an oracle beside the compiled codec."""

import struct
from collections.abc import Iterable

from observer import WireFrame

RECORD = struct.Struct("=IB3x8s")
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000


def record(can_id: int, data: bytes, *, flags: int = EXTENDED) -> bytes:
    """One `struct can_frame`."""
    return RECORD.pack(can_id | flags, len(data), data)


def error_record(error_class: int, detail: bytes = b"") -> bytes:
    """What a controller's driver says: the details begin at the first data byte."""
    return RECORD.pack(error_class | ERROR, 8, detail.ljust(8, b"\0"))


def unpacked(data: bytes) -> list[tuple[int, bytes]]:
    """Identifier with flags, and data, of each frame."""
    return [(word, content[:length]) for word, length, content in RECORD.iter_unpack(data)]


def frames_in(chunks: Iterable[tuple[int, bytes]]) -> list[WireFrame]:
    """Every frame that was written, as `observer.frames_sent` has them of a serial adapter."""
    found = []
    for time_ns, data in chunks:
        for word, content in unpacked(data):
            assert word & EXTENDED
            found.append(WireFrame(time_ns, word & 0x1FFFFFFF, content))
    return found
