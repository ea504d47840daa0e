"""A trajectory of a million waypoints: the ring takes them as they are used up, and nothing grows."""

import resource

import numpy as np
from virtual import VirtualArm

from shm.errors import RingFull
from shm.words import Entry, Fault, Outcome

WAYPOINTS = 1_000_000
SPACING_NS = 1_000_000
CHUNK = 1000
GROWTH_KB = 4096


def wave(first: int, count: int) -> np.ndarray:
    """(count, 6, 3): a slow wave of all joints, at rest in its first and its last waypoint."""
    t = (first + np.arange(count)) * SPACING_NS * 1e-9
    w = 2 * np.pi * 50 / ((WAYPOINTS - 1) * SPACING_NS * 1e-9)
    one = 0.2 * np.stack([1 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)], axis=-1)
    return np.repeat(one[:, None, :], 6, axis=1)


def test_a_million_waypoints_in_flat_memory() -> None:
    """Seventeen minutes of motion in virtual time, through the real ring and the real cycle."""
    arm = VirtualArm.brought_up("mock")
    none = np.zeros((6, 3))
    arm.writer.announce(1)
    epoch = int(arm.memory["goals"]["epoch"])
    arm.writer.begin(
        1, start_ns=0, joint_mask=63, goal_time_s=0.4, entry=Entry(0), epoch=epoch, tolerances=none, consumed=0
    )
    begun_ns = arm.now_ns
    written, peak_kb = 0, 0
    rows = wave(0, CHUNK)
    while written < WAYPOINTS:
        consumed = arm.reader.setpoints_consumed()
        try:
            arm.writer.waypoint(1, written * SPACING_NS, 5, rows[written % CHUNK], consumed)
        except RingFull:
            arm.cycle()
            continue
        written += 1
        if written % CHUNK == 0 and written < WAYPOINTS:
            rows = wave(written, CHUNK)
        if written == WAYPOINTS // 10:
            peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while True:
        try:
            arm.writer.end(1, none, arm.reader.setpoints_consumed())
            break
        except RingFull:
            arm.cycle()
    assert arm.end_of(1) == Outcome.SUCCEEDED and arm.memory["fault"]["code"] == Fault.NONE
    assert (arm.now_ns - begun_ns) * 1e-9 < WAYPOINTS * SPACING_NS * 1e-9 + 1.0  # it never waited for waypoints
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kb < GROWTH_KB
    arm.close()
