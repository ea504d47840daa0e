"""`python -m bench.witness STATE_FILE PRIORITY CPU PERIOD_NS PHASE_NS SECONDS FILE`: was only the cycle late?

A compiled sleeper with real-time priority on the cycle's processor, below the cycle, so that it never delays it. It
wakes every PERIOD_NS, PHASE_NS after a whole multiple of it, and at each wake-up looks at the control process' count of
missed cycles. So it can say for each missed cycle, which nobody timestamps, between which two looks it was counted, and
how late the sleeper itself was then.

FILE (.npz) gets `missed`, of dtype MISSED, and `late_ns`, (n, 2): when it woke and how late, of its late wake-ups.
Prints `ready`, and begins when a line comes in; prints `done` at its end.
"""

from __future__ import annotations

import mmap
import os
import sys
import time
from typing import Any

import numpy as np

from compilation.jit import jit
from rtloop.process.run import monotonic_ns
from rtloop.system import realtime
from rtloop.system.libc import CLOCK_MONOTONIC, TIMER_ABSTIME, clock_nanosleep
from shm import layout
from shm.atomics import load_relaxed, store_relaxed
from shm.record import offset_of

MISSED = np.dtype(
    [
        ("since_ns", "i8"),  # CLOCK_MONOTONIC of the look before
        ("until_ns", "i8"),  # and of the look that found it
        ("cycles", "i8"),  # how many
        ("late_ns", "i8"),  # how late the sleeper was at the look that found it
    ]
)
MOST = 100_000

_OVERRUNS = offset_of(layout.StateFile, "counters", "overruns")


@jit
def witness(
    state: int, timespec: int, period_ns: int, phase_ns: int, until_ns: int, missed: Any, late: Any
) -> tuple[int, int]:
    """Sleep and look until a time; how many rows of `missed` and of `late` it would have filled, had they room for all.

    `late` is (n, 2); a wake-up is late when more than a quarter of the witness' own period has passed.
    """
    due_ns = (monotonic_ns(timespec) // period_ns + 1) * period_ns + phase_ns
    seen = load_relaxed(state + _OVERRUNS)
    looked_ns = monotonic_ns(timespec)
    found, lates = 0, 0
    while looked_ns < until_ns:
        store_relaxed(timespec, due_ns // 1_000_000_000)
        store_relaxed(timespec + 8, due_ns % 1_000_000_000)
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec, 0)
        woke_ns = monotonic_ns(timespec)
        overruns = load_relaxed(state + _OVERRUNS)
        late_ns = woke_ns - due_ns
        if 4 * late_ns > period_ns:
            if lates < len(late):
                late[lates, 0], late[lates, 1] = woke_ns, late_ns
            lates += 1
        if overruns > seen:
            if found < len(missed):
                row = missed[found]
                row.since_ns, row.until_ns, row.cycles, row.late_ns = looked_ns, woke_ns, overruns - seen, late_ns
            found += 1
        seen, looked_ns = overruns, woke_ns
        due_ns += period_ns * (late_ns // period_ns + 1)
    return found, lates


def main(arguments: list[str]) -> None:
    path, priority, cpu, period_ns, phase_ns, seconds, file = arguments
    with open(path, "rb") as opened:
        mapped = mmap.mmap(opened.fileno(), 0, prot=mmap.PROT_READ)
    state = np.frombuffer(mapped, layout.StateFile.dtype, 1)
    missed, late = np.ones(MOST, MISSED), np.ones((MOST, 2), np.int64)  # ones, so that their pages are there
    timespec = np.zeros(2, np.int64)
    rest = (state.ctypes.data, timespec.ctypes.data, int(period_ns), int(phase_ns))
    witness(*rest, 0, missed, late)  # compiles it
    realtime.prepare_process((used.ctypes.data, used.nbytes) for used in (missed, late, timespec))
    os.sched_setaffinity(0, {int(cpu)})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(priority)))
    print("ready", flush=True)
    sys.stdin.readline()
    until_ns = time.monotonic_ns() + round(float(seconds) * 1e9)
    found, lates = witness(*rest, until_ns, missed, late)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # nobody waits for the rest
    np.savez(file, missed=missed[:found], late_ns=late[:lates])
    print("done", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
