"""Wake-up lateness as everybody's is kept here: the histogram of shared memory, which merges without loss.

A value is counted once a wake-up, against the deadline that was planned for it, on CLOCK_MONOTONIC.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from shm import histogram
from shm.layout import Histogram

PERCENTS = {"p50": 50.0, "p90": 90.0, "p99": 99.0, "p99_9": 99.9}
_CYCLICTEST_LINE = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_CYCLICTEST_MAX = re.compile(r"^# Max Latencies:\s*(\d+)", re.MULTILINE)
_CYCLICTEST_OVERFLOWS = re.compile(r"^# Histogram Overflows:\s*(\d+)", re.MULTILINE)


def recorded(values_ns: Iterable[int], counts: Iterable[int] | None = None) -> np.void:
    """The histogram of these values, each counted once or as often as `counts` says; below 0 is 0.

    The largest value is kept exactly, the others to 3.1 %.
    """
    values = np.maximum(np.asarray(list(values_ns), np.int64), 0)
    times = np.ones(len(values), np.int64) if counts is None else np.asarray(list(counts), np.int64)
    values, times = values[times > 0], times[times > 0]
    found = empty()
    if len(values):
        np.add.at(found["buckets"], [histogram.bucket(int(value)) for value in values], times)
        found["max_ns"], found["count"], found["sum_ns"] = values.max(), times.sum(), values @ times
    return found


def empty() -> np.void:
    """The histogram of nothing."""
    found: np.void = np.zeros(1, Histogram.dtype)[0]
    return found


def merged(parts: Iterable[np.void]) -> np.void:
    """One histogram of what several hold; the order does not matter."""
    total = empty()
    for part in parts:
        total["buckets"] += part["buckets"]
        total["count"] += part["count"]
        total["sum_ns"] += part["sum_ns"]
        total["max_ns"] = max(total["max_ns"], part["max_ns"])
    return total


def figures_us(record: np.void) -> dict[str, float | int]:
    """Percentiles, maximum (µs) and count; a percentile is its bucket's upper edge, so at most 3.1 % too high."""
    values = histogram.percentiles_ns(record, list(PERCENTS.values()))
    found: dict[str, float | int] = {name: value * 1e-3 for name, value in zip(PERCENTS, values, strict=True)}
    return {**found, "max": int(record["max_ns"]) * 1e-3, "count": int(record["count"])}


def from_cyclictest(text: str) -> np.void:
    """The histogram that `cyclictest --histogram` prints for one thread.

    It cuts its values to whole µs, so the middle of each is taken; what is beyond its last line counts as its
    maximum.

    Raises:
        ValueError: this is not such a report.
    """
    most = _CYCLICTEST_MAX.search(text)
    lines = _CYCLICTEST_LINE.findall(text)
    if most is None or not lines:
        raise ValueError(f"cyclictest printed no histogram but {text[:200]!r}")
    overflows = _CYCLICTEST_OVERFLOWS.search(text)
    middles_ns = [int(value) * 1000 + 500 for value, _ in lines]
    counts = [int(count) for _, count in lines]
    return recorded([*middles_ns, int(most[1]) * 1000 + 500], [*counts, int(overflows[1]) if overflows else 0])


def as_pairs(record: np.void) -> list[list[int]]:
    """What JSON keeps of a histogram: upper edge of every used bucket (ns; the last: the maximum) and its count."""
    used = np.flatnonzero(record["buckets"])
    edges = [min(histogram.upper_ns(int(index)), int(record["max_ns"])) for index in used]
    return [[edge, int(count)] for edge, count in zip(edges, record["buckets"][used], strict=True)]


def from_pairs(pairs: Sequence[Sequence[int]]) -> np.void:
    """The histogram of which `as_pairs` was kept."""
    return recorded([edge for edge, _ in pairs], [count for _, count in pairs])


def survival(record: np.void) -> tuple[np.ndarray, np.ndarray]:
    """Lateness (µs) and the share of wake-ups that were at least about as late, falling from 1 to 1 in `count`."""
    pairs = np.asarray(as_pairs(record), np.float64).reshape(-1, 2)
    counts = pairs[:, 1]
    return pairs[:, 0] * 1e-3, counts[::-1].cumsum()[::-1] / max(counts.sum(), 1.0)


def spread(values: Sequence[float]) -> Mapping[str, float | int | None]:
    """Median, lowest and highest of repeats, and how many there are; None for each of nothing."""
    if not values:
        return {"median": None, "lowest": None, "highest": None, "repeats": 0}
    return {
        "median": float(np.median(values)),
        "lowest": float(min(values)),
        "highest": float(max(values)),
        "repeats": len(values),
    }
