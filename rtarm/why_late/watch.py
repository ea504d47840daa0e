"""Following a periodic thread: which of its cycles were late, and why each was.

Who knows the cycles of a thread is a source of them; `ArmCycles` reads those of a running arm from its flight recorder.
"""

from __future__ import annotations

import contextlib
import os
import time
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import NamedTuple, Protocol

import numpy as np

from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import Segment, divide, stood_still
from rtarm.why_late.events import parse, since
from shm.files import MemoryFile
from shm.recording import now_at, read_on

LOOK_S = 0.05
SETTLE_NS = 15_000_000
"""What ended just now is looked at the next time: the host's count of stolen time comes with the next tick."""
HISTORY_NS = 25_000_000
"""How a late cycle's time is spent depends on what began before; so much longer than a period is looked back."""
MOST_A_LOOK = 50
"""Late cycles that are divided at a look, the latest ones; the others are counted."""
MOST_KEPT = 100_000
KEPT_NS = 1_000_000_000
"""So long what was traced is kept."""
TELLING_S = 0.3
USUAL = 1000
"""Cycles of which the usual time is taken."""
_TICK_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")


Traced = Callable[[], str]
"""What was traced since the last time."""


class Cycle(NamedTuple):
    """When it was due, when it woke up, and when its work ended (None: not known)."""

    number: int
    due_ns: int
    woke_ns: int
    end_ns: int | None


class Source(Protocol):
    """Who knows the cycles of a thread."""

    period_ns: int

    def new(self) -> list[Cycle]:
        """Those that have ended since the last time, in their order."""


class ArmCycles:
    """The cycles of a running arm, from now on."""

    def __init__(self, memory: MemoryFile) -> None:
        self.period_ns = int(memory.record["header"]["period_ns"])
        self._memory = memory
        self._at = now_at(memory)
        self._last: Cycle | None = None

    def new(self) -> list[Cycle]:
        recording, self._at = read_on(self._memory, self._at)
        return self.taken(recording.records)

    def taken(self, records: np.ndarray) -> list[Cycle]:
        """A cycle's record has the computing time of the one before, so the newest waits for the next."""
        found = []
        for record in records:
            number, lateness_ns, before_ns = (int(record[n]) for n in ("number", "lateness_ns", "cycle_time_ns"))
            # a cycle that is late by periods moves to the last of them
            due_ns = int(record["monotonic_ns"]) - lateness_ns // self.period_ns * self.period_ns
            last, self._last = self._last, Cycle(number, due_ns, due_ns + lateness_ns, None)
            if last is not None:
                follows = last.number + 1 == number
                found.append(last._replace(end_ns=last.woke_ns + before_ns if follows else None))
        return found


@dataclass(frozen=True)
class Late:
    """An interval that was longer than the bound allows: a cycle that woke up late (`woke`), or computed for long."""

    cycle: int
    woke: bool
    segments: tuple[Segment, ...]
    by_cause: dict[Cause, int] = field(init=False)

    def __post_init__(self) -> None:
        total: dict[Cause, int] = {}
        for segment in self.segments:
            total[segment.cause] = total.get(segment.cause, 0) + segment.length_ns
        object.__setattr__(self, "by_cause", total)

    @property
    def length_ns(self) -> int:
        return self.segments[-1].end_ns - self.segments[0].start_ns

    @property
    def cause(self) -> Cause:
        """That with the largest part."""
        return max(self.by_cause, key=lambda cause: self.by_cause[cause])


