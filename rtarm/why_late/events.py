"""The kernel's trace, as text, in events; lines that mean nothing here are passed over.

A line is `  comm-pid  [cpu] flags seconds.micros: event: fields`, and says with every event which task its processor
was in. The flags differ from kernel to kernel in their columns, not in their letters. Times are CLOCK_MONOTONIC (the
instance's clock is `mono`), cut to whole µs.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

NEVER_PID = -1
NORMAL_PRIO = 100
"""The kernel's priorities from here on are those of ordinary tasks; below, 99 less the real-time priority."""
MOST_WITHOUT_TIME = 64
"""More remarks than that do not follow each other amid a trace."""
NAMELESS = "<...>"
"""What stands for the name of a task that the kernel does not remember."""


class Task(NamedTuple):
    """A task, with the kernel's priority (None where the event does not say)."""

    name: str
    pid: int
    prio: int | None = None

    @property
    def is_idle(self) -> bool:
        return self.pid == 0


class Event(NamedTuple):
    """Something at a moment on a processor, in a task. What `what` may be stands below.

    `bare` is set where the flags say that the processor was in no interrupt or softirq.
    """

    time_ns: int
    cpu: int
    task: Task
    what: Switch | Woken | Moved | Enter | Exit | Fault | Signal | Work | Sent | Lost
    bare: bool = False


class Switch(NamedTuple):
    """The processor went from one task to another; `state` is what the first goes on as, such as R, S, D, T."""

    before: Task
    state: str
    after: Task


class Woken(NamedTuple):
    """A task became ready to run, on this processor as far as it is decided yet."""

    pid: int
    cpu: int


class Moved(NamedTuple):
    """A task was moved."""

    pid: int
    cpu: int


class Enter(NamedTuple):
    """Something began that ends with the `Exit` of the same key: `hard` an interrupt, else a softirq.

    `timer` is set for the callback of a timer, within an interrupt or a softirq; it ends with the next one, too.
    """

    key: str
    name: str
    hard: bool
    timer: bool = False


class Exit(NamedTuple):
    """It ended."""

    key: str


class Fault(NamedTuple):
    """The task touched a page that is not there; the trace does not say when that is over."""


class Signal(NamedTuple):
    """The task sent a signal to another one."""

    number: int
    pid: int


class Work(NamedTuple):
    """A worker of the kernel began with a function ("": ended)."""

    function: str


class Sent(NamedTuple):
    """The task made another processor take an interrupt."""

    cpus: frozenset[int]


class Lost(NamedTuple):
    """Events of the processor were overwritten before they were read, from the one before on."""


_LINE = re.compile(r"^\s*(.+)-(\d+)\s+(?:\([^)]*\)\s+)?\[(\d+)\]\s+(?:(\S+)\s+)?(\d+)\.(\d{6}): (\w+): ?(.*)$")
_HARD, _ABOVE = re.compile("[hHzZ]"), re.compile("[hHzZsS]")
"""Flags of an interrupt, and of that or a softirq."""
_TIME = re.compile(r"\] *\S* +(\d+)\.(\d{6}): ")
_LOST = re.compile(r"CPU:(\d+) \[LOST (?:\d+ )?EVENTS\]")
_SWITCH = re.compile(
    r"prev_comm=(.*) prev_pid=(\d+) prev_prio=(-?\d+) prev_state=(\S+) ==> "
    r"next_comm=(.*) next_pid=(\d+) next_prio=(-?\d+)"
)
_WOKEN = re.compile(r"pid=(\d+) prio=-?\d+ target_cpu=(\d+)")
_MOVED = re.compile(r"pid=(\d+) prio=-?\d+ orig_cpu=\d+ dest_cpu=(\d+)")
_SIGNAL = re.compile(r"sig=(\d+) .*pid=(\d+) grp=")
_IRQ = re.compile(r"irq=(\d+)(?: name=(.*))?")
_SOFTIRQ = re.compile(r"vec=(\d+) \[action=(\w+)\]")
_HRTIMER = re.compile(r"function=(\S+)")
_WORK = re.compile(r"function (\S+)")
_IPI = re.compile(r"\((.*)\)")
_SENT = re.compile(r"cpu=(\d+)")
_SENT_TO_MANY = re.compile(r"mask=([0-9a-f,]+) ")


def _switch(found: re.Match[str]) -> Switch:
    before, pid, prio, state, after, next_pid, next_prio = found.groups()
    return Switch(Task(before, int(pid), int(prio)), state, Task(after, int(next_pid), int(next_prio)))


