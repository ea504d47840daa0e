"""The kernel's ring of trace events, in an instance of our own, so that nobody else's settings are touched."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rtarm.console.errors import Refusal
from rtarm.console.language import said
from rtarm.doctor.machine import Unknown, cpu_list
from sentences.meaning import Language

PLACES = (Path("/sys/kernel/tracing"), Path("/sys/kernel/debug/tracing"))
NAME = "rtarm-"
RING_KB, ALL_RINGS_KB = 4096, 65536
"""Of each processor that the thread may use (50,000 events, which a flood of interrupts fills in a second), and of
all of them together."""
OTHER_RING_KB = 256
READ_BYTES = 1 << 16
ATTEMPTS = 5
MOST_S = 0.5
"""Where events come faster than they are read, a read ends after this, and the next one goes on."""
WITHOUT_TICK = Path("/sys/devices/system/cpu/nohz_full")
FIRST_PID_NAMESPACE = 0xEFFFFFFC
"""The kernel's own number of it, in which the trace counts tasks."""
OPTIONS = (
    *("context-info", "irq-info", "overwrite", "nolatency-format", "noraw", "nohex", "nobin", "noverbose"),
    *("nofields", "nostacktrace", "nouserstacktrace", "nobitmask-list"),
)
"""How lines are written; an instance begins with what somebody has set for the whole machine."""


class Wanted(NamedTuple):
    """Filters that keep what nobody asks for out of the ring: of any thread, and what is enough of a pinned one."""

    always: str = ""
    pinned: str = ""


ITS_PROCESSOR = "CPU == {cpu}"
EVENTS: dict[str, Wanted] = {
    "sched/sched_switch": Wanted("", ITS_PROCESSOR),
    "sched/sched_waking": Wanted("pid == {tid}"),
    "sched/sched_wakeup": Wanted("pid == {tid}"),
    "sched/sched_migrate_task": Wanted("pid == {tid}"),
    "irq/irq_handler_entry": Wanted("", ITS_PROCESSOR),
    "irq/irq_handler_exit": Wanted("", ITS_PROCESSOR),
    "irq/softirq_entry": Wanted("", ITS_PROCESSOR),
    "irq/softirq_exit": Wanted("", ITS_PROCESSOR),
    "irq_vectors/*_entry": Wanted("", ITS_PROCESSOR),
    "irq_vectors/*_exit": Wanted("", ITS_PROCESSOR),
    "ipi/ipi_entry": Wanted("", ITS_PROCESSOR),
    "ipi/ipi_exit": Wanted("", ITS_PROCESSOR),
    "ipi/ipi_raise": Wanted(),
    "ipi/ipi_send_cpu": Wanted("", "cpu == {cpu}"),
    "ipi/ipi_send_cpumask": Wanted("", "cpumask & CPUS{{{cpu}}}"),
    "timer/hrtimer_expire_entry": Wanted("", ITS_PROCESSOR),
    "workqueue/workqueue_execute_start": Wanted("", ITS_PROCESSOR),
    "workqueue/workqueue_execute_end": Wanted("", ITS_PROCESSOR),
    "exceptions/page_fault_*": Wanted("common_pid == {tid}"),
    "signal/signal_generate": Wanted("sig >= 19 && sig <= 22 && (pid == {tid} || pid == {pid})"),
}
"""What is traced, as far as the machine has it. The end of a timer's callback is not: the next event tells enough."""
NEEDED = ("sched/sched_switch", "sched/sched_waking", "timer/hrtimer_expire_entry")


NOT_MOUNTED = (
    "Trace events cannot be read here, since tracefs is not mounted or may not be looked at: as root, "
    "`mount -t tracefs nodev {place}`, then try again as root."
)
CONTAINED = (
    "Trace events are of no use within this container, since they count processes otherwise: try again outside of it, "
    "or in one with the host's processes (`--pid=host`)."
)
FORBIDDEN = "Trace events cannot be read here without permission: try again as root, with `sudo`."
TWICE = "This process reads trace events already: let that end first."
NO_EVENT = "Trace events cannot be read here: this kernel has no event {event}."
REFUSED = "Trace events cannot be read here, since {path} refuses it ({why}): try again as root, outside of containers."
REASONS = (NOT_MOUNTED, CONTAINED, FORBIDDEN, TWICE, NO_EVENT, REFUSED)


class NotTraced(Refusal):
    """Trace events cannot be read here; the sentence, one of `REASONS`, says why and what to do."""

    def __init__(self, template: str, **values: object) -> None:
        super().__init__(template.format(**values))
        self._template, self._values = template, values

    def told(self, language: Language) -> str:
        """The sentence in a language."""
        return said(language, self._template, **self._values)


def place() -> Path:
    """Where the kernel's trace is mounted; it is not mounted here.

    Raises:
        NotTraced: nowhere, or it may not be used.
    """
    if not any(_is_there(path) for path in PLACES):
        raise NotTraced(NOT_MOUNTED, place=PLACES[0])
    if _pid_namespace() != FIRST_PID_NAMESPACE:
        raise NotTraced(CONTAINED)
    for path in PLACES:
        if os.access(path / "instances", os.W_OK):
            return path
    raise NotTraced(FORBIDDEN)


