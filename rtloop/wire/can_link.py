"""What the system knows of a CAN interface: from sysfs as for any network interface, from netlink what only CAN has.

Constants from linux/if_arp.h, linux/if.h, linux/rtnetlink.h and linux/can/netlink.h.
"""

import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ARPHRD_CAN = 280
INTERFACE_UP = 1
NETWORK = Path("/sys/class/net")

_NLM_F_REQUEST = 1
_RTM_NEWLINK, _RTM_GETLINK = 16, 18
_IFLA_LINKINFO, _IFLA_INFO_DATA, _IFLA_CAN_BITTIMING = 18, 2, 1
_TYPE_MASK = 0x3FFF
_MESSAGE = struct.Struct("=LHHLL")
_INTERFACE = struct.Struct("=BxHiII")
_ATTRIBUTE = struct.Struct("=HH")
_LARGEST_ANSWER = 1 << 16
PATIENCE_S = 1.0


class Link(NamedTuple):
    """State of a CAN interface."""

    is_up: bool
    queue_frames: int
    """How many frames the system queues for it (txqueuelen)."""
    bitrate: int | None
    """bit/s; None if the interface has none (vcan) or does not report it."""


def can_interfaces() -> list[str]:
    """Names of all CAN interfaces of this machine."""
    return sorted(folder.name for folder in NETWORK.glob("*") if _number(folder / "type") == ARPHRD_CAN)


def link_of(name: str) -> Link | None:
    """The present state of a CAN interface; None if there is no CAN interface of that name."""
    folder = NETWORK / name
    index = _number(folder / "ifindex")
    flags, queue = _number(folder / "flags"), _number(folder / "tx_queue_len")
    if index is None or flags is None or queue is None or _number(folder / "type") != ARPHRD_CAN:
        return None
    return Link(bool(flags & INTERFACE_UP), queue, _told_bitrate(index))


def _number(file: Path) -> int | None:
    try:
        return int(file.read_text(encoding="ascii"), 0)
    except (OSError, ValueError):
        return None


def _told_bitrate(index: int) -> int | None:
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.NETLINK_ROUTE) as asked:
            asked.settimeout(PATIENCE_S)
            asked.send(question(index))
            return bitrate_in(asked.recv(_LARGEST_ANSWER))
    except OSError:
        return None


def question(index: int) -> bytes:
    """The netlink message that asks for everything about one interface."""
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, index, 0, 0)
    return _MESSAGE.pack(_MESSAGE.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, 1, 0) + body


def bitrate_in(answer: bytes) -> int | None:
    """The bit rate (bit/s) in the answer to `question`; None if the answer has none."""
    if len(answer) < _MESSAGE.size + _INTERFACE.size or _MESSAGE.unpack_from(answer)[1] != _RTM_NEWLINK:
        return None
    content = answer[_MESSAGE.size + _INTERFACE.size :]
    for kind in (_IFLA_LINKINFO, _IFLA_INFO_DATA, _IFLA_CAN_BITTIMING):
        content = next((value for number, value in _attributes(content) if number == kind), b"")
    return int.from_bytes(content[:4], "little") or None  # struct can_bittiming begins with the bit rate


def _attributes(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + _ATTRIBUTE.size <= len(content):
        length, kind = _ATTRIBUTE.unpack_from(content, at)
        if length < _ATTRIBUTE.size or at + length > len(content):
            return
        yield kind & _TYPE_MASK, content[at + _ATTRIBUTE.size : at + length]
        at += -(-length // 4) * 4
