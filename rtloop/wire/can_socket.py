"""Opening a SocketCAN interface: a raw socket that receives the frames of the arm's drives and the controller's errors.

This is ordinary Python and runs before the first cycle, and again when the interface is back. Options from
linux/can/raw.h; loopback stays on, so that `candump` shows the frames to the drives; a socket does not receive its own.
"""

import socket
import struct
from collections.abc import Sequence

from config.frames import Identifiers
from rtloop.wire.can_link import Link, can_interfaces, link_of
from rtloop.wire.can_words import EXTENDED_FLAG, REMOTE_FLAG, WATCHED
from rtloop.wire.refusal import WireRefused

RECEIVE_BYTES = 1 << 20
"""Requested receive buffer; Linux grants up to net.core.rmem_max, by default room for 0.1 s of a full bus and more."""
CYCLES_HELD_BACK = 3
STOPS_HELD_BACK = 3
"""Cycles whose frames the system may queue, and stop commands for each drive behind them, which must not be lost."""
FRAME_MEMORY_BYTES = 768
"""Memory that the system counts for a queued frame (struct sk_buff and its data)."""

_CAN_RAW_ERR_FILTER = 2  # Python has no name for it
_SO_MEMINFO = 55
_MEMINFO_UNSENT, _MEMINFO_DROPS = 2, 8
_FILTER = struct.Struct("=II")


def open_socketcan(
    channel: str, bitrate: int, heard: Sequence[Identifiers], frames_per_cycle: int, drives: int
) -> tuple[int, list[str]]:
    """Open a CAN interface to receive frames with the identifiers `heard`; `bitrate` in bit/s.

    Returns its descriptor, non-blocking, and complaints to the operator. Raises WireRefused.
    """
    link = _usable_link(channel, bitrate)
    try:
        opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
    except (OSError, AttributeError):
        raise WireRefused("This system has no raw CAN sockets: load them with `sudo modprobe can_raw`.") from None
    try:
        for option, value in filters(heard).items():
            opened.setsockopt(socket.SOL_CAN_RAW, option, value)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        # Linux doubles this number, for its own use.
        held_back = frames_held_back(frames_per_cycle, drives)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, held_back * FRAME_MEMORY_BYTES // 2)
        opened.bind((channel,))
    except OSError as problem:
        opened.close()
        raise WireRefused(
            f"{channel} cannot be used ({problem.strerror}): look at `ip -details link show {channel}`."
        ) from problem
    complaints = []
    if link.queue_frames < frames_per_cycle:
        complaints.append(
            f"{channel} holds back {link.queue_frames} frames and a cycle sends {frames_per_cycle}, so some may be "
            f"lost: `sudo ip link set {channel} txqueuelen 128`."
        )
    return opened.detach(), complaints


def frames_held_back(frames_per_cycle: int, drives: int) -> int:
    """How many frames the system may queue for the bus: with more, frames would be sent late."""
    return CYCLES_HELD_BACK * frames_per_cycle + STOPS_HELD_BACK * drives


def filters(heard: Sequence[Identifiers]) -> dict[int, bytes]:
    """The socket's options: receive data frames with identifiers that drives use, and the error classes WATCHED."""
    passing = b"".join(
        _FILTER.pack(
            used.match | (EXTENDED_FLAG if used.extended else 0),
            used.mask | EXTENDED_FLAG | REMOTE_FLAG,
        )
        for used in heard
    )
    return {
        socket.CAN_RAW_FILTER: passing,
        _CAN_RAW_ERR_FILTER: struct.pack("=I", WATCHED),
    }


def dropped_frames(fd: int) -> int:
    """Received frames for which the system had no room since the socket was opened."""
    return _memory_info(fd, _MEMINFO_DROPS)


def holds_back(fd: int) -> bool:
    """Whether frames of this socket still wait for the bus."""
    return _memory_info(fd, _MEMINFO_UNSENT) > 0


def _memory_info(fd: int, word: int) -> int:
    """One of the system's words about a socket's memory; 0 if the system does not offer them."""
    words = struct.Struct(f"={_MEMINFO_DROPS + 1}I")
    opened = socket.socket(fileno=fd)
    try:
        told = opened.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, words.size)
        return int(words.unpack(told)[word]) if len(told) == words.size else 0
    finally:
        opened.detach()


def _usable_link(channel: str, bitrate: int) -> Link:
    up = (
        f"`sudo ip link set {channel} txqueuelen 128`, then `sudo ip link set {channel} up type can bitrate {bitrate} "
        "restart-ms 100`"
    )
    link = link_of(channel)
    if link is None:
        others = ", ".join(can_interfaces()) or "none"
        raise WireRefused(
            f"There is no CAN interface {channel}: plug the adapter in and load its driver, or name another as the "
            f"channel (found: {others})."
        )
    if not link.is_up:
        raise WireRefused(f"{channel} is down: set it up with {up}.")
    if link.bitrate is not None and link.bitrate != bitrate:
        raise WireRefused(
            f"{channel} runs at {link.bitrate} bit/s, and the arm's bus.bitrate is {bitrate}: take it down (`sudo ip "
            f"link set {channel} down`) and set it up with {up}, or change bus.bitrate."
        )
    return link
