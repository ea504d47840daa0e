"""The bridge between the cycle and a bus of python-can: a pair of connected sockets, two threads of ordinary Python.

One end is the wire's descriptor. As with any other wire, the cycle writes its frames to it in one call and never waits,
and the reader thread reads and time-stamps what was received. At the other end, one thread sends frames to the bus and
one receives frames from it. It is a socket and not a ring in memory, because a thread that sleeps at its end must be
woken anyway. The system does that, keeps messages whole (SOCK_SEQPACKET: one cycle's frames, or one received frame),
and bounds how much waits.

Old frames must not be sent. While `HELD_BACK_S` of frames still wait, the cycle's write is refused (EAGAIN, as by any
wire that is full). A frame whose turn comes later than that after its cycle is dropped here and counted, unless it is a
stop command.
"""

import contextlib
import errno
import math
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from rtloop.memory.link import CAN_FRAME_BYTES, TX_BYTES
from rtloop.wire.can_words import (
    BUS_ERROR,
    ERROR_FLAG,
    EXTENDED_FLAG,
    EXTENDED_MASK,
    JOINED,
    REMOTE_FLAG,
    STANDARD_MASK,
    STOP,
)

if TYPE_CHECKING:
    import can

RECORD = struct.Struct("=IBBH8s")
"""`struct can_frame`: identifier with its flags, length, rtarm's own marks (`rtloop.wire.can_frame.mark`), data."""
LONGEST_DATA = 8
UNREADABLE = RECORD.pack(0, 0xFF, 0, 0, b"")
"""Record for something that was received and is no frame; the cycle counts it."""

HELD_BACK_S = 0.025
"""Age at which set-points are dropped; readings of this age make the arm brake."""
LEAST_HELD_BACK = 3
"""Cycles whose frames may wait in any case: an ordinary thread may be away for two periods of a fast cycle."""
PACKET_MEMORY_BYTES = 768
"""Memory that the system counts for a message besides its content, at least (struct sk_buff, skb_shared_info)."""
SEND_PATIENCE_S = 0.1
"""Timeout of sending a frame, for interfaces of python-can that have one."""
RECEIVE_PATIENCE_S = 0.1
FAILING_S = 0.05
"""A bus that has raised nothing but errors for this long is taken to be gone."""
FAILING_PAUSE_S = 0.001
END_PATIENCE_S = 3.0
SWITCH_INTERVAL_S = 0.0005
"""How long a thread may keep the interpreter while others wait; Python's default of 5 ms is most of a cycle."""

GONE = frozenset(
    (errno.ENODEV, errno.ENXIO, errno.EIO, errno.EBADF, errno.EPIPE, errno.ESHUTDOWN, errno.ENETDOWN, errno.ECONNRESET)
)
"""Error numbers that are permanent, so that retrying is no use."""


class Traffic(NamedTuple):
    """The cycle's period and frames, for which the bridge reserves room."""

    period_s: float
    frames_per_cycle: int


