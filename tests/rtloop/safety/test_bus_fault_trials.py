"""A sample of the trials of bus faults (many: `make bus-trials`), and answers of every kind in any order."""

from collections.abc import Iterator
from functools import reduce
from operator import getitem

import numpy as np
import pytest
from bus_faults import FAULTS, BusFault
from bus_trials import TrialArm, run_trial
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from observer import command_violations, frames_sent, motion_frames, motion_violations, truth_of
from virtual import START_NS, VirtualArm

from rtloop.memory.link import RX_BYTES
from rtloop.wire import received
from shm.words import Fault, Mode, Outcome, Slowed, Unreferenced
from sim.faults import CountSlip, ReceiveStall, Silent, Stall, WrongValues


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_bus_fault_at_a_random_moment_of_a_random_goal(fault: BusFault) -> None:
    found = run_trial(fault, 7)
    assert found.violations == []
    assert found.outcome


# --- what single readings may and may not do


@pytest.fixture
def moving() -> Iterator[TrialArm]:
    arm = TrialArm.amid("scale_1_0", 60)
    yield arm
    arm.close()


def say(arm: VirtualArm, *lines: bytes) -> None:
    """Let the adapter say something now, beside what the drives say."""
    data = b"".join(line + b"\r" for line in lines)
    received.push(arm.loop[0]["buses"][0], arm.now_ns, np.frombuffer(data, np.uint8), len(data))


def position_line(arm: VirtualArm, joint: int, off_rad: float = 0.0) -> bytes:
    """The answer of a drive that stands `off_rad` from where it was last measured."""
    row, axis = arm.loop[0]["joints"][joint], arm.loop[0]["axes"][joint]
    counts = round(
        (float(axis["measured"]["position_rad"]) + off_rad + float(row["zero_rad"])) * float(row["reading_per_rad"])
    )
    return b"T%08X736%02X%08X6B" % (int(row["address"]) << 8, counts < 0, abs(counts))


def late_in_the_cycle(arm: VirtualArm, *lines: bytes) -> None:
    """One cycle in which these lines come after everything else."""
    arm.now_ns += arm.period_ns
    arm.listen(arm.now_ns)
    say(arm, *lines)
    arm.now_ns -= arm.period_ns
    arm.cycle()


def test_one_wrong_reading_of_any_size_is_no_fault() -> None:
    """Found by these trials: on a fast joint 0.11 to 0.22 rad were possible motion, and at once a following error."""
    arm = TrialArm.amid("large", 20)
    for off_rad in (0.06, 0.11, 0.2, 0.5, 3.0):
        for joint in range(6):
            late_in_the_cycle(arm, position_line(arm, joint, off_rad))
            arm.cycles(5)
    assert arm.memory["mode"] == Mode.EXECUTING
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    arm.close()


WITHIN_BELIEF_RAD = 0.04
"""Of a single wrong reading: motion might have brought the joint there."""


def test_one_wrong_reading_breaks_no_tolerance_of_any_kind() -> None:
    """Over one period 0.04 rad are 5 rad/s, and two readings later still 40 rad/s² of the smoothed acceleration."""
    arm = TrialArm.at_start_of("large")
    arm.goal = arm.play("large", tolerances=(0.03, 0.5, 5.0))
    arm.cycles(20)
    for joint in range(6):
        late_in_the_cycle(arm, position_line(arm, joint, WITHIN_BELIEF_RAD))
        arm.cycles(5)
    assert arm.end_of(arm.goal) == Outcome.SUCCEEDED
    arm.close()


def test_one_wrong_reading_does_not_lead_a_drive_astray() -> None:
    """The share of the error in a drive's speed waits for two readings: this one alone would be 20 rpm of joint2."""
    found = []
    for off_rad in (0.0, WITHIN_BELIEF_RAD):
        arm = TrialArm.amid("scale_1_0", 60)
        since = len(arm.sent)
        late_in_the_cycle(arm, position_line(arm, 1, off_rad))
        told = [frame.data for frame in frames_sent(arm.sent[since:]) if frame.drive == 2 and frame.data[0] == 0xFD]
        found.append(int.from_bytes(told[0][2:4], "big"))
        arm.close()
    assert abs(found[1] - found[0]) <= 3


@pytest.mark.parametrize("share", [1.2, 1.8, 2.5])
def test_a_jump_that_grows_possible_with_time_is_still_a_jump(moving: TrialArm, share: float) -> None:
    """Found by these trials: what one period made impossible was believed when the second reading said it again."""
    config = moving.arm.joints[5]
    once_rad = 0.05 + 2.0 * config.max_velocity_rad_s * moving.period_ns * 1e-9
    moving.sim.inject(CountSlip(config.name, 0.0, deg=np.degrees(share * once_rad)), since_ns=moving.now_ns)
    moving.cycles(4)
    assert (moving.memory["fault"]["code"], moving.memory["fault"]["joint"]) == (Fault.REFERENCE_LOST, 5)
    assert moving.loop[0]["axes"][5]["reference"]["referenced"] == 0
    assert moving.loop[0]["axes"][5]["reference"]["unreferenced_reason"] == Unreferenced.POSITION_JUMP


