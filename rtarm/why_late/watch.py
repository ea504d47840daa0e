"""Following a periodic thread: which of its cycles were late, and why each was.

Who knows the cycles of a thread is a source of them; `ArmCycles` reads those of a running arm from its flight recorder.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import NamedTuple, Protocol

import numpy as np

from rtarm.why_late.causes import Cause
from rtarm.why_late.divide import NEVER_NS, Divider, Segment, stood_still
from rtarm.why_late.events import parse, since, time_of
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
"""So long what was traced is kept before the first cycle is known."""
MOST_TEXT = 1 << 24
"""Letters of what was traced that are kept, should a cycle not end."""
BEHIND_NS = 2_000_000_000
"""So long a late cycle waits for its events to be read."""
SHORT = 0.02
"""Segments of less than this share of the interval are left out of a time line."""
MOST_LINE = 4096
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

    @property
    def last_ns(self) -> int:
        """The last that is known of it."""
        return self.end_ns or self.woke_ns


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
    """An interval that was longer than the bound allows: a cycle that woke up late (`woke`), or computed for long.

    `by_name` is all of it, in ns by cause and name; `segments` the time line, without what is too short to be drawn.
    So one takes little room, however many interrupts there were.
    """

    cycle: int
    woke: bool
    start_ns: int
    end_ns: int
    by_name: Mapping[tuple[Cause, str], int]
    segments: tuple[Segment, ...]

    @classmethod
    def of(cls, cycle: int, woke: bool, segments: Sequence[Segment]) -> Late:
        """From the segments of the whole interval."""
        total: dict[tuple[Cause, str], int] = {}
        for one in segments:
            total[one.cause, one.who] = total.get((one.cause, one.who), 0) + one.length_ns
        return cls(cycle, woke, segments[0].start_ns, segments[-1].end_ns, total, tuple(time_line(segments)))

    @property
    def length_ns(self) -> int:
        return self.end_ns - self.start_ns

    @property
    def by_cause(self) -> dict[Cause, int]:
        total: dict[Cause, int] = {}
        for (cause, _), length_ns in self.by_name.items():
            total[cause] = total.get(cause, 0) + length_ns
        return total

    @property
    def cause(self) -> Cause:
        """That with the largest part."""
        total = self.by_cause
        return max(total, key=lambda cause: total[cause])


def time_line(segments: Sequence[Segment]) -> list[Segment]:
    """The segments with the short ones left out, and neighbours of one cause together under its chief name."""
    least_ns = SHORT * (segments[-1].end_ns - segments[0].start_ns)
    found = []
    for cause, group in groupby(segments, key=lambda segment: segment.cause):
        parts = list(group)
        if parts[-1].end_ns - parts[0].start_ns >= least_ns:
            names: Counter[str] = Counter()
            for part in parts:
                names[part.who] += part.length_ns if part.who else 0
            ((who, _),) = names.most_common(1)
            found.append(Segment(parts[0].start_ns, parts[-1].end_ns, cause, who))
    return found


class _Interval(NamedTuple):
    """One of a cycle that is too long: its waking or its work; until when it fell asleep if it did so for its timer."""

    cycle: int
    woke: bool
    start_ns: int
    end_ns: int
    slept_by_ns: int


class Watcher:
    """Divides the late cycles of a source.

    Attributes:
        late: those found so far, in the order in which they were looked at.
        cycles: how many were looked at.
        undivided: late ones that were too many for a look, or for all looks.
    """

    def __init__(self, source: Source, tid: int, trace: Traced, bound_ns: int, kept_ns: int = KEPT_NS) -> None:
        self.late: list[Late] = []
        self.cycles = 0
        self.undivided = 0
        self._source, self._tid, self._trace, self._bound_ns = source, tid, trace, bound_ns
        self._kept_ns = kept_ns
        self._history_ns = HISTORY_NS + 2 * source.period_ns
        self._text: deque[tuple[int, str]] = deque()
        self._waiting: list[Cycle] = []
        self._last: Cycle | None = None
        self._usual: deque[int] = deque(maxlen=USUAL)
        self._stolen: deque[tuple[int, int, int]] = deque([_stolen_of(tid)], maxlen=200)

    @property
    def count(self) -> int:
        """Late ones so far, divided or not."""
        return len(self.late) + self.undivided

    def look(self, settle_ns: int = SETTLE_NS) -> None:
        """Take what is new; to be called every `LOOK_S` or so, since the ring is overwritten."""
        self._waiting += self._source.new()
        read_ns = self._read()
        self._stolen.append(_stolen_of(self._tid))
        now_ns = time.monotonic_ns()
        if settle_ns:  # else this is the last look
            now_ns = max(min(now_ns, read_ns + settle_ns), now_ns - BEHIND_NS)
        settled = [cycle for cycle in self._waiting if cycle.last_ns <= now_ns - settle_ns]
        del self._waiting[: len(settled)]
        self.cycles += len(settled)
        self._usual.extend(cycle.end_ns - cycle.woke_ns for cycle in settled if cycle.end_ns is not None)
        wanted = sorted(self._intervals(settled), key=lambda one: one.start_ns - one.end_ns)
        room = max(0, min(MOST_A_LOOK, MOST_KEPT - len(self.late)))
        self.undivided += len(wanted[room:])
        if wanted[:room]:
            self._divide(sorted(wanted[:room]))
        self._forget()

    def _read(self) -> int:
        """Take what was traced, and until when that is all."""
        text = self._trace()
        if not text:
            return time.monotonic_ns()
        lines = text[-MOST_LINE:].split("\n")
        read_ns = next((time_ns for line in reversed(lines) if (time_ns := time_of(line)) is not None), 0)
        self._text.append((max(read_ns, self._text[-1][0] if self._text else 0), text))
        return read_ns

    def _forget(self) -> None:
        """Let go of what no later cycle can need."""
        cycles = self._waiting or ([] if self._last is None else [self._last])
        from_ns = min((cycle.due_ns for cycle in cycles), default=time.monotonic_ns() - self._kept_ns)
        from_ns -= self._history_ns
        kept = sum(len(text) for _, text in self._text)
        while self._text and (self._text[0][0] < from_ns or kept > MOST_TEXT):
            kept -= len(self._text.popleft()[1])

    def _intervals(self, cycles: Iterable[Cycle]) -> list[_Interval]:
        """Those that are too long."""
        found = []
        usual_ns = int(median(self._usual)) if self._usual else 0
        for cycle in cycles:
            if cycle.woke_ns - cycle.due_ns > self._bound_ns:
                slept = self._last is None or self._last.last_ns <= cycle.due_ns  # else its work was not done yet
                found.append(
                    _Interval(cycle.number, True, cycle.due_ns, cycle.woke_ns, cycle.due_ns if slept else NEVER_NS)
                )
            if cycle.end_ns is not None and cycle.end_ns - cycle.woke_ns > usual_ns + self._bound_ns:
                found.append(_Interval(cycle.number, False, cycle.woke_ns, cycle.end_ns, NEVER_NS))
            self._last = cycle
        return found

    def _divide(self, wanted: Sequence[_Interval]) -> None:
        first_ns = min(one.start_ns for one in wanted) - self._history_ns
        lines = "".join(text for last_ns, text in self._text if last_ns >= first_ns).split("\n")
        divider = Divider(sorted(parse(since(lines, first_ns)), key=lambda event: event.time_ns), self._tid)
        for one in wanted:
            segments = divider.divide(
                one.start_ns,
                one.end_ns,
                runs=not one.woke,
                slept_by_ns=one.slept_by_ns,
                history_ns=self._history_ns,
            )
            segments = stood_still(segments, self._stolen_in(one.start_ns, one.end_ns))
            self.late.append(Late.of(one.cycle, one.woke, segments))

    def _stolen_in(self, start_ns: int, end_ns: int) -> int:
        """What the host took of the thread's processor around an interval; 0 where it was on several."""
        first = max((number for number, one in enumerate(self._stolen) if one[0] <= start_ns), default=None)
        last = min((number for number, one in enumerate(self._stolen) if one[0] >= end_ns), default=None)
        if first is None or last is None:
            return 0
        around = list(self._stolen)[first : last + 1]
        return around[-1][2] - around[0][2] if len({cpu for _, cpu, _ in around}) == 1 else 0


def _stolen_of(tid: int) -> tuple[int, int, int]:
    """When, the processor of a thread, and for how long the host has given it to others."""
    cpu = cpu_of(tid)
    return time.monotonic_ns(), cpu, stolen_ns(cpu)


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


def cycle_thread(memory: MemoryFile) -> int:
    """The thread that runs the cycle of a control process.

    Raises:
        OSError: the process is gone, or lives in another container.
    """
    pid, tid = int(memory.record["header"]["pid"]), int(memory.record["scheduling"]["thread_id"])
    os.stat(f"/proc/{pid}/task/{tid}")
    return tid
