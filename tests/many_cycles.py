"""Many cycles in one compiled call, for tests and benchmarks that want the interpreter out of the way.

The planned time advances by one period a cycle, the front's heartbeat with it, and the bytes of a cycle are
dropped as if the wire had taken them.
"""

from typing import Any

import numpy as np
from virtual import VirtualArm

from compilation.jit import jit
from rtloop.cycle import step
from rtloop.process.run import monotonic_ns
from rtloop.wire import received
from shm import layout
from shm.atomics import store_relaxed
from shm.record import offset_of
from shm.words import Outcome

WORDS_A_LINE = 8

HEARTBEAT = offset_of(layout.CommandFile, "heartbeat_ns")


@jit
def run_cycles(loop: Any, shared: Any, start_ns: int, count: int, heartbeat: int) -> int:
    """Run `count` cycles after start_ns; the planned time of the last one."""
    now_ns = start_ns
    for _ in range(count):
        now_ns += loop.params.period_ns
        store_relaxed(heartbeat, now_ns)
        step(loop, shared, now_ns)
        loop.buses[0].outgoing.length = 0
    return now_ns


def advance(arm: VirtualArm, count: int) -> None:
    """Let an arm in virtual time run `count` cycles without the interpreter in between."""
    arm.now_ns = run_cycles(arm.loop[0], arm.state.array[0], arm.now_ns, count, arm.command.address + HEARTBEAT)


def swing(arm: VirtualArm, duration_s: float, spacing_s: float = 0.1) -> int:
    """Start a long, gentle to and fro of all joints; its goal, running with all its waypoints taken."""
    times = np.arange(0.0, duration_s + spacing_s, spacing_s)
    w = 2 * np.pi / 4.0
    shape = np.stack([1 - np.cos(w * times), w * np.sin(w * times), w * w * np.cos(w * times)], axis=-1)
    joints = 0.05 * shape[:, None, :] * np.ones((1, len(arm.arm.joints), 1))
    joints[:, :, 0] += arm.loop[0]["axes"]["commanded"]["next_position_rad"][: len(arm.arm.joints)]
    goal = arm.send_goal((times * 1e9).astype(int), joints, tolerances=(0.0, 0.0, 0.0))
    arm.until(lambda: not arm.pending and arm.running_goal == goal)
    arm.until(lambda: arm.loop[0]["paths"][int(arm.memory["goals"]["active"])]["taken"] == len(times))
    return goal


# --- the same cycles again, with what the wire brought -----------------------------------------------------


class RecordingArm(VirtualArm):
    """Keeps what the adapter sent in each cycle."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.chunks: list[tuple[int, int, bytes]] = []

    def listen(self, until_ns: int) -> None:
        ring = self.loop[0]["buses"][0]["received"]
        before = int(ring["arrived"]["chunks"])
        super().listen(until_ns)
        chunks = ring["chunks"]
        for number in range(before, int(ring["arrived"]["chunks"])):
            chunk = chunks[number % len(chunks)]
            start = int(chunks[(number - 1) % len(chunks)]["end"]) if number else 0
            at = np.arange(start, int(chunk["end"])) % len(ring["bytes"])
            self.chunks.append((self.now_ns, int(chunk["time_ns"]), ring["bytes"][at].tobytes()))


@jit
def replay(
    loop: Any,
    shared: Any,
    cycles_ns: np.ndarray,
    chunks: np.ndarray,
    data: np.ndarray,
    heartbeat: int,
    clock: int,
    durations_ns: np.ndarray,
    others: np.ndarray,
) -> int:
    """Run the recorded cycles again; the time of each `step` alone goes to durations_ns, bytes sent back.

    `others` is memory that is written between two cycles.
    """
    chunk = 0
    sent = 0
    for i in range(len(cycles_ns)):
        now_ns = cycles_ns[i]
        while chunk < len(chunks) and chunks[chunk, 0] <= now_ns:
            received.push(loop.buses[0], chunks[chunk, 1], data[chunks[chunk, 2] :], chunks[chunk, 3])
            chunk += 1
        store_relaxed(heartbeat, now_ns)
        for word in range(0, len(others), WORDS_A_LINE):
            others[word] = now_ns
        before_ns = monotonic_ns(clock)
        step(loop, shared, now_ns)
        durations_ns[i] = monotonic_ns(clock) - before_ns
        sent += loop.buses[0].outgoing.length
        loop.buses[0].outgoing.length = 0
    return sent


class Recording:
    """A goal that was executed once in virtual time, to be executed again by the compiled cycle alone.

    Attributes:
        durations_ns: computing time of each cycle of the last `play`, (cycles,).
        others: words that are written between two cycles, so that they take our place in the caches; none at first.
    """

    def __init__(self, arm: RecordingArm, goal: int) -> None:
        """`goal` has just been sent, all its records fit into the ring; it is executed here."""
        self.arm, self.goal = arm, goal
        arm._feed_ring()
        assert not arm.pending
        arm.chunks.clear()
        self._loop, self._state = arm.loop.copy(), arm.state.array.copy()
        start_ns = arm.now_ns
        assert arm.end_of(goal) == Outcome.SUCCEEDED
        self._cycles_ns = np.arange(start_ns + arm.period_ns, arm.now_ns + 1, arm.period_ns)
        starts = np.cumsum([0, *(len(data) for _, _, data in arm.chunks)])
        table = [(cycle, at, start, len(data)) for (cycle, at, data), start in zip(arm.chunks, starts, strict=False)]
        self._chunks = np.array(table, np.int64).reshape(-1, 4)
        self._data = np.frombuffer(b"".join(data for _, _, data in arm.chunks), np.uint8)
        self._clock = np.zeros(2, np.int64)
        self.durations_ns = np.zeros(len(self._cycles_ns), np.int64)
        self.others = np.zeros(0, np.int64)
        self.rewind()
        self.play()  # whatever is still to be compiled

    def rewind(self) -> None:
        """Back to the goal's beginning."""
        self.arm.loop[:] = self._loop
        self.arm.state.array[:] = self._state

    def play(self) -> int:
        """Execute the goal from its beginning, where `rewind` has put it; bytes sent."""
        return replay(
            self.arm.loop[0],
            self.arm.state.array[0],
            self._cycles_ns,
            self._chunks,
            self._data,
            self.arm.command.address + HEARTBEAT,
            self._clock.ctypes.data,
            self.durations_ns,
            self.others,
        )

    def median_us(self) -> float:
        """Median of the cycles' computing time (µs) when the goal is executed once more."""
        self.rewind()
        self.play()
        return float(np.median(self.durations_ns)) / 1000