def _pid_namespace() -> int:
    return os.stat("/proc/self/ns/pid").st_ino


def _is_there(path: Path) -> bool:
    try:
        return (path / "instances").is_dir()
    except OSError:
        return False


class Trace:
    """The ring, while it is written; each event is read once."""

    def __init__(self, fd: int, folder: Path, tid: int) -> None:
        self._fd, self._folder, self._tid = fd, folder, tid
        self._cpus = _allowed(tid)

    def read(self) -> str:
        """What was traced since the last time, in the order of time; never waits.

        To be called a few times in the time that it takes to fill the ring. Events are made text by the kernel, in the
        time of who reads: to read them all costs less, and loses less, than to read a full ring when a cycle was late.
        """
        self._follow()
        found, end_s = [], time.monotonic() + MOST_S
        with contextlib.suppress(BlockingIOError):
            while time.monotonic() < end_s:
                found.append(os.read(self._fd, READ_BYTES))
                if not found[-1]:  # somebody has turned the ring off
                    break
        return b"".join(found).decode(errors="replace")

    def _follow(self) -> None:
        """Trace where the thread may run now; until then what goes on there is unknown."""
        cpus = _allowed(self._tid)
        if cpus and cpus != self._cpus:
            self._cpus = cpus
            with contextlib.suppress(NotTraced):
                _filter(self._folder, self._tid, cpus)


def _allowed(tid: int) -> set[int]:
    """The processors that a thread may use; none when it is gone."""
    try:
        return os.sched_getaffinity(tid)
    except OSError:
        return set()


@contextlib.contextmanager
def traced(tid: int, ring_kb: int = RING_KB) -> Iterator[Trace]:
    """A ring of the events that concern a thread, gone at the end; what killed ones have left goes now.

    Raises:
        NotTraced: it cannot be had.
    """
    folder = place() / "instances" / f"{NAME}{os.getpid()}"
    fd = _opened(folder)
    try:
        trace = Trace(fd, folder, tid)
        _set_up(folder, tid, ring_kb)
        yield trace
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
            raise NotTraced(TWICE) from None
        except OSError as error:  # between the two, another one that starts may have removed it
            if attempt == ATTEMPTS - 1:
                raise _refused(folder, error) from None
    raise AssertionError("unreachable")


def _set_up(folder: Path, tid: int, ring_kb: int) -> None:
    cpus = _allowed(tid)
    _write(folder / "tracing_on", "0")
    _write(folder / "trace_clock", "mono")
    for option in OPTIONS:
        with contextlib.suppress(NotTraced):  # which this kernel does not know
            _write(folder / "trace_options", option)
    _write(folder / "buffer_size_kb", str(min(ring_kb, OTHER_RING_KB)))
    for cpu in cpus:
        with contextlib.suppress(NotTraced):  # it is not there just now
            ring = folder / f"per_cpu/cpu{cpu}/buffer_size_kb"
            _write(ring, str(max(OTHER_RING_KB, min(ring_kb, ALL_RINGS_KB // len(cpus)))))
    for pattern in NEEDED:
        if not _found(folder, pattern):
            raise NotTraced(NO_EVENT, event=pattern)
    _filter(folder, tid, cpus)
    for pattern in EVENTS:
        for event in _found(folder, pattern):
            _write(event / "enable", "1")
    _write(folder / "tracing_on", "1")


def _filter(folder: Path, tid: int, cpus: set[int]) -> None:
    """Let in what concerns a thread that may use these processors."""
    names = {"tid": tid, "pid": _process_of(tid), "cpu": min(cpus, default=0)}
    for pattern, wanted in EVENTS.items():
        for event in _found(folder, pattern):
            _write(event / "filter", wanted.always.format(**names) or "0")
            if wanted.pinned and len(cpus) == 1 and not _timers_elsewhere(cpus):
                with contextlib.suppress(NotTraced):  # an older kernel, which then traces more
                    _write(event / "filter", wanted.pinned.format(**names))


def _timers_elsewhere(cpus: set[int]) -> bool:
    """Whether timers of these processors expire on others, which are then what may be late."""
    try:
        return not cpus.isdisjoint(cpu_list(WITHOUT_TICK.read_text().strip(), str(WITHOUT_TICK)))
    except (OSError, Unknown):  # the kernel has no such processors
        return False


def _found(folder: Path, pattern: str) -> list[Path]:
    """The folders of the events that a pattern means."""
    group, _, name = pattern.partition("/")
    return [event for event in (folder / "events" / group).glob(name) if event.is_dir()]


def _process_of(tid: int) -> int:
    """The number of a thread's process; its own when it is gone."""
    with contextlib.suppress(OSError, ValueError):
        return int(Path(f"/proc/{tid}/status").read_text().partition("\nTgid:")[2].split(maxsplit=1)[0])
    return tid


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text)
    except OSError as error:
        raise _refused(path, error) from None


def _refused(path: Path, error: OSError) -> NotTraced:
    return NotTraced(REFUSED, path=path, why=error.strerror)


def _remove(folder: Path) -> None:
    """Give an instance back to the kernel, unless somebody uses it."""
    with contextlib.suppress(OSError):
        folder.rmdir()
