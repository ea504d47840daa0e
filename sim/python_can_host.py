"""A simulated arm in real time on a bus of python-can: whatever bus that library can open, or one made in a test.

As on a CAN interface of the system (`sim.can_socket`): what others send is at once on their bus; the simulated bus
gives it the time it takes on a real one before a drive hears it, and the drives' answers leave when they would have
arrived.

python-can's `virtual` buses exist within one process, so they are for tests and programs that hold both ends.
"""

from __future__ import annotations

import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import can
import yaml

from sim.arm import SimulatedArm
from sim.bus import Frame
from sim.can_interface import RECORD, packed, unpacked
from sim.truth import Heard
from sim.waking import Waking

LISTEN_S = 0.1
"""For so long the listening thread waits for a message before it looks whether it shall end."""


class PythonCanServer(Waking):
    """Serves an arm on python-can, whose time must be CLOCK_MONOTONIC; `close` leaves the bus open, as it was given.

    Args:
        arm: made with `start_ns=time.monotonic_ns()`.
        bus: open, another node of it than the host's.

    Attributes:
        place: the bus, as python-can describes it.
        heard: what was on the bus, kept for `sim.truth` where this is a list.
        dropped_frames: frames to the host that the bus did not take.
    """

    def __init__(self, arm: SimulatedArm, bus: can.BusABC) -> None:
        self.arm = arm
        self.place = bus.channel_info
        self.dropped_frames = 0
        self.heard: Heard | None = None
        self._bus = bus
        self._came: deque[tuple[int, bytes]] = deque()
        self._ending = False
        super().__init__()
        self._listener = threading.Thread(target=self._listen, name="listener", daemon=True)
        self._listener.start()

    def serve(self, attend: Callable[[], bool], watched: Sequence[int] = ()) -> None:
        """Serve until `attend` says False; see `sim.pty.PtyServer.serve`."""
        going = attend()
        while going:
            due_ns = self.arm.next_due_ns()
            wait_s = None if due_ns is None else max(0, due_ns - time.monotonic_ns()) * 1e-9
            readable, _, _ = select.select((self._wake_read, *watched), (), (), wait_s)
            now_ns = time.monotonic_ns()
            if self._wake_read in readable:
                self._awake()
            while self._came:
                came_ns, data = self._came.popleft()
                came_ns = max(came_ns, self.arm.now_ns)
                if self.heard is not None:
                    self.heard.append((came_ns, data))
                self.arm.feed(came_ns, data)
            self._send(self.arm.collect(max(now_ns, self.arm.now_ns)))
            if readable:
                going = attend()

    def close(self) -> None:
        """Leave the bus."""
        self._ending = True
        self._listener.join()
        super().close()

    def _listen(self) -> None:
        while not self._ending:
            try:
                message = self._bus.recv(LISTEN_S)
            except can.CanError:
                return  # the bus was shut down
            if message is not None and (frame := frame_of(message)) is not None:
                self._came.append((time.monotonic_ns(), packed(frame)))
                os.write(self._wake_write, b"\0")

    def _send(self, data: bytes) -> None:
        for at in range(0, len(data), RECORD.size):
            try:
                self._bus.send(message_of(unpacked(data[at : at + RECORD.size])))
            except can.CanError:
                self.dropped_frames += 1


def opened(text: str, bitrate: int) -> can.BusABC:
    """The bus that `interface=…,channel=…` and further options name, each as python-can calls it.

    Raises ValueError for what is no list of options, and for a bus that python-can cannot open.
    """
    options: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals or not name.isidentifier():
            raise ValueError(f"--python-can is {text!r}, but must be KEY=VALUE with commas between.")
        options[name] = yaml.safe_load(value)
    if "interface" not in options:
        raise ValueError(f"--python-can is {text!r}, but must name an interface: interface=virtual,channel=0.")
    try:
        return can.Bus(ignore_config=True, **{"bitrate": bitrate, **options})
    except (can.CanError, OSError, TypeError, NotImplementedError) as problem:
        raise ValueError(f"python-can cannot open {text} ({problem}); name a bus that it can open.") from None


def frame_of(message: can.Message) -> Frame | None:
    """A message as the simulated bus has it; None for what no drive hears: error frames, CAN FD, one's own."""
    if message.is_error_frame or message.is_fd or not message.is_rx:
        return None
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(message.arbitration_id, data, message.is_extended_id, message.is_remote_frame)


def message_of(frame: Frame) -> can.Message:
    """A frame of the simulated bus as python-can sends it."""
    return can.Message(
        arbitration_id=frame.can_id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        dlc=len(frame.data),
        data=None if frame.remote else frame.data,
    )
