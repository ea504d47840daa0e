"""Computing time of one control cycle of six joints, without any system call: of ZDT drives, and of every family.

A recorded MoveIt goal is played once in virtual time against the simulated arm, and every byte that the
drives sent is kept with its time. The cycles are then run again in one compiled loop over those bytes: the
same goal executed, the same replies decoded, the same frames encoded, nobody waiting for anything.

They are run twice: back to back with everything in the caches, and with so much other memory written between two
cycles that no cache holds anything of ours. A cycle that wakes from a sleep lies between the two. The families take
turns, everything in the caches, each at the rate of its own arm.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from many_cycles import Recording, RecordingArm
from virtual import recorded_goal

from config.loader import known_arms, load_arm
from shm.words import Outcome

GOAL = "large"
ARMS = [name for name in known_arms() if name != "mock"]
TURNS = 15
ROUNDS = {"hot": 30, "cold": 3}
OTHER_BYTES = {"hot": 0, "cold": 80 << 20}


@pytest.fixture(scope="module")
def recording() -> Iterator[Recording]:
    """The arm with its memory at the start of the goal, and what came in each cycle until the goal's end."""
    arm = RecordingArm(start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    assert arm.bring_up().failure is None
    yield Recording(arm, arm.play(GOAL))
    arm.close()


@pytest.mark.parametrize("caches", ROUNDS)
def test_cycle_compute(benchmark, recording, report, caches):
    everything = []
    recording.others = np.zeros(OTHER_BYTES[caches] // 8, np.int64)

    def play():
        sent = recording.play()
        everything.append(recording.durations_ns.copy())
        return sent

    sent = benchmark.pedantic(play, setup=recording.rewind, rounds=ROUNDS[caches], iterations=1)
    arm, cycles = recording.arm, len(recording.durations_ns)
    assert arm.outcome(recording.goal) == Outcome.SUCCEEDED
    assert sent > 300 * cycles  # the frames of six joints, and the replies to them
    assert arm.state.record["counters"]["frames_received"] > 6 * cycles

    all_ns = np.concatenate(everything)
    p50, p99, p999, most = np.percentile(all_ns, [50, 99, 99.9, 100]) / 1000
    benchmark.extra_info.update(
        cycles=len(all_ns), p50_us=p50, p99_us=p99, p99_9_us=p999, max_us=most, mean_us=all_ns.mean() / 1000
    )
    report(
        f"one cycle, 6 ZDT joints executing, caches {caches} (aim hot ≤ 5 µs)",
        f"mean {all_ns.mean() / 1000:.2f}, p50 {p50:.2f}, p99 {p99:.2f}, p99.9 {p999:.2f}, max {most:.1f} µs "
        f"({len(all_ns)} cycles)",
    )


def played(name: str) -> Recording:
    """An arm that comes with rtarm, its goal played once."""
    arm = RecordingArm(load_arm(name), start_rad=recorded_goal(GOAL)["joints"][0, :, 0])
    assert arm.bring_up().failure is None
    arm.reference_all()
    return Recording(arm, arm.play(GOAL))


def test_families(benchmark, report):
    recordings = {name: played(name) for name in ARMS}
    cost_us: dict[str, list[float]] = {name: [] for name in ARMS}

    def take_turns():
        for name, recording in recordings.items():
            cost_us[name].append(recording.median_us())

    benchmark.pedantic(take_turns, rounds=TURNS)
    benchmark.extra_info.update(cost_us)
    report("one cycle, 6 joints executing, caches hot", f"p50, median of {TURNS} turns (least to most)")
    for name, recording in recordings.items():
        ended = Outcome(recording.arm.outcome(recording.goal)).name
        costs = cost_us[name]
        report(
            f"  {name}, {recording.arm.arm.control.rate_hz:g} Hz",
            f"{np.median(costs):.2f} ({min(costs):.2f} to {max(costs):.2f}) µs"
            f"{'' if ended == 'SUCCEEDED' else f'; the goal ends as {ended}'}",
        )
        recording.arm.close()