def test_nonsense_is_no_answer(moving: TrialArm) -> None:
    """Found by these trials: readings that never agreed were put aside for ever, while the arm moved on blindly."""
    moving.sim.inject(WrongValues(1.0, 300.0, joint="joint1"), since_ns=moving.now_ns)
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert moving.memory["fault"]["joint"] == 0
    assert moving.loop[0]["axes"][0]["reference"]["referenced"] == 0


def test_a_drive_in_doubt_is_not_led(moving: TrialArm) -> None:
    """The reading that does not fit may be the first word of a drive that was switched off and on."""
    since = len(moving.sent)
    late_in_the_cycle(moving, position_line(moving, 1, 1.0))
    assert motion_frames(frames_sent(moving.sent[since:]), 2, 0) == 0
    moving.cycle()
    assert motion_frames(frames_sent(moving.sent[since:]), 2, 0) == 2  # both packets of one command


def test_a_silent_drive_is_led_no_longer_than_the_arm_runs_on(moving: TrialArm) -> None:
    """What is sent into the void arrives when the way is free again, and then nobody wants it any more."""
    moving.sim.inject(Silent("joint2", 0.0), since_ns=moving.now_ns)
    moving.until(lambda: moving.is_slowed(Slowed.LATE_DRIVE))
    since = len(moving.sent)
    moving.cycles(60)
    frames = frames_sent(moving.sent[since - 1 :])
    assert motion_frames(frames, 2, 0) == 0
    assert motion_frames(frames, 1, 0) > 3


def test_a_drive_that_is_heard_again_gets_its_stop_command(moving: TrialArm) -> None:
    moving.sim.inject(Silent("joint2", 0.0, until_s=0.9), since_ns=moving.now_ns)
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT)
    moving.cycles(70)  # the stop commands it did not hear
    since = len(moving.sent)
    moving.cycles(60)
    frames = frames_sent(moving.sent[since:])
    assert any(frame.drive == 2 and frame.data[:2] == b"\xfe\x98" for frame in frames)
    assert motion_frames(frames, 2, 0) == 0


def test_a_burst_of_old_answers_is_no_jump_and_no_following_error(moving: TrialArm) -> None:
    """An adapter that stalls says everything it kept at once: seven positions of a joint within a millisecond."""
    moving.sim.inject(ReceiveStall(0.0, stall_s=0.06, depth=200), since_ns=moving.now_ns)
    assert moving.end_of(moving.goal) == Outcome.SUCCEEDED


def leaves(dtype: np.dtype, *above: str) -> Iterator[tuple[str, ...]]:
    """The names that lead to each field of a record that is none itself."""
    for name in dtype.names or ():
        field = dtype[name].base
        yield from leaves(field, *above, name) if field.names else [(*above, name)]


def test_the_same_answer_again_changes_nothing(moving: TrialArm) -> None:
    """Its twin hears every answer once: whatever is known of the joints, and every byte to them, is the same.

    But for one word, which counts the answers that nobody asked for: those said again.
    """
    twin = TrialArm.amid("scale_1_0", 60)
    for cycle in range(20):
        again = [position_line(moving, joint) for joint in range(6) for _ in range(5)]
        say(moving, *again)  # at the beginning of the cycle, before the drives answer
        moving.cycle()
        twin.cycle()
        known, known_to_twin = moving.loop[0]["axes"], twin.loop[0]["axes"]
        different = [
            path[-1]
            for path in leaves(known.dtype)
            if not np.array_equal(
                *(reduce(getitem, path, axes) for axes in (known, known_to_twin)),
                equal_nan=reduce(getitem, path, known).dtype.kind == "f",
            )
        ]
        assert different == ["reports"]
        assert (known["reply"]["reports"] - known_to_twin["reply"]["reports"])[:6].tolist() == [5 * (cycle + 1)] * 6
    assert moving.sent == twin.sent
    assert moving.memory["mode"] == Mode.EXECUTING
    twin.close()


