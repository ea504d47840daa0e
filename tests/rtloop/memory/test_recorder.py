"""The flight recorder in the cycle: it keeps what the snapshot said, cycle by cycle, and what the bus carried."""

import numpy as np
import pytest
from virtual import VirtualArm

from rtloop.wire import received
from rtloop.wire.slcan import BEL
from shm import layout
from shm.recording import EXTENDED, IDENTIFIER_MASK, LENGTH_MASK, LENGTH_SHIFT, SENT, read_recording
from shm.words import Fault, Mode, Outcome, Slowed
from sim.faults import PowerLoss, Silent

GOAL = "small"


@pytest.fixture
def arm():
    made = VirtualArm.at_start_of(GOAL)
    yield made
    made.close()


def test_every_cycle_of_a_goal_is_kept_as_its_snapshot_said(arm):
    said = []
    goal = arm.play(GOAL)
    while arm.outcome(goal) == Outcome.NONE:
        arm.cycle()
        said.append(arm.reader.snapshot())
    found = read_recording(arm.state)
    assert found.lost == 0
    assert (found.arm, found.joints) == ("episode1", tuple(joint.name for joint in arm.arm.joints))
    assert found.records["number"].tolist() == list(range(int(arm.memory["timing"]["cycle"])))
    kept = found.records[-len(said) :]
    for name in layout.Snapshot.dtype.names[layout.Snapshot.dtype.names.index("cycle") : -1]:
        assert kept[name].tolist() == [one[name] for one in said]
    for record, snapshot in zip(kept, said, strict=True):
        assert record["joints"].tobytes() == snapshot["joints"][: len(found.joints)].tobytes()
    assert kept["goal_id"].max() == goal
    assert np.all(np.diff(kept["frames_sent"]) > 0)
    assert kept["frames_received"][-1] == arm.state.record["counters"]["frames_received"]
    assert kept["heartbeat_ns"].tolist() == kept["monotonic_ns"].tolist()


def test_every_frame_is_kept_in_both_directions(arm):
    goal = arm.play(GOAL)
    arm.end_of(goal)
    frames = read_recording(arm.state).frames
    sent = frames[frames["head"] & SENT != 0]
    lines = [line for _, data in arm.sent for line in data.split(b"\r") if line]
    told = [
        f"T{head & IDENTIFIER_MASK:08X}{head >> LENGTH_SHIFT & LENGTH_MASK}"
        + int(data).to_bytes(8, "little", signed=True)[: head >> LENGTH_SHIFT & LENGTH_MASK].hex().upper()
        for head, data in zip(sent["head"].tolist(), sent["data"].tolist(), strict=True)
    ]
    assert told == [line.decode() for line in lines]
    assert len(frames) - len(sent) == arm.state.record["counters"]["frames_received"]
    assert np.all(frames["head"] & EXTENDED != 0)
    assert np.all(np.diff(sent["monotonic_ns"]) >= 0)
    assert set((frames["head"] & IDENTIFIER_MASK) >> 8) == set(range(1, 7))


def test_what_led_to_a_fault_is_kept_with_what_the_arm_did_then(arm):
    goal = arm.play(GOAL)
    arm.until(lambda: arm.running_goal == goal)
    arm.cycles(20)
    arm.sim.inject(PowerLoss("joint2", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE)
    arm.cycles(60)
    records = read_recording(arm.state).records
    at = int(np.flatnonzero(records["fault"])[0])
    first = records[at]
    assert (first["fault"], first["fault_joint"]) == (arm.memory["fault"]["code"], 1)
    assert first["monotonic_ns"] == first["fault_ns"] == arm.memory["fault"]["latched_ns"]
    assert records["mode"][at - 1] == Mode.EXECUTING and records["mode"][-1] == Mode.FAULT
    assert np.all(records["slowed"][at:] & Slowed.OWN_BRAKE)
    assert not records["joints"]["commanded_velocity_rad_s"][-1].any()


@pytest.mark.parametrize(("ask", "slowed"), [("hold", Slowed.HELD), ("cancel_all", Slowed(0)), ("stop", Slowed(0))])
def test_why_the_arm_slows_down_is_kept(arm, ask, slowed):
    goal = arm.play(GOAL)
    arm.until(lambda: arm.running_goal == goal)
    arm.cycles(5)
    getattr(arm.writer, ask)()
    arm.cycles(3)
    last = read_recording(arm.state).records[-1]
    assert last["slowed"] == slowed
    endings = {"hold": Outcome.NONE, "cancel_all": Outcome.CANCELED, "stop": Outcome.STOPPED}
    assert last["ending"] == endings[ask]


def test_signs_before_a_fault_are_kept(arm):
    """A garbled line, then a drive that is late: no fault yet, and both can be seen."""
    goal = arm.play(GOAL)
    arm.until(lambda: arm.running_goal == goal)
    arm.cycles(10)
    received.push(arm.loop[0]["buses"][0], arm.now_ns, np.array([BEL], np.uint8), 1)
    arm.cycle()
    arm.sim.inject(Silent("joint2", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.is_slowed(Slowed.LATE_DRIVE))
    records = read_recording(arm.state).records
    assert records["fault"][-1] == Fault.NONE
    garbled, late = (int(np.flatnonzero(np.diff(records[name]))[-1]) for name in ("wire_errors", "stale_reads"))
    assert garbled < late
    assert records["slowed"][-1] == Slowed.LATE_DRIVE
    ages_ns = records["monotonic_ns"][-1] - records["joints"]["measured_ns"][-1]
    assert int(np.argmax(ages_ns)) == 1
