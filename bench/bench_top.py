"""What `rtarm top` costs the control process it watches: lateness and cycle time at 1 kHz, with it and without.

Slices without and with it alternate and are compared as `slices` says. The arm is a mock arm, so that nothing but the
cycle is measured; it is watched in a pseudo-terminal of 120 by 40, which this process empties as a terminal would.
"""

import fcntl
import os
import statistics
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import LiveStack, Usage, live
from slices import SLICE_S, compare, slice_of, without_priority

RATE_HZ = 1000.0
PAIRS = 8
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


def watched_slice(stack: LiveStack, used: list[tuple[float, float]]) -> dict[str, float]:
    """The same with `rtarm top`, whose processor time and frames a second are added to `used`."""
    with top(stack.name) as watcher:
        before, frames, begun = Usage(watcher).processor_s, watcher.frames, time.monotonic()
        found = slice_of(stack)
        seconds = time.monotonic() - begun
        used.append(((Usage(watcher).processor_s - before) / seconds, (watcher.frames - frames) / seconds))
    return found


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
            for number in range(PAIRS):
                watched.append((number, watched_slice(stack, used)))
                alone.append(slice_of(stack))
            return alone, watched, used

    alone, watched, used = benchmark.pedantic(measure, rounds=1)
    report(f"1 kHz mock arm, {priority} priority: with / without rtarm top", f"{PAIRS} pairs of {SLICE_S:g} s")
    benchmark.extra_info.update(compare(report, alone, watched))
    shares, frames = zip(*used, strict=True)
    benchmark.extra_info.update(core=shares, frames_a_second=frames)
    report(
        "  rtarm top itself",
        f"{100 * statistics.median(shares):.1f} % of a core at {statistics.median(frames):.1f} frames/s",
    )
