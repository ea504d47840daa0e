"""Computing time of one control cycle of the six ZDT joints, without any system call.

A recorded MoveIt goal is played once in virtual time against the simulated arm, and every byte that the
drives sent is kept with its time. The cycles are then run again in one compiled loop over those bytes: the
same goal executed, the same replies decoded, the same frames encoded, nobody waiting for anything.
"""

from typing import Any

import numpy as np
import pytest
from many_cycles import HEARTBEAT
from virtual import VirtualArm, recorded_goal

from rtloop.cycle import step
from rtloop.run import monotonic_ns
from rtloop.wire import received
from shm.atomics import store_relaxed
from shm.jit import jit
from shm.words import Outcome

GOAL = "large"
ROUNDS = 30


class RecordingArm(VirtualArm):
    """Keeps what the adapter sent in each cycle."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.chunks: list[tuple[int, int, bytes]] = []

    def listen(self, until_ns: int) -> None:
        before = int(self.loop[0]["received"]["chunks_written"][0])
        super().listen(until_ns)
        ring = self.loop[0]["received"]
        for number in range(before, int(ring["chunks_written"][0])):
            slot = number % len(ring["chunk_end"])
            start = int(ring["chunk_end"][(number - 1) % len(ring["chunk_end"])]) if number else 0
            at = np.arange(start, int(ring["chunk_end"][slot])) % len(ring["bytes"])
            self.chunks.append((self.now_ns, int(ring["chunk_time_ns"][slot]), ring["bytes"][at].tobytes()))


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
) -> int:
    """Run the recorded cycles again; the time of each `step` alone goes to durations_ns, bytes sent back."""
    chunk = 0
    sent = 0
    for i in range(len(cycles_ns)):
        now_ns = cycles_ns[i]
        while chunk < len(chunks) and chunks[chunk, 0] <= now_ns:
            received.push(loop, chunks[chunk, 1], data[chunks[chunk, 2] :], chunks[chunk, 3])
            chunk += 1
        store_relaxed(heartbeat, now_ns)
        before_ns = monotonic_ns(clock)
        sent += step(loop, shared, now_ns)
        durations_ns[i] = monotonic_ns(clock) - before_ns
        loop.core.tx_length = 0
    return sent


@pytest.fixture(scope="module")
def recording() -> Any:
    """The arm, its memory at the start of the goal, and what came in each cycle until the goal's end."""
    arm = RecordingArm(start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    assert arm.bring_up().failure is None
    goal = arm.play(GOAL)
    arm._feed_ring()
    assert not arm.pending
    arm.chunks.clear()
    loop, state = arm.loop.copy(), arm.state.array.copy()
    start_ns = arm.now_ns
    arm.until(lambda: arm.outcome(goal) != Outcome.NONE)
    cycles_ns = np.arange(start_ns + arm.period_ns, arm.now_ns + 1, arm.period_ns)
    starts = np.cumsum([0, *(len(data) for _, _, data in arm.chunks)])
    table = [
        (cycle_ns, at_ns, start, len(data)) for (cycle_ns, at_ns, data), start in zip(arm.chunks, starts, strict=False)
    ]
    data = np.frombuffer(b"".join(data for _, _, data in arm.chunks), np.uint8)
    yield arm, goal, loop, state, cycles_ns, np.array(table, np.int64), data
    arm.close()


def test_cycle_compute(benchmark, recording, report):
    arm, goal, loop, state, cycles_ns, chunks, data = recording
    durations_ns = np.zeros(len(cycles_ns), np.int64)
    clock = np.zeros(2, np.int64)
    everything = []

    def as_at_the_start():
        arm.loop[:] = loop
        arm.state.array[:] = state

    def play():
        return replay(
            arm.loop[0],
            arm.state.array[0],
            cycles_ns,
            chunks,
            data,
            arm.command.address + HEARTBEAT,
            clock.ctypes.data,
            durations_ns,
        )

    def remember():
        everything.append(durations_ns.copy())
        as_at_the_start()

    as_at_the_start()
    play()
    sent = benchmark.pedantic(play, setup=remember, rounds=ROUNDS, iterations=1)
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    assert sent > 300 * len(cycles_ns)  # the frames of six joints, and the replies to them
    assert arm.state.record["counters"]["frames_received"] > 6 * len(cycles_ns)

    all_ns = np.concatenate(everything)
    p50, p99, p999, most = np.percentile(all_ns, [50, 99, 99.9, 100]) / 1000
    benchmark.extra_info.update(
        cycles=len(all_ns), p50_us=p50, p99_us=p99, p99_9_us=p999, max_us=most, mean_us=all_ns.mean() / 1000
    )
    report(
        "one cycle, 6 ZDT joints executing a goal (aim ≤ 5 µs)",
        f"mean {all_ns.mean() / 1000:.2f}, p50 {p50:.2f}, p99 {p99:.2f}, p99.9 {p999:.2f}, max {most:.1f} µs "
        f"({len(all_ns)} cycles)",
    )