def _sent_to_many(found: re.Match[str]) -> Sent:
    bits = int(found[1].replace(",", "") or "0", 16)
    return Sent(frozenset(cpu for cpu in range(bits.bit_length()) if bits >> cpu & 1))


_READ: dict[str, tuple[re.Pattern[str], Callable[[re.Match[str]], Event | tuple[object, ...]]]] = {
    "sched_switch": (_SWITCH, _switch),
    "sched_waking": (_WOKEN, lambda m: Woken(int(m[1]), int(m[2]))),
    "sched_wakeup": (_WOKEN, lambda m: Woken(int(m[1]), int(m[2]))),
    "sched_migrate_task": (_MOVED, lambda m: Moved(int(m[1]), int(m[2]))),
    "signal_generate": (_SIGNAL, lambda m: Signal(int(m[1]), int(m[2]))),
    "irq_handler_entry": (_IRQ, lambda m: Enter(f"irq {m[1]}", f"{m[2]} (irq {m[1]})", hard=True)),
    "irq_handler_exit": (_IRQ, lambda m: Exit(f"irq {m[1]}")),
    "softirq_entry": (_SOFTIRQ, lambda m: Enter(f"softirq {m[1]}", m[2], hard=False)),
    "softirq_exit": (_SOFTIRQ, lambda m: Exit(f"softirq {m[1]}")),
    "hrtimer_expire_entry": (_HRTIMER, lambda m: Enter("hrtimer", m[1], hard=True, timer=True)),
    "hrtimer_expire_exit": (re.compile(""), lambda _: Exit("hrtimer")),
    "workqueue_execute_start": (_WORK, lambda m: Work(m[1])),
    "workqueue_execute_end": (re.compile(""), lambda _: Work("")),
    "ipi_entry": (_IPI, lambda m: Enter("ipi", m[1], hard=True)),  # of processors without irq_vectors
    "ipi_exit": (re.compile(""), lambda _: Exit("ipi")),
    "ipi_raise": (_SENT_TO_MANY, _sent_to_many),
    "ipi_send_cpu": (_SENT, lambda m: Sent(frozenset([int(m[1])]))),
    "ipi_send_cpumask": (_SENT_TO_MANY, _sent_to_many),
    "page_fault_user": (re.compile(""), lambda _: Fault()),
    "page_fault_kernel": (re.compile(""), lambda _: Fault()),
}


def _what(name: str, fields: str) -> object | None:
    """What an event says, None where it says nothing here."""
    if name in _READ:
        pattern, made = _READ[name]
        found = pattern.search(fields)
        return made(found) if found else None
    if fields.startswith("vector="):  # an interrupt of its own kind
        if name.endswith("_entry"):
            return Enter(name[:-6], name[:-6], hard=True)
        if name.endswith("_exit"):
            return Exit(name[:-5])
    return None


def time_of(line: str) -> int | None:
    """When a line's event was (ns), None for a line without one."""
    found = _TIME.search(line)
    return int(found[1] + found[2]) * 1000 if found else None


def since(lines: Sequence[str], start_ns: int) -> Sequence[str]:
    """The lines from a moment on; they are in the order of time."""

    def at(number: int) -> int:  # a line without a time has that of the next
        times = (time_of(line) for line in lines[number : number + MOST_WITHOUT_TIME])
        return next((time_ns for time_ns in times if time_ns is not None), 1 << 62)

    return lines[bisect_left(range(len(lines)), start_ns, key=at) :]


def parse(lines: Sequence[str]) -> Iterator[Event]:
    """The events of the lines, in their order; that some were lost is of the moment behind which they are missing."""
    names: dict[int, str] = {}
    last_ns: dict[int, int] = {}
    for line in lines:
        found = _LINE.match(line)
        if found is None:
            if lost := _LOST.search(line):
                yield Event(last_ns.get(int(lost[1]), 0), int(lost[1]), Task("", NEVER_PID), Lost())
            continue
        comm, pid, cpu, flags, seconds, micros, name, fields = found.groups()
        time_ns = last_ns[int(cpu)] = int(seconds + micros) * 1000
        what = _what(name, fields)
        if what is None:
            continue
        if isinstance(what, Switch):
            names[what.before.pid], names[what.after.pid] = what.before.name, what.after.name
        elif isinstance(what, Enter) and what.timer and flags and not _HARD.search(flags):
            what = what._replace(hard=False)  # a softirq calls it
        task = Task(names.get(int(pid), comm) if comm == NAMELESS else comm, int(pid))
        yield Event(time_ns, int(cpu), task, what, bool(flags) and not _ABOVE.search(flags))  # type: ignore[arg-type]
