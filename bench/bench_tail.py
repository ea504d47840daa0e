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
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

import cyclictest
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import commanded_rad, goal_to, live

from rtarm.bench.lateness import figures_us, merged, recorded
from rtarm.bench.load import SETTLE_S, command
from rtarm.running.tracking import Window
from rtarm.why_late.report import causes_of
from rtarm.why_late.run import beside, watching
from rtarm.why_late.tracefs import NotTraced, place
from rtarm.why_late.watch import Cycle, Late
from shm.histogram import percentiles_ns

ROUNDS = int(os.environ.get("RTARM_TAIL_ROUNDS", "30"))
SLICE_S = 2
BOUND_US = 100
PRIORITY = 80
CPU = max(os.sched_getaffinity(0))
PERCENTS = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
DRAWN = 2000
LOADS = ("idle", "loaded")

pytestmark = pytest.mark.skipif(not cyclictest.installed(), reason=cyclictest.ABSENT)


class Slice(NamedTuple):
    """Wake-ups of one of the two for SLICE_S, and the late ones as far as they were traced."""

    lateness: np.void
    late: tuple[Late, ...]


class Overslept:
    """The late wake-ups of a cyclictest, which tells them when it has ended."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.told: list[Cycle] = []

    def new(self) -> list[Cycle]:
        found, self.told = self.told, []
        return found


def may_trace() -> bool:
    try:
        place()
    except NotTraced:
        return False
    return True


TRACED = may_trace()


@contextmanager
def load(kind: str, folder: Path) -> Iterator[None]:
    """What keeps the machine busy, if it is to be loaded."""
    with ExitStack() as stack:
        if kind == "loaded":
            busy = stack.enter_context(subprocess.Popen(command(folder)))
            stack.callback(busy.terminate)
            time.sleep(SETTLE_S)
        yield


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
    """A slice of the cycle, while a goal runs."""
    memory = stack.reader.memory
    with beside(memory, BOUND_US * 1000) if TRACED else nullcontext() as watcher:
        window = Window(stack.reader)
        time.sleep(SLICE_S)
        lateness = window.histogram("lateness")
    return Slice(lateness, () if watcher is None else tuple(late for late in watcher.late if late.woke))


def round_of_rtarm(folder: Path, rate_hz: float) -> dict[str, Slice]:
    settings = {"realtime": {"priority": PRIORITY, "cpu": CPU}, "front": {"joint_states_hz": 100}}
    with live(folder, mock_hz=rate_hz, settings=settings) as stack:
        stack.client.send(goal_to(commanded_rad(stack) + 0.3, 4.0 * SLICE_S))
        time.sleep(1.0)
        found = {}
        for kind in LOADS:
            with load(kind, folder):
                found[kind] = of_rtarm(stack)
        return found


def round_of_cyclictest(folder: Path, rate_hz: float) -> dict[str, Slice]:
    found = {}
    for kind in LOADS:
        with load(kind, folder):
            found[kind] = of_cyclictest(round(1e9 / rate_hz))
    return found


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
    """The latest wake-up of all, and what it was mostly."""
    largest_us = max(int(one.lateness["max_ns"]) for one in slices) / 1000
    latest = max((late for one in slices for late in one.late), key=lambda late: late.length_ns, default=None)
    if latest is None:
        return f"{largest_us:.0f} µs"
    segment = max((one for one in latest.segments if one.cause is latest.cause), key=lambda one: one.length_ns)
    return f"{largest_us:.0f} µs: {latest.cause.value}{f' ({segment.who})' if segment.who else ''}"


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
            figures, causes = figures_us(merged(one.lateness for one in of[kind])), []
            late = [one for slice_ in of[kind] for one in slice_.late]
            if late:
                causes = causes_of(late)
            values = ", ".join(f"{figures[name.replace('.', '_')]:.1f}" for name in PERCENTS)
            report(f"  {who}, {figures['count']} wake-ups", f"{values}; {worst_of(of[kind])}")
            of_all = ", ".join(
                f"{one['cause']} {one['cycles']} ({one['share']:.0%})" for one in causes if one["cycles"]
            )
            report(f"  {who}: {len(late)} later than {BOUND_US} µs", of_all)
            kept[who] = {
                "us": figures,
                "slices_us": [figures_us(one.lateness) for one in of[kind]],
                "late": len(late),
                "causes": causes,
            }
        kept["ratio"] = {}
        for name, percent in PERCENTS.items():
            ratio = kept["ratio"][name] = ratio_of(slices["rtarm"][kind], slices["cyclictest"][kind], percent)
            aim = ", aim ≤ 1.1" if name == "p99.9" else ""
            report(f"  rtarm / cyclictest, {name}{aim}", "{:.2f} (95 %: {:.2f} to {:.2f})".format(*ratio))
