"""Causes of late cycles that are planted on purpose: `python -m planted CAUSE …`, each with when it was there.

A plant prints `ready`, and a line `START END` (CLOCK_MONOTONIC ns) for each time that it kept the processor, or stopped
the process. `pages` is a periodic loop of its own, which prints of each cycle when it was due, woke and ended, and
whether pages were planted in it.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import mmap
import os
import random
import resource
import signal
import socket
import struct
import time
from collections.abc import Callable

NS = 1_000_000_000
MS = 1_000_000
GAP_S = 0.12
"""Between two plants, and up to half as much more."""
HOG_NS = 3 * MS
HOG_PRIORITY, PAGES_PRIORITY = 95, 80
TIMERS = 4000
"""That expire in one interrupt."""
GROUP, LOOPBACK, PORT = "239.255.41.7", "127.0.0.1", 41_707
RECEIVERS = 4000
"""That one packet is delivered to."""
STOP_S = 0.02
PAGES = 2000
PAGES_PERIOD_NS = 10 * MS
PAGES_EACH = 6
"""A cycle in so many touches fresh pages."""

_libc = ctypes.CDLL(None, use_errno=True)


def told(start_ns: int, end_ns: int) -> None:
    print(start_ns, end_ns, flush=True)


def gap() -> None:
    time.sleep(GAP_S * random.uniform(1.0, 1.5))


def next_due(due_ns: int, period_ns: int, ahead_ns: int) -> int:
    """The first planned time of the cycle that lies so far ahead."""
    return due_ns + -(-(time.monotonic_ns() + ahead_ns - due_ns) // period_ns) * period_ns


def spin_until(time_ns: int) -> None:
    while time.monotonic_ns() < time_ns:
        pass


def hog(due_ns: int, period_ns: int, count: int) -> None:
    """A task of higher priority computes, from shortly before a cycle is due."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(HOG_PRIORITY))
    for _ in range(count):
        gap()
        begin_ns = next_due(due_ns, period_ns, 2 * MS) - random.randrange(100_000, 1_500_000)
        time.sleep(max(begin_ns - time.monotonic_ns(), 0) / NS)
        start_ns = time.monotonic_ns()
        spin_until(start_ns + HOG_NS)
        told(start_ns, time.monotonic_ns())


def flood(due_ns: int, period_ns: int, count: int) -> None:
    """Thousands of timers expire together, shortly before a cycle is due; seen as a gap in our own time."""
    may_open(TIMERS)
    timers = [_libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK) for _ in range(TIMERS)]
    assert min(timers) >= 0, "no more timers are to be had"
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))  # ordinary tasks would make gaps of their own
    for _ in range(count):
        gap()
        at_ns = next_due(due_ns, period_ns, 40 * MS) - random.randrange(50_000, 300_000)
        spec = struct.pack("qqqq", 0, 0, *divmod(at_ns, NS))
        for timer in timers:
            assert _libc.timerfd_settime(timer, 1, spec, None) == 0
        time.sleep(max(at_ns - MS - time.monotonic_ns(), 0) / NS)
        told(*longest_gap(at_ns + 4 * MS))


def may_open(files: int) -> None:
    """As many, and a few."""
    most = files + 100
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, max(most, resource.getrlimit(resource.RLIMIT_NOFILE)[1])))


def longest_gap(until_ns: int) -> tuple[int, int]:
    """When, until then, the clock could not be read for longest."""
    last_ns, found = time.monotonic_ns(), (0, 0)
    while last_ns < until_ns:
        now_ns = time.monotonic_ns()
        if now_ns - last_ns > found[1] - found[0]:
            found = last_ns, now_ns
        last_ns = now_ns
    return found


def packets(due_ns: int, period_ns: int, count: int) -> None:
    """A packet goes to thousands of sockets at once, in a softirq of its sender, shortly before a cycle is due."""
    may_open(RECEIVERS)
    with contextlib.ExitStack() as stack:
        for _ in range(RECEIVERS):
            stack.enter_context(receiver())
        sender = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        for _ in range(count):
            gap()
            at_ns = next_due(due_ns, period_ns, 2 * MS) - random.randrange(50_000, 300_000)
            time.sleep(max(at_ns - MS - time.monotonic_ns(), 0) / NS)
            spin_until(at_ns)
            start_ns = time.monotonic_ns()
            sender.sendto(b"rtarm", (GROUP, PORT))
            told(start_ns, time.monotonic_ns())


def receiver() -> socket.socket:
    """A socket that gets what is sent to the group."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    found.bind((GROUP, PORT))
    found.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(LOOPBACK))
    return found


def stop(pid: int, count: int) -> None:
    """A process is stopped for a while."""
    for _ in range(count):
        gap()
        start_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGSTOP)
        time.sleep(STOP_S)
        os.kill(pid, signal.SIGCONT)
        told(start_ns, time.monotonic_ns())


def pages(count: int) -> None:
    """A periodic loop, some cycles of which touch memory that is not there yet; ends when nobody reads any more."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PAGES_PRIORITY))
    due_ns, planted = time.monotonic_ns() + NS // 2, 0
    while planted < count:
        fresh = mmap.mmap(-1, PAGES * mmap.PAGESIZE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        fresh.madvise(mmap.MADV_NOHUGEPAGE)
        time.sleep(max(due_ns - time.monotonic_ns(), 0) / NS)
        woke_ns = time.monotonic_ns()
        is_planted = random.randrange(PAGES_EACH) == 0
        if is_planted:
            planted += 1
            for at in range(0, PAGES * mmap.PAGESIZE, mmap.PAGESIZE):
                fresh[at] = 1
        end_ns = time.monotonic_ns()
        print(due_ns, woke_ns, end_ns, int(is_planted), flush=True)
        fresh.close()
        due_ns += max(1, (time.monotonic_ns() - due_ns) // PAGES_PERIOD_NS + 1) * PAGES_PERIOD_NS
    time.sleep(1.0)


PLANTS: dict[str, Callable[..., None]] = {"hog": hog, "flood": flood, "packets": packets, "stop": stop, "pages": pages}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("cause", choices=PLANTS)
    parser.add_argument("numbers", nargs="+", type=int)
    options = parser.parse_args()
    print("ready", flush=True)
    PLANTS[options.cause](*options.numbers)


if __name__ == "__main__":
    main()
