"""The kernel's ring of trace events, in an instance of our own, so that nobody else's settings are touched."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from rtarm.console.errors import Refusal

PLACES = (Path("/sys/kernel/tracing"), Path("/sys/kernel/debug/tracing"))
NAME = "rtarm-"
RING_KB = 4096
"""Of each processor: 100,000 events, which a flood of interrupts fills in a second."""
READ_BYTES = 1 << 16
ATTEMPTS = 5
MOST_S = 0.5
"""Where events come faster than they are read, a read ends after this, and the ring loses some."""

EVENTS: dict[str, str] = {
    "sched/sched_switch": "",
    "sched/sched_waking": "pid == {tid}",
    "sched/sched_wakeup": "pid == {tid}",
    "sched/sched_migrate_task": "pid == {tid}",
    "irq/irq_handler_entry": "",
    "irq/irq_handler_exit": "",
    "irq/softirq_entry": "",
    "irq/softirq_exit": "",
    "irq_vectors/*_entry": "",
    "irq_vectors/*_exit": "",
    "ipi/ipi_*": "",
    "timer/hrtimer_expire_entry": "",
    "timer/hrtimer_expire_exit": "",
    "workqueue/workqueue_execute_start": "",
    "workqueue/workqueue_execute_end": "",
    "exceptions/page_fault_*": "common_pid == {tid}",
    "signal/signal_generate": "sig >= 19 && sig <= 22",
}
"""What is traced, as far as the machine has it, and the filter that keeps what nobody asks for out of the ring."""
NEEDED = ("sched/sched_switch", "sched/sched_waking")


class NotTraced(Refusal):
    """Trace events cannot be read here; the sentence says why and what to do."""


def place() -> Path:
    """Where the kernel's trace is mounted; it is not mounted here.

    Raises:
        NotTraced: nowhere, or it may not be used.
    """
    if not any(_is_there(path) for path in PLACES):
        raise NotTraced(
            "Trace events cannot be read here, since tracefs is not mounted or may not be looked at: as root, "
            f"`mount -t tracefs nodev {PLACES[0]}`, then try again as root."
        )
    for path in PLACES:
        if os.access(path / "instances", os.W_OK):
            return path
    raise NotTraced("Trace events cannot be read here without permission: try again as root, with `sudo`.")


def _is_there(path: Path) -> bool:
    try:
        return (path / "instances").is_dir()
    except OSError:
        return False


class Trace:
    """The ring, while it is written; each event is read once."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def read(self) -> str:
        """What was traced since the last time, in the order of time; never waits.

        To be called a few times in the time that it takes to fill the ring. Events are made text by the kernel, in the
        time of who reads: to read them all costs less, and loses less, than to read a full ring when a cycle was late.
        """
        found, end_s = [], time.monotonic() + MOST_S
        with contextlib.suppress(BlockingIOError):
            while time.monotonic() < end_s:
                found.append(os.read(self._fd, READ_BYTES))
        return b"".join(found).decode(errors="replace")


@contextlib.contextmanager
def traced(tid: int, ring_kb: int = RING_KB) -> Iterator[Trace]:
    """A ring of the events that concern a thread, gone at the end; what killed ones have left goes now.

    Raises:
        NotTraced: it cannot be had.
    """
    folder = place() / "instances" / f"{NAME}{os.getpid()}"
    fd = _opened(folder)
    try:
        _set_up(folder, tid, ring_kb)
        yield Trace(fd)
    finally:
        os.close(fd)
        _remove(folder)


def _opened(folder: Path) -> int:
    """The ring of a new instance; as long as it is open, nobody removes the instance as left behind."""
    for attempt in range(ATTEMPTS):
        for left in folder.parent.glob(f"{NAME}*"):
            _remove(left)
        try:
            folder.mkdir()
            return os.open(folder / "trace_pipe", os.O_RDONLY | os.O_NONBLOCK)
        except FileExistsError:
            raise NotTraced("This process reads trace events already: let that end first.") from None
        except OSError as error:  # between the two, another one that starts may have removed it
            if attempt == ATTEMPTS - 1:
                raise _refused(error) from None
    raise AssertionError("unreachable")


def _set_up(folder: Path, tid: int, ring_kb: int) -> None:
    try:
        (folder / "tracing_on").write_text("0")
        (folder / "trace_clock").write_text("mono")
        (folder / "buffer_size_kb").write_text(str(ring_kb))
        for pattern, wanted in EVENTS.items():
            group, _, name = pattern.partition("/")
            found = [event for event in (folder / "events" / group).glob(name) if event.is_dir()]
            if not found and pattern in NEEDED:
                raise NotTraced(f"Trace events cannot be read here: this kernel has no event {pattern}.")
            for event in found:
                if wanted:
                    (event / "filter").write_text(wanted.format(tid=tid))
                (event / "enable").write_text("1")
        (folder / "tracing_on").write_text("1")
    except OSError as error:
        raise _refused(error) from None


def _refused(error: OSError) -> NotTraced:
    return NotTraced(
        f"Trace events cannot be read here, since {error.filename} refuses it ({error.strerror}): try again as root, "
        "outside of containers."
    )


def _remove(folder: Path) -> None:
    """Give an instance back to the kernel, unless somebody uses it."""
    with contextlib.suppress(OSError):
        folder.rmdir()