def test_babble_fills_the_ring_and_the_cycle_goes_on(moving: TrialArm) -> None:
    """The work of a cycle is bounded by the receive ring, whatever is pushed into it."""
    line = position_line(moving, 5)
    noise = (line + b"\r") * (2 * RX_BYTES // len(line))
    received.push(moving.loop[0]["buses"][0], moving.now_ns, np.frombuffer(noise, np.uint8), len(noise))
    moving.cycles(2)
    assert moving.state.record["counters"]["receive_overflows"] > 0
    assert moving.end_of(moving.goal) == Outcome.SUCCEEDED


def test_an_answer_of_another_function_is_no_position(moving: TrialArm) -> None:
    """33, 34 and 37 have the length of 36, and a sign is 00 or 01."""
    before = moving.loop[0]["axes"][0]["measured"]["readings"]
    line = position_line(moving, 0, 0.02)
    moving.sim.inject(Silent("joint1", 0.0), since_ns=moving.now_ns)
    moving.cycle()
    for wrong in (line.replace(b"736", b"733"), line.replace(b"736", b"737"), line[:12] + b"02" + line[14:]):
        say(moving, wrong)
        moving.cycle()
    assert moving.loop[0]["axes"][0]["measured"]["readings"] <= before + 1


# --- any sequence of answers

_EVENTS = st.one_of(
    st.tuples(st.just("cycle"), st.integers(1, 6)),
    st.tuples(st.just("again"), st.integers(0, 5)),
    st.tuples(st.just("old"), st.integers(0, 40)),
    st.tuples(st.just("off"), st.integers(0, 5), st.floats(-4.0, 4.0)),
    st.tuples(st.just("status"), st.integers(0, 5), st.integers(0, 255)),
    st.tuples(st.just("bytes"), st.binary(max_size=40)),
    st.tuples(st.just("frame"), st.integers(0, 0x7FF), st.binary(max_size=8)),
)


@settings(max_examples=examples(10), deadline=None, suppress_health_check=list(HealthCheck))
@given(events=st.lists(_EVENTS, min_size=3, max_size=40), start=st.integers(5, 120))
def test_no_sequence_of_answers_moves_an_arm_beyond_its_limits(events: list, start: int) -> None:
    """True motion and command bytes stay inside the limits, time runs forwards, and every goal ends."""
    arm = TrialArm.amid("scale_1_0", start)
    spoken: list[bytes] = [position_line(arm, joint) for joint in range(6)]
    measured_ns = arm.loop[0]["axes"]["measured"]["time_ns"][:6].copy()
    for kind, *values in events:
        if kind == "cycle":
            arm.cycles(values[0])
            spoken += [position_line(arm, joint) for joint in range(6)]
        elif kind == "again":
            say(arm, *[position_line(arm, values[0])] * 3)
        elif kind == "old":
            say(arm, spoken[-1 - values[0] % len(spoken)])
        elif kind == "off":
            late_in_the_cycle(arm, position_line(arm, values[0], values[1]))
        elif kind == "status":
            say(arm, b"T%08X33A%02X6B" % ((values[0] + 1) << 8, values[1]))
        elif kind == "bytes":
            say(arm, values[0])
        else:
            say(arm, b"T%08X%d%s" % (values[0], len(values[1]), values[1].hex().upper().encode()))
        now_ns = arm.loop[0]["axes"]["measured"]["time_ns"][:6]
        assert np.all(now_ns >= measured_ns)
        measured_ns = now_ns.copy()
    arm.until(lambda: arm.outcome(arm.goal) != Outcome.NONE and arm.running_goal == 0)
    arm.cycles(40)
    frames = frames_sent(arm.sent)
    stopped = {frame.drive for frame in frames if frame.data[:2] == b"\xfe\x98"}
    thrown = {joint.name for joint in arm.arm.joints if joint.drive.address in stopped}
    assert motion_violations(arm.arm, truth_of(arm.sim), START_NS, arm.now_ns, thrown=thrown) == []
    assert command_violations(arm.arm, frames) == []
    for drive in stopped:
        first_ns = min(f.time_ns for f in frames if f.drive == drive and f.data[:2] == b"\xfe\x98")
        assert motion_frames(frames, drive, first_ns - 1) == 0
    assert np.all(np.abs(arm.loop[0]["axes"]["measured"]["velocity_rad_s"][:6]) < 1e3)
    arm.close()


def test_once_the_arm_stands_in_a_fault_nobody_goes_on_or_pushes(moving: TrialArm) -> None:
    """Found by these trials: a held joint was pushed on, and one that lagged crept to its last target."""
    moving.sim.inject(Stall("joint1", 0.0), since_ns=moving.now_ns)
    moving.until(lambda: moving.memory["mode"] == Mode.FAULT)
    moving.until(lambda: bool(moving.memory["motion"]["rested"]))
    moving.cycles(6)
    moving.sim.run_until(moving.sim.now_ns + 1_000_000)
    drive = moving.sim.drives[0]
    drive.advance(moving.sim.now_ns)
    assert abs(drive.target_counts - drive.position_counts) <= 1
    assert not drive.moving
