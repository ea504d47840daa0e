"""A simulated arm in real time behind a pseudo-terminal, as if it were `/dev/ttyUSB0`.

One thread waits for bytes from the host or for the arm's next own moment, whichever comes first. Bytes
for the host travel in packets, as through USB: the first after a silence at once, then at most one
packet a millisecond.

The slave side is kept open here too, so a host may close the port and open it again; what the adapter
sends meanwhile waits in the terminal, and is lost when that is full.
"""

from __future__ import annotations

import contextlib
import os
import select
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path

from sim.arm import SimulatedArm
from sim.truth import Heard
from sim.waking import READ_SIZE, Waking

PACKET_NS = 1_000_000
"""Time between two packets of a full-speed USB adapter."""
LOOK_NS = 10_000_000
"""It looks up as often as this, so that it knows when it was not let."""
HELD_UP_NS = 80_000_000
"""A simulated arm that looks up so much later is, with the way of its bytes, silent for what is a fault elsewhere."""


class PtyServer(Waking):
    """Serves an arm, whose time must be CLOCK_MONOTONIC, at a pseudo-terminal.

    Args:
        arm: made with `start_ns=time.monotonic_ns()`.
        link: symbolic link to the terminal; one left behind by somebody else is replaced.

    Attributes:
        tty_path: the terminal a host opens.
        dropped_bytes: bytes to the host that found the terminal full.
        heard: what the host wrote, kept for `sim.truth` where this is a list.
        on_held_up: told for how long (ns) this machine did not run the arm.

    Raises:
        ValueError: the arm has no serial adapter.
        FileNotFoundError: there is no folder for the link.
        FileExistsError: the link's path holds something that is not a symbolic link.
    """

    def __init__(self, arm: SimulatedArm, link: Path | None = None) -> None:
        self.arm = arm
        self._adapter = arm.serial_adapter()
        self.dropped_bytes = 0
        self.heard: Heard | None = None
        self.on_held_up: Callable[[int], None] = lambda late_ns: None
        self._link = link
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        super().__init__()
        tty.setraw(self._slave)
        self.tty_path = os.ttyname(self._slave)
        if link is not None:
            try:
                self._make_link(link)
            except OSError:
                self._close_descriptors()
                raise

    @property
    def place(self) -> str:
        """Where a host finds the arm."""
        return self.tty_path

    def serve(self, attend: Callable[[], bool], watched: Sequence[int] = ()) -> None:
        """Serve until `attend` says False.

        Args:
            attend: called at the start, after every byte at `wake_descriptor`, and whenever one of
                `watched` has something to read, which it must then read.
            watched: further descriptors; may change from call to call of `attend`.
        """
        arm = self.arm
        packet_ns = time.monotonic_ns()
        going = attend()
        while going:
            due_ns = arm.next_due_ns()
            now_ns = time.monotonic_ns()
            wake_ns = now_ns + LOOK_NS
            if due_ns is not None:
                wake_ns = min(max(due_ns, packet_ns, now_ns), wake_ns)
            listens = (self._master,) if self._adapter.takes_characters else ()
            readable, _, _ = select.select((*listens, self._wake_read, *watched), (), (), (wake_ns - now_ns) * 1e-9)
            now_ns = time.monotonic_ns()
            if now_ns - wake_ns > HELD_UP_NS:
                self.on_held_up(now_ns - wake_ns)
            if self._master in readable:
                data = os.read(self._master, READ_SIZE)
                if self.heard is not None:
                    self.heard.append((now_ns, data))
                arm.feed(now_ns, data)
            if now_ns >= packet_ns and (data := arm.collect(now_ns)):
                self._write(data)
                packet_ns = now_ns + PACKET_NS
            if self._wake_read in readable:
                self._awake()
            if not {self._master}.issuperset(readable):
                going = attend()

    def close(self) -> None:
        """Remove the link, if it is still ours, and end the terminal."""
        if self._link is not None and os.path.islink(self._link) and os.readlink(self._link) == self.tty_path:
            self._link.unlink()
        self._close_descriptors()

    def _make_link(self, link: Path) -> None:
        if not link.parent.is_dir():
            raise FileNotFoundError(f"there is no folder {link.parent} for {link}; create it or choose another.")
        if link.exists() and not link.is_symlink():
            raise FileExistsError(
                f"{link} exists and is not a symbolic link, so it is not replaced; choose another path."
            )
        fresh = link.with_name(f".{link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self.tty_path)
        os.replace(fresh, link)

    def _write(self, data: bytes) -> None:
        written = 0
        with contextlib.suppress(BlockingIOError):
            written = os.write(self._master, data)
        self.dropped_bytes += len(data) - written

    def _close_descriptors(self) -> None:
        super().close()
        for descriptor in (self._master, self._slave):
            os.close(descriptor)