class Watcher:
    """Divides the late cycles of a source.

    Attributes:
        late: those found so far, in the order in which they were looked at.
        cycles: how many were looked at.
        undivided: late ones that were too many for a look.
    """

    def __init__(self, source: Source, tid: int, trace: Traced, bound_ns: int) -> None:
        self.late: list[Late] = []
        self.cycles = 0
        self.undivided = 0
        self._source, self._tid, self._trace, self._bound_ns = source, tid, trace, bound_ns
        self._history_ns = HISTORY_NS + 2 * source.period_ns
        self._text: deque[tuple[int, str]] = deque()
        self._waiting: list[Cycle] = []
        self._usual: deque[int] = deque(maxlen=USUAL)
        self._stolen: deque[tuple[int, int]] = deque([(time.monotonic_ns(), stolen_ns(cpu_of(tid)))], maxlen=200)

    @property
    def count(self) -> int:
        """Late ones so far, divided or not."""
        return len(self.late) + self.undivided

    def look(self, settle_ns: int = SETTLE_NS) -> None:
        """Take what is new; to be called every `LOOK_S` or so, since the ring is overwritten."""
        self._waiting += self._source.new()
        text = self._trace()
        now_ns = time.monotonic_ns()
        self._text.append((now_ns, text))
        while self._text[0][0] < now_ns - KEPT_NS:
            self._text.popleft()
        self._stolen.append((now_ns, stolen_ns(cpu_of(self._tid))))
        settled = [cycle for cycle in self._waiting if (cycle.end_ns or cycle.woke_ns) <= now_ns - settle_ns]
        del self._waiting[: len(settled)]
        self.cycles += len(settled)
        self._usual.extend(cycle.end_ns - cycle.woke_ns for cycle in settled if cycle.end_ns is not None)
        wanted = sorted(self._intervals(settled), key=lambda one: one[2] - one[3])
        room = max(0, min(MOST_A_LOOK, MOST_KEPT - len(self.late)))
        self.undivided += len(wanted[room:])
        if wanted[:room]:
            self._divide(sorted(wanted[:room]))

    def _intervals(self, cycles: Iterable[Cycle]) -> list[tuple[int, bool, int, int]]:
        """Number, whether it is the waking, start and end of those that are too long."""
        found = []
        usual_ns = int(median(self._usual)) if self._usual else 0
        for cycle in cycles:
            if cycle.woke_ns - cycle.due_ns > self._bound_ns:
                found.append((cycle.number, True, cycle.due_ns, cycle.woke_ns))
            if cycle.end_ns is not None and cycle.end_ns - cycle.woke_ns > usual_ns + self._bound_ns:
                found.append((cycle.number, False, cycle.woke_ns, cycle.end_ns))
        return found

    def _divide(self, wanted: Sequence[tuple[int, bool, int, int]]) -> None:
        first_ns = min(start_ns for *_, start_ns, _ in wanted) - self._history_ns
        lines = "".join(text for read_ns, text in self._text if read_ns >= first_ns).splitlines()
        events = sorted(parse(since(lines, first_ns)), key=lambda event: event.time_ns)
        times = [event.time_ns for event in events]
        for number, woke, start_ns, end_ns in wanted:
            # behind the end too: who woke the thread tells what it had slept for
            around = slice(
                bisect_left(times, start_ns - self._history_ns), bisect_right(times, end_ns + self._history_ns)
            )
            segments = divide(events[around], self._tid, start_ns, end_ns, runs=not woke)
            self.late.append(Late(number, woke, tuple(stood_still(segments, self._stolen_in(start_ns, end_ns)))))

    def _stolen_in(self, start_ns: int, end_ns: int) -> int:
        before = [stolen for at_ns, stolen in self._stolen if at_ns <= start_ns]
        after = [stolen for at_ns, stolen in self._stolen if at_ns >= end_ns]
        return after[0] - before[-1] if before and after else 0


def cpu_of(tid: int) -> int:
    """The processor that a thread ran on last, -1 when it is gone."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{tid}/stat").read_text().rpartition(")")[2].split()[36])
    return -1


def stolen_ns(cpu: int) -> int:
    """For how long the host has given a processor to others since the start, as far as it says so."""
    for line in Path("/proc/stat").read_text().splitlines():
        name, *ticks = line.split()
        if name == f"cpu{cpu}":
            return int(ticks[7]) * _TICK_NS
    return 0


def cycle_thread(pid: int) -> int:
    """The thread of a control process that runs its cycle.

    It has the highest priority; where none has any, it sleeps most often.

    Raises:
        OSError: the process is gone.
    """
    priorities = {}
    for name in os.listdir(f"/proc/{pid}/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            priorities[int(name)] = os.sched_getparam(int(name)).sched_priority
    highest = max(priorities.values(), default=0)
    if highest > 0:
        return max(priorities, key=lambda tid: priorities[tid])
    before = {tid: _sleeps(pid, tid) for tid in priorities}
    time.sleep(TELLING_S)
    return max(before, key=lambda tid: _sleeps(pid, tid) - before[tid], default=pid)


def _sleeps(pid: int, tid: int) -> int:
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        status = Path(f"/proc/{pid}/task/{tid}/status").read_text()
        return int(status.partition("\nvoluntary_ctxt_switches:")[2].split(maxsplit=1)[0])
    return 0
