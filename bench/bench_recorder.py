"""What the flight recorder costs the cycle: the same cycles without it, with it, and without its frames.

A goal is executed once in virtual time and then again and again in one compiled loop (as in bench_cycle.py), in turn
with the rings switched off and on, so that a noisy neighbour hits all alike. Back to back everything but the ring,
which is larger than the caches, is in them; with other memory written in between, nothing is.
"""

import numpy as np
import pytest
from bench_growth import arm_of, recorded_swing
from many_cycles import RecordingArm

from shm.recording import read_recording
from shm.words import Outcome

JOINTS = (6, 16)
ROUNDS = {"hot": 15, "cold": 3}
OTHER_BYTES = {"hot": 0, "cold": 80 << 20}
KEPT = {"nothing": (0, 0), "cycles": (1, 0), "cycles and frames": (1, 1)}
"""Whether each of the two rings is there."""


@pytest.mark.parametrize("caches", ROUNDS)
@pytest.mark.parametrize("joints", JOINTS)
def test_recorder(benchmark, report, tmp_path, joints, caches):
    recording = recorded_swing(RecordingArm(arm_of(joints, "zdt", tmp_path)))
    arm = recording.arm
    recorder = arm.state.record["recorder"]
    slots = int(recorder["record_slots"]), int(recorder["frame_slots"])
    recording.others = np.zeros(OTHER_BYTES[caches] // 8, np.int64)
    all_ns: dict[str, list[np.ndarray]] = {kept: [] for kept in KEPT}

    def play_all():
        for kept, switches in KEPT.items():
            recording.rewind()
            recorder["record_slots"], recorder["frame_slots"] = np.multiply(slots, switches)
            recording.play()
            all_ns[kept].append(recording.durations_ns.copy())

    benchmark.pedantic(play_all, rounds=ROUNDS[caches])
    assert arm.outcome(recording.goal) == Outcome.SUCCEEDED
    found = read_recording(arm.state)
    assert found.lost == 0 and len(found.records) > len(recording.durations_ns) > len(found.records) // 2
    medians = {kept: np.array([np.median(one) for one in rounds]) for kept, rounds in all_ns.items()}
    without = medians["nothing"]
    for kept, rounds in medians.items():
        more = rounds - without
        tail_us = np.percentile(np.concatenate(all_ns[kept]), 99.9) / 1000
        benchmark.extra_info[kept] = {"p50_ns": rounds.tolist(), "p99_9_us": tail_us}
        figure = f"p50 {np.median(rounds) / 1000:.2f} µs, p99.9 {tail_us:.1f} µs"
        if kept != "nothing":
            figure += (
                f"; {np.median(more):+.0f} ns ({min(more):+.0f} to {max(more):+.0f}), "
                f"× {np.median(rounds / without):.2f}"
            )
        report(f"a cycle of {joints} ZDT joints, caches {caches}, recording {kept}", figure)
    arm.close()
