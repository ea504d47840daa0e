"""Computing time of one control cycle of the six ZDT joints, without any system call.

A recorded MoveIt goal is played once in virtual time against the simulated arm, and every byte that the
drives sent is kept with its time. The cycles are then run again in one compiled loop over those bytes: the
same goal executed, the same replies decoded, the same frames encoded, nobody waiting for anything.

They are run twice: back to back with everything in the caches, and with so much other memory written between two
cycles that no cache holds anything of ours. A cycle that wakes from a sleep lies between the two.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from many_cycles import Recording, RecordingArm
from virtual import recorded_goal

from shm.words import Outcome

GOAL = "large"
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
