"""`python -m machine_witness NAME=VALUE`: a witness of how late this machine is, beside tests with real processes.

It sleeps for 5 ms, again and again. It wakes up late where the machine stood still, gave its processors to others, or
was busy with what the tests themselves have started, which is known by NAME=VALUE in its environment. The time that
the latter ran is no stall of the machine. What is left is: a wake-up that was 30 ms late or more, and every second in
which the processors were full and others had a quarter of them.

A line on standard input, an instant of CLOCK_MONOTONIC in ns, is answered by a line about the time since: `Stalls`.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

SLEEP_NS = 5_000_000
STALL_NS = 30_000_000
"""A control cycle of 10 ms forgives two late ones."""
LOOK_NS = 1_000_000_000
"""Between two looks at who had the processors."""
FULL_SHARE, OTHERS_SHARE = 0.9, 0.25
NEW_NS = 1_000_000_000
"""A process that has just been forked has its parent's environment for a moment."""
SCAN_NS = 50_000_000
PROCESSORS = os.cpu_count() or 1
TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


class Stalls(NamedTuple):
    """What kept processes waiting that was not the tests' own."""

    longest_s: float
    """The latest wake-up, less what the tests' own processes had of it; 0 below 30 ms."""
    starved_s: float
    """Seconds in which others took a quarter of all processors or more, and nothing was left."""

    def __bool__(self) -> bool:
        return self.longest_s > 0.0 or self.starved_s > 0.0

    def __str__(self) -> str:
        return f"woke up {1e3 * self.longest_s:.0f} ms late, {self.starved_s:.0f} s with processors full of others"


class Witness:
    """The process that watches, started once for many tests."""

    def __init__(self, marker: str) -> None:
        environment = {name: text for name, text in os.environ.items() if f"{name}={text}" != marker}
        command = [sys.executable, "-S", str(Path(__file__)), marker]
        self._process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.since(time.monotonic_ns())  # it watches from here on

    def since(self, start_ns: int) -> Stalls:
        """Of the time from an instant of CLOCK_MONOTONIC until now."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(b"%d\n" % start_ns)
            self._process.stdin.flush()
            return Stalls(*json.loads(self._process.stdout.readline()))
        except (OSError, ValueError):  # nobody watches any more: what fails has failed
            return Stalls(0.0, 0.0)

    def close(self) -> None:
        self._process.communicate()


class OwnProcesses:
    """The processor time of a process, and of everything that has a marker in its environment."""

    def __init__(self, marker: bytes, pid: int) -> None:
        self._marker = marker
        self._first_seen_ns: dict[int, int] = {}
        self._spent_ns = {pid: 0}
        self._of_ended_ns = 0

    def scan(self, now_ns: int) -> None:
        """Look which processes there are."""
        there = {int(name) for name in os.listdir("/proc") if name.isdigit()}
        self._first_seen_ns = {pid: at for pid, at in self._first_seen_ns.items() if pid in there}
        for pid in there - self._spent_ns.keys():
            first_ns = self._first_seen_ns.setdefault(pid, now_ns)
            if now_ns - first_ns <= NEW_NS and self._has_marker(pid):
                self._spent_ns[pid] = 0

    def spent_ns(self) -> int:
        """Processor time of all of them so far; of ended ones, until it was last asked for."""
        for pid, before_ns in list(self._spent_ns.items()):
            try:
                self._spent_ns[pid] = time.clock_gettime_ns(_clock_of(pid))
            except OSError:
                self._of_ended_ns += before_ns
                del self._spent_ns[pid]
        return self._of_ended_ns + sum(self._spent_ns.values())

    def _has_marker(self, pid: int) -> bool:
        try:
            return self._marker in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
        except OSError:  # it has ended
            return False


def machine_share_ns(late_ns: int, own_ns: int, processors: int) -> int:
    """What of a lateness was the machine's: what the tests' own threads did not run, of all processors in that time."""
    return max(0, late_ns - own_ns // processors)


def is_starved(span_ns: int, idle_ns: int, own_ns: int, processors: int) -> bool:
    """Whether others than the tests had so much of full processors that the tests had to wait."""
    all_ns = processors * span_ns
    others_ns = all_ns - idle_ns - own_ns
    return idle_ns < (1.0 - FULL_SHARE) * all_ns and others_ns > OTHERS_SHARE * all_ns


def _clock_of(pid: int) -> int:
    """The clock of a process' processor time: clock_getcpuclockid(3)."""
    return ~pid << 3 | 2


def _idle_ns() -> int:
    """Time that processors had nothing to do, all of them together."""
    fields = Path("/proc/stat").read_bytes().split(b"\n", 1)[0].split()
    return (int(fields[4]) + int(fields[5])) * 1_000_000_000 // TICKS_A_SECOND


def _watch(marker: bytes) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the tests
    own = OwnProcesses(marker, os.getppid())  # who runs the tests got its marker too late to show it
    late: list[tuple[int, int]] = []  # when, and how much of it was the machine's [ns]
    starved: list[tuple[int, int]] = []  # until when, and how long [ns]
    before_ns = scanned_ns = looked_ns = time.monotonic_ns()
    own.scan(before_ns)
    spent_ns = spent_at_look_ns = own.spent_ns()
    idle_at_look_ns = _idle_ns()
    while True:
        asked = bool(select.select((sys.stdin,), (), (), SLEEP_NS * 1e-9)[0])
        now_ns = time.monotonic_ns()
        now_spent_ns = own.spent_ns()
        late_ns = machine_share_ns(now_ns - before_ns - SLEEP_NS, now_spent_ns - spent_ns, PROCESSORS)
        if late_ns >= STALL_NS:
            late.append((now_ns, late_ns))
        if now_ns - looked_ns >= LOOK_NS:
            idle_ns = _idle_ns()
            if is_starved(now_ns - looked_ns, idle_ns - idle_at_look_ns, now_spent_ns - spent_at_look_ns, PROCESSORS):
                starved.append((now_ns, now_ns - looked_ns))
            looked_ns, idle_at_look_ns, spent_at_look_ns = now_ns, idle_ns, now_spent_ns
        if asked:
            line = sys.stdin.readline()
            if not line:
                return
            start_ns = int(line)
            longest_ns = max((ns for at_ns, ns in late if at_ns > start_ns), default=0)
            starved_ns = sum(ns for at_ns, ns in starved if at_ns > start_ns)
            print(json.dumps([longest_ns * 1e-9, starved_ns * 1e-9]), flush=True)
        before_ns, spent_ns = now_ns, now_spent_ns
        if now_ns - scanned_ns >= SCAN_NS:
            own.scan(now_ns)
            scanned_ns = now_ns


if __name__ == "__main__":
    _watch(sys.argv[1].encode())
