"""How well the arm follows, read from the state file cycle by cycle beside a running goal."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from rtarm.running.status import CountedBus, counted_buses
from shm import histogram
from shm.client import StateReader
from shm.errors import TornRead
from shm.layout import BusCounters, Counters, Histogram
from shm.snapshot import Snapshot

AFTER_CYCLE_S = 0.0015
"""The snapshot is complete by then; what is read later in the cycle is the same."""


class Tracker:
    """A thread that takes every cycle's snapshot and compares command and measurement of the same instant.

    Attributes:
        latest: the newest snapshot, for showing it.
        missed: cycles of running goals that it came too late for.
    """

    def __init__(self, reader: StateReader) -> None:
        self.latest = reader.snapshot()
        self.missed = 0
        self._reader = reader
        count = reader.joint_count
        self._period_s = int(reader.memory.record["header"]["period_ns"]) * 1e-9
        self._squares = np.zeros(count)
        self._readings = np.zeros(count, np.int64)
        self._largest = np.zeros(count)
        self._measured_ns = np.zeros(count, np.int64)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._live, name="tracker", daemon=True)

    def start(self) -> None:
        """Begin to follow."""
        self._thread.start()

    def stop(self) -> None:
        """End; the figures stay."""
        self._ended.set()
        self._thread.join()

    def take(self, snapshot: Snapshot) -> None:
        """Account for one snapshot."""
        skipped = snapshot["cycle"] - self.latest["cycle"] - 1
        running = snapshot["goal_id"] != 0
        self.latest = snapshot
        if not running:
            return
        self.missed += max(0, skipped)
        joints = snapshot["joints"][: len(self._squares)]
        fresh = joints["measured_ns"] != self._measured_ns
        error = np.abs(errors_rad(snapshot, len(joints)))
        self._squares[fresh] += error[fresh] ** 2
        self._largest[fresh] = np.maximum(self._largest[fresh], error[fresh])
        self._readings[fresh] += 1
        self._measured_ns = joints["measured_ns"].copy()

    def figures(self) -> dict[str, list[float]]:
        """Root mean square and largest error while goals ran, and the present one; radians, one a joint."""
        rms = np.sqrt(self._squares / np.maximum(self._readings, 1))
        final = np.abs(errors_rad(self.latest, len(rms)))
        return {"rms": rms.tolist(), "max": self._largest.tolist(), "final": final.tolist()}

    def _live(self) -> None:
        """Wake shortly after each cycle, whose planned time the snapshot tells."""
        while not self._ended.is_set():
            next_s = self.latest["monotonic_ns"] * 1e-9 + self._period_s + AFTER_CYCLE_S
            # A late cycle is looked for again soon; a dead control process costs a look now and then.
            self._ended.wait(max(0.0005, next_s - time.monotonic()))
            try:
                snapshot = self._reader.snapshot()
            except TornRead:
                continue
            if snapshot["cycle"] != self.latest["cycle"]:
                self.take(snapshot)


def errors_rad(snapshot: Snapshot, count: int) -> np.ndarray:
    """Measured minus commanded, both at the instant of each joint's measurement."""
    joints = snapshot["joints"][:count]
    errors: np.ndarray = joints["measured_position_rad"] - joints["reference_position_rad"]
    return errors


class Window:
    """Counters and histograms between two moments, from the state file's running totals."""

    def __init__(self, reader: StateReader) -> None:
        self._record = reader.memory.record
        self._began_ns = time.monotonic_ns()
        self._counters, self._buses = self._record["counters"].copy(), self._record["buses"].copy()
        self._buckets = {name: self._record[name]["buckets"].copy() for name in ("lateness", "cycle_time")}

    def counters(self) -> tuple[np.void, list[CountedBus], int]:
        """What happened since the beginning, the same of each bus, and the nanoseconds since."""
        buses = [
            bus._replace(counted=_risen(bus.counted, before, BusCounters.words))
            for bus, before in zip(counted_buses(self._record), self._buses, strict=False)
        ]
        since = _risen(self._record["counters"], self._counters, Counters.words)
        return since, buses, time.monotonic_ns() - self._began_ns

    def histogram(self, name: str) -> np.void:
        """`lateness` or `cycle_time` since the beginning, as a histogram of its own."""
        now = self._record[name]
        since: np.void = np.zeros(1, Histogram.dtype)[0]
        buckets = now["buckets"].copy() - self._buckets[name]
        since["buckets"] = buckets
        since["count"] = buckets.sum()
        used = np.flatnonzero(buckets)
        if len(used):
            # The exact maximum is known only of all time; of this stretch, the bucket it lies in.
            since["max_ns"] = min(int(now["max_ns"]), histogram.upper_ns(int(used[-1])))
        return since


def _risen(now: np.void, before: np.void, names: Iterable[str]) -> np.void:
    """Counters less what they were; the state of a bus is as it is now."""
    risen = now.copy()
    for name in names:
        if name != "bus_state":
            risen[name] -= before[name]
    return risen


def plain(figures: dict[str, Any]) -> dict[str, Any]:
    """Numbers that JSON takes: NaN (a joint that was never read) becomes None."""
    return {name: [value if np.isfinite(value) else None for value in values] for name, values in figures.items()}
