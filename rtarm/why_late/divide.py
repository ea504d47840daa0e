"""Where a thread's time went: trace events in, segments out that add up to the interval exactly.

Nothing here knows of arms. What a processor was doing is followed from event to event (task, interrupts and softirqs
on top of it), and so is the thread (asleep, ready, running, stopped). Between two events both are constant, and the
pair of them is the cause. What is not known from an event before is unknown; nor is anything that rests on events of a
processor that were lost.

Some kernels do not tell of the switch from idle to a task (seen on Linux 6.18, on all processors of a virtual machine
but the first). So such a switch is also taken from the events that follow, each of which names the task it came in.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import NamedTuple

from rtarm.why_late.causes import Cause
from rtarm.why_late.events import (
    NORMAL_PRIO,
    Enter,
    Event,
    Exit,
    Fault,
    Lost,
    Moved,
    Sent,
    Signal,
    Switch,
    Task,
    Woken,
    Work,
)

FAULT_NS = 20_000
"""A page fault lasts until the thread's next event, and at most so long: its end is no event.

What is beyond may be a slow fault or the thread's own work, so it is unknown.
"""
STILL_NS = 100_000
"""A processor that was taken away for less than this is not told from one that is slow."""
SENT = ("call_function", "call_function_single", "reschedule", "irq_work", "ipi")
"""Interrupts that processors send each other."""
SENT_NS = 1_000_000
"""An interrupt that comes later is not that which was sent: a processor that is on its way anyway takes none."""
DEBUGGER = "a debugger"
SLOW_FAULT = "a slow page fault, or our own work after it"
STOPPER = "the kernel's stopper, before all others"
BEFORE_US, NO_PRIORITY, SAME = "before us", "we have no real-time priority", "same as ours, and came first"
BEHIND_US = "behind us, but could not be interrupted at once"
HELD_BACK = "ready beside an idle processor: a limit of its time, such as cpu.max of its control group"
_OF_A_TASK = Woken | Moved | Signal | Sent
"""Events of processors of which nothing else may be traced, so that what they are in is not followed."""
STOPPING_SIGNALS = {19: "SIGSTOP", 20: "SIGTSTP", 21: "SIGTTIN", 22: "SIGTTOU"}


class Segment(NamedTuple):
    """A stretch of time with one cause; `who` names the interrupt, task or signal, "" where there is none."""

    start_ns: int
    end_ns: int
    cause: Cause
    who: str = ""

    @property
    def length_ns(self) -> int:
        return self.end_ns - self.start_ns


NO_TIMER = -1
NEVER_NS = -1


class _Is(Enum):
    RUNNING = auto()
    READY = auto()
    ASLEEP = auto()
    BLOCKED = auto()
    STOPPED = auto()
    UNKNOWN = auto()


@dataclass
class _Processor:
    task: Task | None = None
    entered: list[Enter] = field(default_factory=list)
    work: str = ""
    sender: str = ""
    sent_ns: int = 0
    whole: bool = True
    """Nothing is missing in `entered`."""


@dataclass
class _Thread:
    tid: int
    state: _Is = _Is.UNKNOWN
    cpu: int = -1
    moved: bool = False
    prio: int | None = None
    fault_ns: int | None = None
    stopped_by: str = ""
    faulting: bool = False
    held_back: bool = False


class Divider:
    """Divides intervals of a thread by the same events, which are in the order of time."""

    def __init__(self, events: Sequence[Event], tid: int) -> None:
        self._events, self._tid = events, tid
        self._times = [event.time_ns for event in events]
        self._woken = _woken_from(events, tid)
        self._unseen = _left_idle_unseen(events)

    def divide(
        self, start_ns: int, end_ns: int, *, runs: bool, slept_by_ns: int, history_ns: int | None = None
    ) -> list[Segment]:
        """The causes of an interval. The segments follow each other without a gap; neighbours differ in cause or name.

        `runs`: the thread is known to run at its start, since it read the clock then. A sleep that begins later than
        `slept_by_ns` is none for the timer that is due, whoever ends it. Events older than `history_ns` before the
        start are not looked at; None: all are.
        """
        found: list[Segment] = []
        processors: dict[int, _Processor] = {}
        thread = _Thread(self._tid)
        now_ns = start_ns
        first = 0 if history_ns is None else bisect_left(self._times, start_ns - history_ns)
        for number in range(first, len(self._events)):
            event = self._events[number]
            if runs and event.time_ns >= start_ns:
                runs = _found_running(processors, thread)
            until_ns = min(event.time_ns, end_ns)
            if until_ns > now_ns:
                found += _constant(processors, thread, now_ns, until_ns)
                now_ns = until_ns
            if event.time_ns >= end_ns:
                break
            processor = processors.setdefault(event.cpu, _Processor())
            woken = self._woken.get(number)
            if woken is not None and event.time_ns > slept_by_ns:
                woken = NO_TIMER
            _follow(processor, thread, event, woken)
            task = self._unseen.get(number)
            if task is not None and task.pid != self._tid:
                processor.task = task
            if isinstance(event.what, Sent):
                for cpu in event.what.cpus:
                    sent = processors.setdefault(cpu, _Processor())
                    sent.sender, sent.sent_ns = _named(event.task), event.time_ns
        if runs:
            _found_running(processors, thread)
        found += _constant(processors, thread, now_ns, end_ns)
        return list(_merged(found))


def stood_still(segments: Iterable[Segment], stolen_ns: int) -> list[Segment]:
    """The same, with what the host's own count of the time that it took explains.

    `stolen_ns` is what was counted of the thread's processor around the interval. The longest silences come first, so
    that nothing is explained twice.
    """
    given = list(segments)
    silent = (Cause.TIMER_IDLE, Cause.MASKED, Cause.OWN, Cause.IDLE_EXIT)
    for number in sorted(range(len(given)), key=lambda one: -given[one].length_ns):
        segment = given[number]
        if segment.cause in silent and 2 * stolen_ns >= segment.length_ns >= STILL_NS:
            given[number] = segment._replace(cause=Cause.STOOD_STILL)
            stolen_ns -= segment.length_ns
    return list(_merged(given))


def _woken_from(events: Sequence[Event], tid: int) -> dict[int, int]:
    """The processor whose timer woke the thread, or NO_TIMER, by the number of the event with which it fell asleep.

    What an interrupt did that was not traced is not known.
    """
    found: dict[int, int] = {}
    asleep: int | None = None
    timers: set[int] = set()
    entered: Counter[int] = Counter()
    for number, event in enumerate(events):
        match event.what:
            case Enter(timer=True):
                timers.add(event.cpu)
            case Enter():
                entered[event.cpu] += 1
            case Exit(key=key):
                timers.discard(event.cpu)
                entered[event.cpu] -= key != "hrtimer" and entered[event.cpu] > 0
            case Switch() | Lost():
                timers.discard(event.cpu)
                entered[event.cpu] = 0
        match event.what:
            case Switch(before=before) if before.pid == tid:
                asleep = number
            case Woken(pid=pid) if pid == tid and asleep is not None:
                if event.cpu in timers:
                    found[asleep] = event.cpu
                elif event.bare or entered[event.cpu]:
                    found[asleep] = NO_TIMER
                asleep = None
    return found


def _left_idle_unseen(events: Sequence[Event]) -> dict[int, Task]:
    """By the number of the last event in idle: the task that had the processor at the next, which was no switch to it.

    The task came at once, since it takes an event for a processor to leave idle.
    """
    found: dict[int, Task] = {}
    last: dict[int, int] = {}
    prios = {task.pid: task.prio for event in events if isinstance(event.what, Switch) for task in event.what[::2]}
    for number, event in enumerate(events):
        if isinstance(event.what, Lost):
            last.pop(event.cpu, None)
        if isinstance(event.what, Lost | _OF_A_TASK):
            continue
        before = last.get(event.cpu)
        if before is not None and _task_behind(events[before]).is_idle and not event.task.is_idle:
            found[before] = event.task._replace(prio=prios.get(event.task.pid))
        last[event.cpu] = number
    return found


def _task_behind(event: Event) -> Task:
    """Which task has the processor behind an event."""
    return event.what.after if isinstance(event.what, Switch) else event.task


def _found_running(processors: dict[int, _Processor], thread: _Thread) -> bool:
    """The thread ran now; False, for this is settled."""
    if thread.state is _Is.READY:
        thread.state = _Is.RUNNING
        processors.setdefault(thread.cpu, _Processor()).task = Task("", thread.tid, thread.prio)
    return False


def _follow(processor: _Processor, thread: _Thread, event: Event, woken: int | None) -> None:
    """Take an event into account; `woken` as `_woken_from` says of it, None where that was not seen."""
    what, tid = event.what, thread.tid
    if isinstance(what, Lost):
        processor.task, processor.entered, processor.whole = None, [], False
        if thread.cpu == event.cpu or thread.state is _Is.READY:  # it may have been moved there
            thread.state = _Is.UNKNOWN
        return
    processor.whole = processor.whole or event.bare
    if not isinstance(what, Switch | _OF_A_TASK) and (processor.task is None or processor.task.pid != event.task.pid):
        processor.task = event.task
    if event.task.pid == tid and not isinstance(what, Switch):
        thread.state, thread.cpu, processor.task = _Is.RUNNING, event.cpu, event.task
    if event.task.pid == tid and not processor.entered and not isinstance(what, Switch | Enter):
        thread.fault_ns = None  # its next event ends a fault
    match what:
        case Switch():
            processor.task, processor.entered, processor.work, processor.whole = what.after, [], "", True
            if what.before.pid == tid:
                thread.cpu, thread.prio, thread.moved = event.cpu, what.before.prio, False
                _leave(thread, what.state, woken)
                thread.held_back = thread.state is _Is.READY and what.after.is_idle
            elif what.after.pid == tid:
                thread.state, thread.cpu, thread.prio = _Is.RUNNING, event.cpu, what.after.prio
        case Enter():
            if what.timer:
                processor.entered = [one for one in processor.entered if not one.timer]
            processor.entered.append(_with_sender(what, processor, event.time_ns))
        case Exit():
            keys = [one.key for one in processor.entered]
            if what.key in keys:
                del processor.entered[keys.index(what.key) :]
        case Fault() if event.task.pid == tid:
            thread.fault_ns = event.time_ns
        case Work():
            processor.work = what.function
        case Woken() if what.pid == tid and thread.state is not _Is.RUNNING:
            thread.state, thread.cpu, thread.held_back = _Is.READY, what.cpu, False
        case Moved() if what.pid == tid:
            thread.moved, thread.cpu = thread.moved or what.cpu != thread.cpu, what.cpu
        case Signal() if what.number in STOPPING_SIGNALS:  # to this thread's process: others are not traced
            thread.stopped_by = f"{STOPPING_SIGNALS[what.number]} from {_named(event.task)}"


def _leave(thread: _Thread, state: str, woken: int | None) -> None:
    """The thread gave up its processor, or lost it."""
    faulting, thread.fault_ns = thread.fault_ns is not None, None
    match state[0]:
        case "R":
            thread.state = _Is.READY
        case "T" | "t":
            thread.state = _Is.STOPPED
            thread.stopped_by = thread.stopped_by if state[0] == "T" else DEBUGGER
        case _ if woken is None:
            thread.state = _Is.UNKNOWN
        case _ if woken == NO_TIMER:
            thread.state, thread.faulting = _Is.BLOCKED, faulting
        case _:
            thread.state, thread.cpu = _Is.ASLEEP, woken


def _constant(processors: dict[int, _Processor], thread: _Thread, start_ns: int, end_ns: int) -> list[Segment]:
    """The time between two events."""
    if end_ns <= start_ns:
        return []
    cause, who = _why(processors.get(thread.cpu), thread)
    if cause is not Cause.PAGE_FAULT or thread.fault_ns is None:
        return [Segment(start_ns, end_ns, cause, who)]
    border_ns = min(max(thread.fault_ns + FAULT_NS, start_ns), end_ns)
    parts = (
        Segment(start_ns, border_ns, cause, who),
        Segment(border_ns, end_ns, Cause.UNKNOWN, SLOW_FAULT),
    )
    return [part for part in parts if part.length_ns]


def _why(processor: _Processor | None, thread: _Thread) -> tuple[Cause, str]:
    """The cause, and its name, as long as nothing happens."""
    match thread.state:
        case _Is.UNKNOWN:
            return Cause.UNKNOWN, ""
        case _Is.STOPPED:
            return Cause.STOPPED, thread.stopped_by
        case _Is.BLOCKED:
            return (Cause.PAGE_FAULT, "") if thread.faulting else (Cause.BLOCKED, "")
    if processor is None or processor.task is None or not (processor.whole or processor.entered):
        return Cause.UNKNOWN, ""
    task, above = processor.task, processor.entered
    hard = [one for one in above if one.hard]
    if hard:
        return Cause.INTERRUPT, ": ".join(one.name for one in hard[-2:])
    if thread.state is _Is.ASLEEP:
        return _why_no_timer(task, above)
    if above:
        return Cause.SOFTIRQ, above[-1].name
    if thread.state is _Is.RUNNING:
        return (Cause.OWN, "") if thread.fault_ns is None else (Cause.PAGE_FAULT, "")
    if task.pid == thread.tid:
        return Cause.UNKNOWN, ""
    if task.is_idle and thread.held_back and not thread.moved:
        return Cause.UNKNOWN, HELD_BACK
    if task.is_idle:
        return (Cause.MIGRATION if thread.moved else Cause.IDLE_EXIT), ""
    return Cause.TASK, _described(task, processor.work, thread.prio)


def _why_no_timer(task: Task, above: Sequence[Enter]) -> tuple[Cause, str]:
    """Why the timer that is due does not fire; softirqs and tasks let it, unless they forbid interrupts."""
    if above:
        return Cause.MASKED, f"softirq {above[-1].name}"
    return (Cause.TIMER_IDLE, "") if task.is_idle else (Cause.MASKED, _named(task))


def _described(task: Task, work: str, own_prio: int | None) -> str:
    """A task that runs while we wait, and why it may."""
    named = _named(task) + (f", {work}" if work else "")
    if task.name.startswith("migration/"):
        return f"{named}: {STOPPER}"
    if task.prio is None or own_prio is None:
        return named
    if task.prio < own_prio:
        why = BEFORE_US
    elif own_prio >= NORMAL_PRIO:
        why = NO_PRIORITY
    elif task.prio == own_prio:
        why = SAME
    else:
        why = BEHIND_US
    return f"{named} ({_priority(task.prio)}: {why})"


def _priority(prio: int) -> str:
    if prio < 0:
        return "deadline"
    return f"real-time {99 - prio}" if prio < NORMAL_PRIO else f"nice {prio - 120}"


def _named(task: Task) -> str:
    return f"{task.name} {task.pid}"


def _with_sender(entered: Enter, processor: _Processor, time_ns: int) -> Enter:
    """An interrupt that another processor asked for, with who did."""
    if entered.key not in SENT or not processor.sender:
        return entered
    sender, processor.sender = processor.sender, ""
    return entered._replace(name=f"{entered.name} from {sender}") if time_ns - processor.sent_ns < SENT_NS else entered


def _merged(segments: Iterable[Segment]) -> Iterable[Segment]:
    """Neighbours with the same cause and name as one."""
    last: Segment | None = None
    for segment in segments:
        if last is not None and (last.cause, last.who) == (segment.cause, segment.who):
            last = last._replace(end_ns=segment.end_ns)
            continue
        if last is not None:
            yield last
        last = segment
    if last is not None:
        yield last
