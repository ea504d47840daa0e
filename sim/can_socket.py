"""A simulated arm in real time on a CAN interface of the system, such as vcan0.

What the host sends is at once on the virtual interface, where everybody hears it; the simulated bus gives it the time
it takes on a real one before a drive hears it, and the drives' answers leave when they would have arrived.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable, Sequence

from sim.arm import SimulatedArm
from sim.can_interface import RECORD
from sim.truth import Heard
from sim.waking import Waking

BATCH = 256


class CanServer(Waking):
    """Serves an arm on SocketCAN, whose time must be CLOCK_MONOTONIC, on a CAN interface.

    Args:
        arm: made with `start_ns=time.monotonic_ns()`.
        interface: name of the interface, which must be up.

    Attributes:
        place: the interface.
        heard: what was on the bus, kept for `sim.truth` where this is a list.
        dropped_frames: frames to the host that the interface did not take, because it was full or down.

    Raises:
        OSError: there is no such interface, or this system has no raw CAN sockets.
    """

    def __init__(self, arm: SimulatedArm, interface: str) -> None:
        self.arm = arm
        self.place = interface
        self.dropped_frames = 0
        self.heard: Heard | None = None
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            self._socket.bind((interface,))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        super().__init__()

    def serve(self, attend: Callable[[], bool], watched: Sequence[int] = ()) -> None:
        """Serve until `attend` says False; see `sim.pty.PtyServer.serve`."""
        own = self._socket.fileno()
        going = attend()
        while going:
            due_ns = self.arm.next_due_ns()
            wait_s = None if due_ns is None else max(0, due_ns - time.monotonic_ns()) * 1e-9
            readable, _, _ = select.select((own, self._wake_read, *watched), (), (), wait_s)
            now_ns = time.monotonic_ns()
            if own in readable:
                data = self._read()
                if self.heard is not None:
                    self.heard.append((now_ns, data))
                self.arm.feed(now_ns, data)
            self._write(self.arm.collect(now_ns))
            if self._wake_read in readable:
                self._awake()
            if not {own}.issuperset(readable):
                going = attend()

    def close(self) -> None:
        """Leave the bus."""
        self._socket.close()
        super().close()

    def _read(self) -> bytes:
        """All frames that wait; one that says the interface went down is none, and it comes up again by itself."""
        parts = []
        with contextlib.suppress(OSError):
            for _ in range(BATCH):
                parts.append(self._socket.recv(RECORD.size))
        return b"".join(parts)

    def _write(self, data: bytes) -> None:
        for at in range(0, len(data), RECORD.size):
            try:
                self._socket.send(data[at : at + RECORD.size])
            except OSError:
                self.dropped_frames += 1