class Bridge:
    """A bus of python-can as a wire of the cycle; `close` ends it.

    Args:
        bus: an open bus, which the bridge owns from here on.
        traffic: what the cycle sends.
        tells_classes: whether the bus's error frames are those of Linux (linux/can/error.h).
        prepare: called in each of the bridge's threads before anything else.

    Attributes:
        fd: the cycle's end; to be closed by the owner, after `close`.
        unsent_bytes: bytes that were taken from the cycle and not sent after all.
        dropped_bytes: bytes that were received while the cycle's end was full.
        trouble: why the bridge ended by itself; empty if it did not.
    """

    def __init__(
        self, bus: "can.BusABC", traffic: Traffic, *, tells_classes: bool, prepare: Callable[[], None]
    ) -> None:
        import can

        self._bus = bus
        self._message = can.Message
        self._tells_classes = tells_classes
        self._prepare = prepare
        self._ending = False
        self.unsent_bytes = self.dropped_bytes = 0
        self.trouble = ""
        ours, self._end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        # Linux doubles this number, for its own use.
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, held_back_bytes(traffic) // 2)
        self.fd = ours.detach()
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL_S))
        self._threads = [
            threading.Thread(target=target, name=name, daemon=True)
            for target, name in ((self._send, "bridge out"), (self._receive, "bridge in"))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> list[str]:
        """End the threads and shut the bus down; returns what went wrong, before and now, in sentences.

        The interface's own code may wait for a stuck adapter, so the shutdown is waited for with a timeout.
        """
        said = [f"python-can has lost the adapter ({self.trouble})."] if self.trouble else []
        self._ending = True
        with contextlib.suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)
        ending = threading.Thread(target=self._shut_down, name="bridge end", daemon=True)
        ending.start()
        ending.join(END_PATIENCE_S)
        if ending.is_alive():
            said.append(
                f"python-can did not let go of the adapter within {END_PATIENCE_S:g} s: unplug it and plug it in again "
                "if it cannot be opened."
            )
        return said

    def _shut_down(self) -> None:
        for thread in self._threads:
            thread.join()
        self._end.close()
        with contextlib.suppress(Exception):  # whatever an interface raises whose adapter is gone
            self._bus.shutdown()

    def _give_up(self, problem: Exception) -> None:
        """End both threads, and with them the wire for the cycle, because the bus is gone."""
        if not self._ending:
            self.trouble = self.trouble or f"{type(problem).__name__}: {problem}"
        self._ending = True
        with contextlib.suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)

    # --- out

    def _send(self) -> None:
        self._prepare()
        while batch := self._take():
            joined = goes = False
            for word, length, marks, made_ms, content in RECORD.iter_unpack(batch):
                if self._ending:
                    return
                if not joined:
                    goes = bool(marks & STOP) or not is_old(made_ms)
                goes = goes and self._send_one(word, length, content)  # no drive gets only a part of a command
                joined = bool(marks & JOINED)
                if not goes:
                    self.unsent_bytes += CAN_FRAME_BYTES

    def _take(self) -> bytes:
        """Wait for the frames of a cycle and return them; empty once the socket is shut down."""
        try:
            return self._end.recv(TX_BYTES)
        except OSError:
            return b""

    def _send_one(self, word: int, length: int, content: bytes) -> bool:
        """Send a frame; whether the bus has taken it."""
        remote = bool(word & REMOTE_FLAG)
        message = self._message(
            arbitration_id=word & EXTENDED_MASK,
            is_extended_id=bool(word & EXTENDED_FLAG),
            is_remote_frame=remote,
            dlc=length,
            data=None if remote else content[:length],
        )
        try:
            self._bus.send(message, SEND_PATIENCE_S)
        except Exception as problem:  # whatever the interface's library raises; the frame is lost in any case
            if is_gone(problem):
                self._give_up(problem)
            return False
        return True

    # --- in

    def _receive(self) -> None:
        self._prepare()
        failing_since_s = math.inf
        while not self._ending:
            try:
                message = self._bus.recv(RECEIVE_PATIENCE_S)
            except Exception as problem:  # one garbled line of a serial adapter may be a ValueError
                failing_since_s = min(failing_since_s, time.monotonic())
                if is_gone(problem) or time.monotonic() - failing_since_s > FAILING_S:
                    self._give_up(problem)
                    return
                self._hand_over(UNREADABLE)
                time.sleep(FAILING_PAUSE_S)
                continue
            failing_since_s = math.inf
            if message is not None and (record := record_of(message, self._tells_classes)):
                self._hand_over(record)

    def _hand_over(self, record: bytes) -> None:
        try:
            self._end.send(record, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self.dropped_bytes += CAN_FRAME_BYTES
        except OSError:
            self._ending = True


def is_old(made_ms: int) -> bool:
    """Whether a frame made at `made_ms` (CLOCK_MONOTONIC in ms, the lowest 16 bits) is older than HELD_BACK_S."""
    return (time.monotonic_ns() // 1_000_000 - made_ms) & 0xFFFF > HELD_BACK_S * 1e3


def held_back_bytes(traffic: Traffic) -> int:
    """Memory that the system may use for waiting frames, as it counts it; it accepts one message more than fits."""
    cycles = max(LEAST_HELD_BACK, math.ceil(HELD_BACK_S / traffic.period_s))
    return (cycles - 1) * (traffic.frames_per_cycle * CAN_FRAME_BYTES + PACKET_MEMORY_BYTES)


def record_of(message: "can.Message", tells_classes: bool) -> bytes | None:
    """A message of python-can in the form that the cycle reads; None for a message to ignore.

    Ignored are frames that this process sent (gs_usb reports each of them), and CAN FD. Error frames of interfaces
    without Linux's classes are passed on to be counted only.
    """
    if not message.is_rx or message.is_fd:
        return None
    content = bytes(message.data)
    if message.is_error_frame:
        if not tells_classes:
            return RECORD.pack(ERROR_FLAG | BUS_ERROR, LONGEST_DATA, 0, 0, b"")
        return RECORD.pack(ERROR_FLAG | message.arbitration_id & EXTENDED_MASK, LONGEST_DATA, 0, 0, content[:8])
    highest_id = EXTENDED_MASK if message.is_extended_id else STANDARD_MASK
    remote = message.is_remote_frame
    length_fits = 0 <= message.dlc <= LONGEST_DATA and (remote or len(content) == message.dlc)
    if not (length_fits and 0 <= message.arbitration_id <= highest_id):
        return UNREADABLE
    word = message.arbitration_id | (EXTENDED_FLAG if message.is_extended_id else 0) | (REMOTE_FLAG if remote else 0)
    return RECORD.pack(word, message.dlc, 0, 0, b"" if remote else content)


def is_gone(problem: BaseException) -> bool:
    """Whether an exception, or one of its causes, shows that the adapter is gone."""
    seen: set[int] = set()
    here: BaseException | None = problem
    while here is not None and id(here) not in seen:
        if isinstance(here, OSError) and here.errno in GONE:
            return True
        seen.add(id(here))
        here = here.__cause__ or here.__context__
    return False
