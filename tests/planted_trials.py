"""Planted causes beside a real control process, and what is found of them.

A late cycle counts as planted when the plant itself says that it was there for more than half of it.
"""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple

import planted
from planted import PAGES_PERIOD_NS
from stack import Stack

from rtarm.why_late.causes import Cause
from rtarm.why_late.report import causes_of
from rtarm.why_late.run import looker
from rtarm.why_late.tracefs import NotTraced, place, traced
from rtarm.why_late.watch import LOOK_S, ArmCycles, Cycle, Late, Watcher, cycle_thread
from shm.client import StateReader
from shm.files import open_state

CPU = max(os.sched_getaffinity(0))
RATE_HZ = 200.0
BOUND_NS = 250_000
EXPECTED = {
    "hog": Cause.TASK,
    "flood": Cause.INTERRUPT,
    "packets": Cause.SOFTIRQ,
    "stop": Cause.STOPPED,
    "pages": Cause.PAGE_FAULT,
}


def impossible() -> str:
    """Why nothing can be planted here, "" if it can."""
    if len(os.sched_getaffinity(0)) < 2:
        return "Causes are planted on one processor and watched from another, and here is only one."
    try:
        place()
    except NotTraced as reason:
        return reason.sentence
    return ""


class Lines:
    """A plant in a process of its own, pinned to a processor, and the numbers that it prints."""

    def __init__(self, *arguments: object, cpu: int | None) -> None:
        command = [sys.executable, planted.__file__, *map(str, arguments)]
        pinned = [] if cpu is None else ["taskset", "-c", str(cpu)]
        self.process = subprocess.Popen([*pinned, *command], stdout=subprocess.PIPE, text=True)
        self._lines: SimpleQueue[tuple[int, ...]] = SimpleQueue()
        assert self.process.stdout is not None
        if self.process.stdout.readline() != "ready\n":
            with self.process:
                raise RuntimeError(f"{command} ends with code {self.process.wait()} before it is ready")
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(tuple(map(int, line.split())))

    def new(self) -> list[tuple[int, ...]]:
        found = []
        while True:
            try:
                found.append(self._lines.get_nowait())
            except Empty:
                return found

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()


class LoopCycles:
    """The cycles of a `pages` loop; which of them were planted is kept."""

    period_ns = PAGES_PERIOD_NS

    def __init__(self, lines: Lines) -> None:
        self.planted: list[tuple[int, int]] = []
        self._lines = lines
        self._number = 0

    def new(self) -> list[Cycle]:
        found = []
        for due_ns, woke_ns, end_ns, is_planted in self._lines.new():
            self._number += 1
            found.append(Cycle(self._number, due_ns, woke_ns, end_ns))
            if is_planted:
                self.planted.append((woke_ns, end_ns))
        return found


def watched(lines: Lines, watcher: Watcher, tid: int) -> None:
    """Watch until the plant has ended."""
    with looker(tid) as thread:
        while lines.process.poll() is None:
            time.sleep(LOOK_S)
            thread.submit(watcher.look).result()
        time.sleep(LOOK_S)
        thread.submit(watcher.look, settle_ns=0).result()


class Trial(NamedTuple):
    """Late cycles while a cause was planted: those that it was there for, and the others."""

    cause: str
    pid: int
    planted: list[Late]
    others: list[Late]

    @property
    def expected(self) -> Cause:
        """What was planted."""
        return EXPECTED[self.cause]

    @property
    def right(self) -> int:
        """How many of the planted ones have the planted cause, with whoever planted it where that can be named."""
        return sum(self._is_right(late) for late in self.planted)

    @property
    def unknown(self) -> int:
        return sum(late.cause is Cause.UNKNOWN for late in self.planted)

    def found(self) -> Counter[Cause]:
        return Counter(late.cause for late in self.planted)

    def _is_right(self, late: Late) -> bool:
        named = {
            "hog": f" {self.pid} (",
            "flood": "timerfd",
            "packets": "NET_RX",
            "stop": f"SIGSTOP from python {self.pid}",
            "pages": "",
        }
        chief = next(one for one in causes_of([late]) if one["cause"] == late.cause.value)
        who = [one["who"] for one in chief["mostly"]] or [""]
        return late.cause is self.expected and any(named[self.cause] in name for name in who)


def apart(cause: str, pid: int, watcher: Watcher, plants: Sequence[tuple[int, ...]]) -> Trial:
    planted = [late for late in watcher.late if _was_there(late, plants)]
    return Trial(cause, pid, planted, [late for late in watcher.late if late not in planted])


def _was_there(late: Late, plants: Sequence[tuple[int, ...]]) -> bool:
    start_ns, end_ns = late.start_ns, late.end_ns
    there_ns = sum(max(0, min(end_ns, until_ns) - max(start_ns, from_ns)) for from_ns, until_ns in plants)
    return 2 * there_ns > end_ns - start_ns


@contextmanager
def mock_arm(folder: Path, rate_hz: float = RATE_HZ) -> Iterator[Stack]:
    """A control process whose cycle is pinned, with its `reader`; this process keeps off that processor."""
    allowed = os.sched_getaffinity(0)
    stack = Stack(f"y{secrets.token_hex(4)}", folder, "mock")
    stack.change(control={"rate_hz": rate_hz}, realtime={"cpu": CPU})
    try:
        stack.start_loop()
        os.sched_setaffinity(0, allowed - {CPU})
        stack.reader = StateReader(open_state(stack.name))
        yield stack
        stack.reader.close()
    finally:
        os.sched_setaffinity(0, allowed)
        stack.close()


def planted_in_arm(stack: Stack, cause: str, count: int) -> Trial:
    """Plant a cause beside a mock arm so many times."""
    memory = stack.reader.memory
    header = memory.record["header"]
    pid, period_ns = int(header["pid"]), int(header["period_ns"])
    due_ns = int(stack.reader.snapshot()["monotonic_ns"])
    tid = cycle_thread(memory)
    with traced(tid) as trace:
        watcher = Watcher(ArmCycles(memory), tid, trace.read, BOUND_NS)
        numbers = (pid, count) if cause == "stop" else (due_ns, period_ns, count)
        lines = Lines(cause, *numbers, cpu=None if cause == "stop" else CPU)
        try:
            watched(lines, watcher, tid)
        finally:
            lines.close()
    return apart(cause, lines.process.pid, watcher, lines.new())


def planted_in_loop(count: int) -> Trial:
    """The same of page faults in a loop of its own, since a control process locks its memory."""
    lines = Lines("pages", count, cpu=CPU)
    try:
        with traced(lines.process.pid) as trace:
            source = LoopCycles(lines)
            watcher = Watcher(source, lines.process.pid, trace.read, BOUND_NS)
            watched(lines, watcher, lines.process.pid)
    finally:
        lines.close()
    return apart("pages", lines.process.pid, watcher, source.planted)
