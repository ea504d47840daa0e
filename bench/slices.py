"""What a thing beside a control process costs it: slices without and with it, in turn.

A noisy neighbour hits both. A slice with it is compared with the slices without before and after it (their geometric
mean); what the machine does by itself is how much neighbouring slices without it differ.
"""

from __future__ import annotations

import asyncio
import math
import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from live import LiveStack

from rtarm.bench.load import loaded
from rtarm.running.status import percentiles_us
from rtarm.running.tracking import Window

SLICE_S = 5.0
SETTLE_S = 0.5
FIGURES = ("p50", "p99", "p99_9", "max")
COMPARED = tuple(f"{what} {name}" for what in ("lateness", "cycle_time") for name in FIGURES)

T = TypeVar("T")
Slice = dict[str, float]
Before = tuple[int, Slice]
"""A slice with it, led by the number of the slice without it that came before."""


def slice_of(stack: LiveStack, during: Callable[[], object] = lambda: time.sleep(SLICE_S)) -> Slice:
    """Percentiles of the cycles meanwhile, in µs, their overruns and number."""
    time.sleep(SETTLE_S)
    window = Window(stack.reader)
    during()
    counted = window.counters()[0]
    found = {"overruns": float(counted["overruns"]), "cycles": float(counted["cycles"])}
    for what in ("lateness", "cycle_time"):
        figures = percentiles_us(window.histogram(what))
        found |= {f"{what} {name}": figures[name] for name in FIGURES}
    return found


def under_load(folder: Path, work: Callable[[], T], *, wanted: bool) -> T:
    """What some work gives beside the load of `rtarm bench`, if that is wanted; its files go to the folder."""

    async def done() -> T:
        async with loaded(folder, wanted=wanted):
            return await asyncio.to_thread(work)

    return asyncio.run(done())


def without_priority(stack: LiveStack) -> None:
    """Take the real-time priority from the cycle, as on a machine that gives none."""
    for task in os.listdir(f"/proc/{stack.loop.process.pid}/task"):
        os.sched_setscheduler(int(task), os.SCHED_OTHER, os.sched_param(0))


def spread(ratios: Sequence[float]) -> str:
    return f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


def compare(
    report: Callable[[str, str], None], alone: Sequence[Slice], watched: Sequence[Before]
) -> Mapping[str, Mapping[str, Any]]:
    """Report each figure with and without it; all of them, for the benchmark's file."""
    compared = {}
    for key in COMPARED:
        neighbours = [math.sqrt(alone[number][key] * alone[number + 1][key]) for number, _ in watched]
        with_it = [found[key] for _, found in watched]
        without = [found[key] for found in alone]
        cost = [b / a for a, b in zip(neighbours, with_it, strict=True) if a > 0]
        noise = [c / a for a, c in pairwise(without) if a > 0]
        compared[key] = {"with_us": with_it, "without_us": without, "ratio": cost, "noise": noise}
        report(
            f"  {key.replace('_9', '.9').replace('_', ' ')}",
            f"{spread(cost)}; without / without {spread(noise)}; "
            f"{statistics.median(with_it):.1f} and {statistics.median(without):.1f} µs",
        )
    overruns = [sum(found["overruns"] for found in slices) for slices in ([found for _, found in watched], alone)]
    cycles = [sum(found["cycles"] for found in slices) for slices in ([found for _, found in watched], alone)]
    report("  overruns with, without", f"{overruns[0]:.0f} of {cycles[0]:.0f}, {overruns[1]:.0f} of {cycles[1]:.0f}")
    return compared
