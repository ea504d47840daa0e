"""A compiled onlooker: when each cycle's snapshot really was there, and what it showed."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from live import NS, LiveStack

from compilation.jit import jit
from config.loader import load_arm
from config.sections import RealtimeConfig
from rtloop.process.initial_state import new_loop
from rtloop.process.run import monotonic_ns
from rtloop.system import realtime
from rtloop.system.libc import CLOCK_MONOTONIC, TIMER_ABSTIME, clock_nanosleep
from shm import layout, seqlock
from shm.atomics import load_acquire, store_relaxed
from shm.record import offset_of

PRIORITY = 60
"""Below the cycle and its reader, above the simulated drives: it may hold those up for the moments it looks."""
LOOK_NS = 2_000_000
"""It looks without a pause for so long after a snapshot is due, and every PAUSE_NS from then on."""
PAUSE_NS = 50_000
PATIENCE_NS = NS

ROW = np.dtype(
    [
        ("cycle", "i8"),
        ("due_ns", "i8"),  # planned time of the cycle
        ("seen_ns", "i8"),  # CLOCK_MONOTONIC at which its snapshot was found complete
        ("stamp_ns", "i8"),  # the newest measurement in it, ROS time: the stamp of its /joint_states
        ("arrived_ns", "i8", (layout.MAX_JOINTS,)),  # when the reader thread had read what each joint's shows
    ]
)

_SEQUENCE = offset_of(layout.StateFile, "snapshot_sequence")
_SNAPSHOT = offset_of(layout.StateFile, "snapshot")


@jit
def sleep_until(time_ns: int, timespec: int) -> None:
    store_relaxed(timespec, time_ns // 1_000_000_000)
    store_relaxed(timespec + 8, time_ns % 1_000_000_000)
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec, 0)


@jit
def watch(
    state: int, snapshot: Any, copy: int, words: int, reply_delays_ns: np.ndarray, rows: Any, period_ns: int, clock: int
) -> int:
    """Fill `rows` from one cycle after the other; how many, fewer only when no snapshot came within PATIENCE_NS.

    `state` is the address of the state file, `copy` that of `snapshot`, `clock` that of a timespec.
    """
    sequence, source = state + _SEQUENCE, state + _SNAPSHOT
    shown = load_acquire(sequence)
    seqlock.read(sequence, source, copy, words)
    for number in range(len(rows)):
        due_ns, before = snapshot.monotonic_ns + period_ns, snapshot.cycle
        sleep_until(due_ns, clock)
        while snapshot.cycle <= before:
            newest = load_acquire(sequence)
            seen_ns = monotonic_ns(clock)
            if newest & 1 == 0 and newest != shown:
                shown = newest
                seqlock.read(sequence, source, copy, words)
            elif seen_ns > due_ns + PATIENCE_NS:
                return number
            elif seen_ns > due_ns + LOOK_NS:
                sleep_until(seen_ns + PAUSE_NS, clock)
        row = rows[number]
        row.cycle, row.due_ns, row.seen_ns = snapshot.cycle, snapshot.monotonic_ns, seen_ns
        newest_ns = 0
        for joint in range(len(reply_delays_ns)):
            measured_ns = snapshot.joints[joint].measured_ns
            newest_ns = max(newest_ns, measured_ns)
            row.arrived_ns[joint] = measured_ns + reply_delays_ns[joint]
        row.stamp_ns = snapshot.epoch_ns + newest_ns - snapshot.monotonic_ns
    return len(rows)


class Watcher:
    """The onlooker in a thread of its own, which needs no interpreter; `rows` of dtype ROW once it has ended."""

    def __init__(self, stack: LiveStack, cycles: int) -> None:
        memory, arm = stack.reader.memory, load_arm(stack.arm_file)
        count = len(arm.joints)
        self._snapshot = np.zeros(1, layout.Snapshot.dtype)
        self._rows = np.zeros(cycles, ROW)
        self._clock = np.zeros(2, np.int64)
        self._arguments = (
            memory.address,
            self._snapshot[0],
            self._snapshot.ctypes.data,
            layout.used_bytes(layout.Snapshot, count) // 8,
            new_loop(arm, 0, 0)[0]["joints"]["reply_delay_ns"][:count].copy(),
        )
        watch(*self._arguments, self._rows[:1], arm.control.period_ns, self._clock.ctypes.data)  # compiles it
        self._period_ns = arm.control.period_ns
        self._thread = threading.Thread(target=self._run)
        self._filled = 0

    def start(self) -> None:
        self._thread.start()

    @property
    def rows(self) -> np.ndarray:
        """One row a cycle that was seen."""
        self._thread.join()
        assert self._filled == len(self._rows), "the control process stopped publishing"
        return self._rows

    def _run(self) -> None:
        realtime.prepare_thread(RealtimeConfig(priority=PRIORITY), realtime.Obtained())
        self._filled = watch(*self._arguments, self._rows, self._period_ns, self._clock.ctypes.data)
