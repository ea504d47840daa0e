"""What `rtarm top` costs the control process it watches: lateness and cycle time at 1 kHz, with it and without.

Slices without and with it alternate, so that a noisy neighbour hits both. A slice with it is compared with the slices
before and after it (their geometric mean); what the machine does by itself is how much neighbouring slices without it
differ. The arm is a mock arm, so that nothing but the cycle is measured; it is watched in a pseudo-terminal of 120 by
40, which this process empties as a terminal would.
"""

import fcntl
import math
import os
import statistics
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import LiveStack, Usage, live

from rtarm.status import percentiles_us
from rtarm.tracking import Window

RATE_HZ = 1000.0
SLICE_S = 5.0
SETTLE_S = 0.5
PAIRS = 8
FIGURES = ("p50", "p99", "p99_9", "max")
FRAME = b"\x1b[H"
"""The cursor goes home before each picture."""


@contextmanager
def top(arm: str) -> Iterator[SimpleNamespace]:
    """`rtarm top` while it draws; what it uses and how often it draws are in what it yields."""
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-c", f"from rtarm.top.terminal import run; run({arm!r})"],
        cwd=Path(__file__).resolve().parents[1],
        env={**os.environ, "TERM": "xterm-256color"},
        stdin=slave,
        stdout=slave,
        start_new_session=True,
    )
    os.close(slave)
    found = SimpleNamespace(process=process, frames=0)
    first = threading.Event()

    def empty() -> None:
        while True:
            try:
                shown = os.read(master, 65536)
            except OSError:  # it has ended
                return
            found.frames += shown.count(FRAME)
            first.set()

    reader = threading.Thread(target=empty)
    reader.start()
    try:
        assert first.wait(30.0)
        yield found
        os.write(master, b"q")
        assert process.wait(30.0) == 0
    finally:
        process.kill()
        process.wait()
        reader.join()
        os.close(master)


def slice_of(stack: LiveStack) -> dict[str, float]:
    """Percentiles of a slice from now on, in µs, and its overruns."""
    time.sleep(SETTLE_S)
    window = Window(stack.reader)
    time.sleep(SLICE_S)
    found = {"overruns": float(window.counters()[0]["overruns"])}
    for what in ("lateness", "cycle_time"):
        figures = percentiles_us(window.histogram(what))
        found |= {f"{what} {name}": figures[name] for name in FIGURES}
    return found


def watched_slice(stack: LiveStack, used: list[tuple[float, float]]) -> dict[str, float]:
    """The same with `rtarm top`, whose processor time and frames a second are added to `used`."""
    with top(stack.name) as watcher:
        before, frames, begun = Usage(watcher).processor_s, watcher.frames, time.monotonic()
        found = slice_of(stack)
        seconds = time.monotonic() - begun
        used.append(((Usage(watcher).processor_s - before) / seconds, (watcher.frames - frames) / seconds))
    return found


def without_priority(stack: LiveStack) -> None:
    """Take the real-time priority from the cycle, as on a machine that gives none."""
    for task in os.listdir(f"/proc/{stack.loop.process.pid}/task"):
        os.sched_setscheduler(int(task), os.SCHED_OTHER, os.sched_param(0))


def spread(ratios: Sequence[float]) -> str:
    return f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(400)
@pytest.mark.parametrize("priority", ["real-time", "ordinary"])
def test_top(benchmark, report, tmp_path, priority):
    def measure():
        with live(tmp_path, mock_hz=RATE_HZ, front=False) as stack:
            if priority == "ordinary":
                without_priority(stack)
            used: list[tuple[float, float]] = []
            alone, watched = [slice_of(stack)], []
            for _ in range(PAIRS):
                watched.append(watched_slice(stack, used))
                alone.append(slice_of(stack))
            return alone, watched, used

    alone, watched, used = benchmark.pedantic(measure, rounds=1)
    report(f"1 kHz mock arm, {priority} priority: with / without rtarm top", f"{PAIRS} pairs of {SLICE_S:g} s")
    for what in ("lateness", "cycle_time"):
        for name in FIGURES:
            key = f"{what} {name}"
            without, with_it = [one[key] for one in alone], [one[key] for one in watched]
            cost = [
                b / math.sqrt(a * c) for a, b, c in zip(without[:-1], with_it, without[1:], strict=True) if a * c > 0
            ]
            noise = [c / a for a, c in pairwise(without) if a > 0]
            benchmark.extra_info[key] = {"with_us": with_it, "without_us": without, "ratio": cost, "noise": noise}
            report(
                f"  {key.replace('_9', '.9').replace('_', ' ')}",
                f"{spread(cost)}; without / without {spread(noise)}; "
                f"{statistics.median(with_it):.1f} and {statistics.median(without):.1f} µs",
            )
    overruns = [sum(one["overruns"] for one in slices) for slices in (watched, alone[1:])]
    shares, frames = zip(*used, strict=True)
    benchmark.extra_info.update(overruns=overruns, core=shares, frames_a_second=frames)
    report("  overruns with, without", f"{overruns[0]:.0f}, {overruns[1]:.0f}")
    report(
        "  rtarm top itself",
        f"{100 * statistics.median(shares):.1f} % of a core at {statistics.median(frames):.1f} frames/s",
    )
