"""The late wake-ups of the whole cycle beside cyclictest's: how much later, how sure is that, and why.

RTARM_TAIL_ROUNDS says how many rounds there are at each rate (30); in each both have a slice of SLICE_S, idle and then
under load, and who is first changes from round to round. rtarm is the control process with a goal running and the
front that publishes at 100 Hz. Both have the same priority, interval, processor and locked memory.

The ratio is that of percentiles of all slices together; its interval holds 95 % of the ratios of rounds drawn anew from
these (bootstrap). Where the kernel's trace can be read it is read beside both alike, and what is later than BOUND_US is
divided into causes as `rtarm why-late` does.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import cyclictest
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import commanded_rad, goal_to, live
from planted_trials import impossible
from slices import under_load

from rtarm.bench.lateness import as_pairs, figures_us, merged, recorded
from rtarm.running.tracking import Window
from rtarm.why_late.report import causes_of
from rtarm.why_late.run import beside, watching
from rtarm.why_late.watch import LOOK_S, MOST_A_LOOK, Cycle, Late
from shm.histogram import percentiles_ns

ROUNDS = int(os.environ.get("RTARM_TAIL_ROUNDS", "30"))
SLICE_S = 2
LOOKS_PATIENCE_S = 10
BOUND_US = 100
PRIORITY = 80
CPU = max(os.sched_getaffinity(0))
PERCENTS = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
DRAWN = 2000
WIDTH = 0.035
"""Of a bucket of the histograms, by which a slice's latest wake-up is known; cyclictest tells whole µs."""
LOADS = ("idle", "loaded")
TRACED = not impossible()

pytestmark = pytest.mark.skipif(not cyclictest.installed(), reason=cyclictest.ABSENT)


class Slice(NamedTuple):
    """Wake-ups of one of the two for SLICE_S, and the late ones as far as they were traced."""

    lateness: np.void
    late: tuple[Late, ...]


class Overslept:
    """The late wake-ups of a cyclictest, told when it has ended: a few at each look, so that all are divided."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.told: list[Cycle] = []

    def new(self) -> list[Cycle]:
        found = self.told[:MOST_A_LOOK]
        del self.told[:MOST_A_LOOK]
        return found


def of_cyclictest(period_ns: int) -> Slice:
    """A slice of cyclictest."""
    source = Overslept(period_ns)
    running = cyclictest.Cyclictest(
        priority=PRIORITY, period_us=period_ns // 1000, seconds=SLICE_S, cpu=CPU, spike_us=BOUND_US
    )
    try:
        tid = thread_of(running)
        kept_ns = (SLICE_S + 2) * 1_000_000_000
        with watching(source, tid, BOUND_US * 1000, kept_ns) if TRACED else nullcontext() as watcher:
            running.end()
            spikes = enumerate(running.spikes_ns.tolist())
            source.told = [Cycle(number, due_ns, woke_ns, None) for number, (due_ns, woke_ns) in spikes]
            looked_s = time.monotonic() + LOOK_S * len(source.told) / MOST_A_LOOK + LOOKS_PATIENCE_S
            while TRACED and source.told and time.monotonic() < looked_s:  # a look that failed is raised behind
                time.sleep(LOOK_S)
    finally:
        running.close()
    microseconds, counts = running.late_us.T
    late = () if watcher is None else tuple(watcher.late)
    return Slice(recorded((microseconds * 1000 + 500).tolist(), counts.tolist()), late)


def thread_of(running: cyclictest.Cyclictest) -> int:
    """The thread of cyclictest that sleeps, the only one of its process beside the first."""
    while True:
        threads = [int(name) for name in os.listdir(f"/proc/{running.pid}/task") if int(name) != running.pid]
        if threads and os.sched_getparam(threads[0]).sched_priority == PRIORITY:
            return threads[0]
        time.sleep(0.001)


def of_rtarm(stack) -> Slice:
    """A slice of the cycle, while a goal runs; like cyclictest's, it contains the set-up of the trace."""
    window = Window(stack.reader)
    ends_s = time.monotonic() + SLICE_S
    with beside(stack.reader.memory, BOUND_US * 1000) if TRACED else nullcontext() as watcher:
        time.sleep(max(ends_s - time.monotonic(), 0.0))
        lateness = window.histogram("lateness")
    return Slice(lateness, () if watcher is None else tuple(late for late in watcher.late if late.woke))


def slices_of(folder: Path, measured: Callable[[], Slice]) -> dict[str, Slice]:
    """One without and one under load."""
    return {kind: under_load(folder, measured, wanted=kind == "loaded") for kind in LOADS}


