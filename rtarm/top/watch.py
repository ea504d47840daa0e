"""Looking at a running arm again and again: what `status` reports, the last seconds apart, and what happened.

The control process may end and be started again meanwhile; the figures then stay as they were last, with the sentence
that says why, until a new one is there.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rtarm.console.language import said, told
from rtarm.running.status import Report, counters, percentiles_us, report_of
from rtarm.running.tracking import Window
from rtarm.top.events import BAD, GOOD, Happening, happenings
from sentences.meaning import Language
from shm import files
from shm.client import StateReader
from shm.errors import SharedMemoryError
from shm.histogram import upper_ns
from shm.layout import HISTOGRAM_BUCKETS
from shm.recording import newest_events

NS = 1_000_000_000
RECENT_S = 10
"""What counts as the last seconds."""
HAPPENINGS = 64
"""As many as the highest terminals have room for."""

BINS_A_DECADE = 4
FIRST_EDGE_NS, DECADES = 1_000, 5
_EDGES_NS = FIRST_EDGE_NS * 10 ** (np.arange(BINS_A_DECADE * DECADES + 1) / BINS_A_DECADE)
_BIN_OF_BUCKET = np.searchsorted(_EDGES_NS, [float(upper_ns(index)) for index in range(HISTOGRAM_BUCKETS)])
BINS = len(_EDGES_NS) + 1
"""Bins of a spectrum: below 1 µs, four a decade up to 100 ms, and above."""


class Timing(NamedTuple):
    """A distribution of durations: of what, since when, its percentiles (µs), and how many values lie in each bin."""

    what: str
    span: str
    figures: Report
    spectrum: tuple[int, ...]


class Because(NamedTuple):
    """A cause of late cycles: who it mostly is ("": nobody is named), its share of all late time, of how many cycles
    it is the chief one, and how long the latest of these waited (None: of none)."""

    cause: str
    who: str
    share: float
    cycles: int
    worst_us: float | None


class Why(NamedTuple):
    """Why cycles were late, the chief causes first; `hint` is why there are none."""

    causes: Sequence[Because] = ()
    hint: str = ""


@dataclass(frozen=True)
class Look:
    """Everything that is shown of an arm at one moment.

    Attributes:
        report: as of `rtarm status`; None before the control process' first cycle.
        recent: what `rtarm.running.status.counters` says of the last `recent_s` seconds.
        timings: lateness and cycle time, of the last seconds and since the control process' start.
        happenings: newest first.
        epoch_offset_ns: CLOCK_REALTIME minus CLOCK_MONOTONIC.
        trouble: why all this is not of now; None when it is.
        why: why cycles were late, in words; None where nobody asked.
        language: of all its sentences.
    """

    arm: str
    report: Report | None = None
    recent: Report | None = None
    recent_s: float = 0.0
    timings: Sequence[Timing] = ()
    happenings: Sequence[Happening] = ()
    epoch_offset_ns: int = 0
    trouble: str | None = None
    language: Language = "en"
    why: Why | None = None

    @property
    def recent_span(self) -> str:
        """The last seconds in words."""
        return span_words(self.recent_s, self.language)


class Watch:
    """Looks at one arm, through restarts of its processes; `why` says why its cycles were late.

    Raises:
        SharedMemoryError: no control process of that arm runs now, or its files are not what they should be.
    """

    def __init__(self, arm: str, language: Language = "en", why: Callable[[], Why] | None = None) -> None:
        self._language = language
        self._why = why
        self._last = Look(arm, language=language)
        self._past: deque[Happening] = deque(maxlen=HAPPENINGS)
        self._windows: deque[tuple[float, Window]] = deque()
        self._front: int | None = None
        self._pid = 0
        self._reader: StateReader | None = None
        self._attach()

    def close(self) -> None:
        """Let go of the state file."""
        self._windows.clear()
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def look(self) -> Look:
        """What there is to be seen now; never waits and never raises for what happens to the arm."""
        try:
            if self._reader is None:
                self._attach()
            self._last = self._look()
        except SharedMemoryError as problem:
            self._last = replace(self._last, trouble=told(problem, self._language))
        return self._last

    def _attach(self) -> None:
        self._reader = StateReader(files.open_state(self._last.arm))
        pid = int(self._reader.memory.record["header"]["pid"])
        if self._pid:
            self._say(said(self._language, "Another control process runs (pid {pid}).", pid=pid), GOOD)
        self._pid = pid

    def _look(self) -> Look:
        reader = self._reader
        assert reader is not None
        if files.is_held(reader.memory.fd):
            return self._read(reader)
        look = self._last
        with contextlib.suppress(SharedMemoryError):  # it may have died in mid-write
            look = self._read(reader)  # its last words
        self._past.extend(self._happenings(reader))
        self._say(said(self._language, "The control process (pid {pid}) has ended.", pid=self._pid), BAD)
        self.close()
        return replace(look, happenings=self._newest_first(()), trouble=self._absence())

    def _absence(self) -> str | None:
        """Why there is no control process; None if there is one again, which the next look will show."""
        try:
            files.open_state(self._last.arm).close()
        except SharedMemoryError as problem:
            return told(problem, self._language)
        return None

    def _read(self, reader: StateReader) -> Look:
        if int(reader.memory.record["snapshot_sequence"][0]) == 0:
            waiting = said(self._language, "The control process (pid {pid}) has not run a cycle yet.", pid=self._pid)
            return replace(self._last, happenings=self._newest_first(()), trouble=waiting)
        report = report_of(self._last.arm, reader, self._language)
        self._follow_front(report["front"]["pid"])
        window = self._window(reader)
        since, buses, elapsed_ns = window.counters()
        record = reader.memory.record
        seconds = elapsed_ns / NS
        timings = [
            Timing(what, span, percentiles_us(histogram), spectrum(histogram["buckets"]))
            for what, name in (("lateness", "lateness"), ("cycle", "cycle_time"))
            for span, histogram in (
                (span_words(seconds, self._language), window.histogram(name)),
                (said(self._language, "all along"), record[name]),
            )
        ]
        return Look(
            arm=self._last.arm,
            report=report,
            recent=counters(since, buses, elapsed_ns),
            recent_s=seconds,
            timings=timings,
            happenings=self._newest_first(self._happenings(reader)),
            epoch_offset_ns=time.time_ns() - time.monotonic_ns(),
            language=self._language,
            why=None if self._why is None else self._why(),
        )

    def _window(self, reader: StateReader) -> Window:
        """The one that began `RECENT_S` ago, or the oldest there is; a new one begins at every look."""
        now_s = time.monotonic()
        self._windows.append((now_s, Window(reader)))
        while len(self._windows) > 1 and now_s - self._windows[1][0] >= RECENT_S:
            self._windows.popleft()
        return self._windows[0][1]

    def _follow_front(self, pid: int | None) -> None:
        if pid is not None and pid != self._front:
            self._say(said(self._language, "A ROS process serves the arm (pid {pid}).", pid=pid))
        elif pid is None and self._front is not None:
            gone = said(self._language, "The ROS process (pid {pid}) no longer serves the arm.", pid=self._front)
            self._say(gone, BAD)
        self._front = pid

    def _say(self, sentence: str, style: str = "") -> None:
        self._past.append(Happening(time.monotonic_ns(), sentence, style))

    def _happenings(self, reader: StateReader) -> list[Happening]:
        record = reader.memory.record
        joints, buses = files.joint_names(record["header"]), files.bus_names(record["header"])
        return [one for one, _ in happenings(newest_events(record, HAPPENINGS), joints, self._language, buses)]

    def _newest_first(self, of_now: Sequence[Happening]) -> list[Happening]:
        found = sorted((*self._past, *of_now), key=lambda one: one.monotonic_ns)
        return found[: -HAPPENINGS - 1 : -1]


def span_words(seconds: float, language: Language) -> str:
    """The last seconds in words."""
    return said(language, "last {seconds} s", seconds=max(1, round(seconds)))


def spectrum_of(values_ns: np.ndarray) -> tuple[int, ...]:
    """How many of some durations lie in each of the `BINS` bins."""
    return tuple(np.bincount(np.searchsorted(_EDGES_NS, values_ns), minlength=BINS).tolist())


def spectrum(buckets: np.ndarray) -> tuple[int, ...]:
    """How many values of a histogram lie in each of the `BINS` bins (a bucket by its upper edge)."""
    return tuple(np.bincount(_BIN_OF_BUCKET, weights=buckets, minlength=BINS).astype(int).tolist())