def round_of_rtarm(folder: Path, rate_hz: float) -> dict[str, Slice]:
    settings = {"realtime": {"priority": PRIORITY, "cpu": CPU}, "front": {"joint_states_hz": 100}}
    with live(folder, mock_hz=rate_hz, settings=settings) as stack:
        stack.client.send(goal_to(commanded_rad(stack) + 0.3, 4.0 * SLICE_S))
        time.sleep(1.0)
        return slices_of(folder, lambda: of_rtarm(stack))


def round_of_cyclictest(folder: Path, rate_hz: float) -> dict[str, Slice]:
    return slices_of(folder, lambda: of_cyclictest(round(1e9 / rate_hz)))


def ratio_of(ours: list[Slice], theirs: list[Slice], percent: float) -> tuple[float, float, float]:
    """Ratio of a percentile of all slices together, and the ends of its 95 % interval."""
    rounds = np.random.default_rng(1).integers(len(ours), size=(DRAWN, len(ours)))

    def percentile(slices: list[Slice], drawn) -> float:
        return percentiles_ns(merged(slices[number].lateness for number in drawn), [percent])[0]

    every = range(len(ours))
    drawn = [percentile(ours, one) / percentile(theirs, one) for one in rounds]
    lowest, highest = np.percentile(drawn, (2.5, 97.5))
    return percentile(ours, every) / percentile(theirs, every), float(lowest), float(highest)


def worst_of(slices: list[Slice]) -> str:
    """The latest wake-up of all, and what it was mostly, if it was traced."""
    worst = max(slices, key=lambda one: int(one.lateness["max_ns"]))
    largest_ns = int(worst.lateness["max_ns"])
    told = f"{largest_ns / 1000:.0f} µs"
    latest = max(worst.late, key=lambda late: late.length_ns, default=None)
    if latest is None or abs(latest.length_ns - largest_ns) > WIDTH * largest_ns:  # not traced, or at the slice's edge
        return told
    segment = max((one for one in latest.segments if one.cause is latest.cause), key=lambda one: one.length_ns)
    return f"{told}: {latest.cause.value}{f' ({segment.who})' if segment.who else ''}"


def beyond(lateness: np.void) -> int:
    """How many wake-ups were later than BOUND_US, by the histogram, whose buckets are 3 % wide."""
    return sum(count for edge_ns, count in as_pairs(lateness) if edge_ns > BOUND_US * 1000)


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(0)
@pytest.mark.parametrize("rate_hz", [200.0, 500.0, 1000.0])
def test_tail(benchmark, report, tmp_path, rate_hz):
    rounds: dict[str, Callable[[Path, float], dict[str, Slice]]] = {
        "rtarm": round_of_rtarm,
        "cyclictest": round_of_cyclictest,
    }
    slices: dict[str, dict[str, list[Slice]]] = {who: {kind: [] for kind in LOADS} for who in rounds}

    def measure() -> None:
        for number in range(ROUNDS):
            for who in sorted(rounds, reverse=bool(number % 2)):
                folder = tmp_path / f"{who}{number}"
                folder.mkdir()
                for kind, found in rounds[who](folder, rate_hz).items():
                    slices[who][kind].append(found)

    benchmark.pedantic(measure, rounds=1)
    traced = "traced" if TRACED else "not traced"
    for kind in LOADS:
        report(f"{rate_hz:g} Hz, {kind}, {ROUNDS} slices of {SLICE_S} s each, {traced}", "µs p50, p99, p99.9; latest")
        kept = benchmark.extra_info[kind] = {}
        for who, of in slices.items():
            lateness = merged(one.lateness for one in of[kind])
            figures = figures_us(lateness)
            late = [one for slice_ in of[kind] for one in slice_.late]
            causes = causes_of(late) if late else []
            values = ", ".join(f"{figures[name.replace('.', '_')]:.1f}" for name in PERCENTS)
            report(f"  {who}, {figures['count']} wake-ups", f"{values}; {worst_of(of[kind])}")
            of_all = ", ".join(
                f"{one['cause']} {one['cycles']} ({one['share']:.0%})" for one in causes if one["cycles"]
            )
            report(f"  {who}: {beyond(lateness)} later than {BOUND_US} µs, {len(late)} traced", of_all)
            kept[who] = {
                "us": figures,
                "slices_us": [figures_us(one.lateness) for one in of[kind]],
                "late": beyond(lateness),
                "traced": len(late),
                "causes": causes,
            }
        kept["ratio"] = {}
        for name, percent in PERCENTS.items():
            ratio = kept["ratio"][name] = ratio_of(slices["rtarm"][kind], slices["cyclictest"][kind], percent)
            aim = ", aim ≤ 1.1" if name == "p99.9" else ""
            report(f"  rtarm / cyclictest, {name}{aim}", "{:.2f} (95 %: {:.2f} to {:.2f})".format(*ratio))
