"""An arm goes on by itself after a silence of all drives, where nothing at all speaks against it."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from observer import frames_sent, motion_frames
from virtual import VirtualArm

from rtloop.dialogues.healing import ENDED_WITHIN_NS, MOST_HEALED, WITHIN_NS
from shm.words import Answer, Event, Fault, Mode, Outcome, Request, Unreferenced
from sim.drives.zdt import ZdtDrive

ALL = range(6)


def drive_of(arm: VirtualArm, joint: int) -> ZdtDrive:
    assert arm.sim is not None
    drive = arm.sim.drives[joint]
    assert isinstance(drive, ZdtDrive)
    return drive


@pytest.fixture
def moving() -> Iterator[VirtualArm]:
    """An arm amid a goal, which may go on by itself."""
    arm = VirtualArm.amid("scale_1_0", 60)
    arm.heal_by_itself()
    yield arm
    arm.close()


def silence(arm: VirtualArm, seconds: float = 0.3, joints: range = ALL) -> None:
    """So many drives' plugs come loose for so long."""
    for joint in joints:
        drive_of(arm, joint).unplug(arm.now_ns)
    arm.cycles(round(seconds * 1e9 / arm.period_ns))
    for joint in joints:
        drive_of(arm, joint).plug_in(arm.now_ns)


def wait(arm: VirtualArm, seconds: float = 4.0) -> None:
    arm.cycles(round(seconds * 1e9 / arm.period_ns))


def healed(arm: VirtualArm) -> bool:
    """Whether the arm holds, and knows all its angles."""
    holds = arm.memory["mode"] == Mode.HOLDING and arm.memory["fault"]["code"] == Fault.NONE
    return bool(holds and np.all(arm.loop[0]["axes"]["reference"]["referenced"][:6]))


def still_faulted(arm: VirtualArm) -> bool:
    return bool(arm.memory["mode"] == Mode.FAULT and arm.memory["fault"]["code"] == Fault.STALE_READING)


@pytest.mark.parametrize("seconds", [0.12, 0.3, 0.9])
def test_the_goal_is_over_and_the_arm_holds_and_takes_the_next_one(moving: VirtualArm, seconds: float) -> None:
    silence(moving, seconds)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    assert moving.outcome(moving.goal) == Outcome.FAULT
    events = moving.state.record["events"][: int(moving.state.record["events_written"][0])]
    assert list(events["kind"]).count(Event.HEALED) == 1
    since = len(moving.sent)
    wait(moving, 0.5)
    assert not any(motion_frames(frames_sent(moving.sent[since:]), joint + 1, 0) for joint in ALL)
    assert moving.end_of(moving.send_shift(0.02)) == Outcome.SUCCEEDED


def test_a_stream_waits_for_a_resume(moving: VirtualArm) -> None:
    silence(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    assert moving.end_of(moving.send_shift(0.01, stream=True)) == Outcome.REFUSED_STREAM
    assert moving.end_of(moving.send_shift(0.01)) == Outcome.SUCCEEDED
    assert moving.end_of(moving.send_shift(0.01, stream=True)) == Outcome.REFUSED_STREAM
    moving.resume()
    assert moving.end_of(moving.send_shift(0.01, stream=True)) == Outcome.SUCCEEDED


def test_a_stream_goes_on_after_a_persons_clear(moving: VirtualArm) -> None:
    silence(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    moving.healing = None
    silence(moving, joints=range(1))
    moving.until(lambda: still_faulted(moving))
    wait(moving, 0.5)
    moving.clear_fault()
    assert moving.end_of(moving.send_shift(0.01, stream=True)) == Outcome.SUCCEEDED


def test_an_arm_that_a_person_holds_stays_held(moving: VirtualArm) -> None:
    moving.hold()
    wait(moving, 1.0)
    silence(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)
    assert moving.end_of(moving.send_shift(0.01)) == Outcome.REFUSED_HELD


def loses_power(arm: VirtualArm) -> None:
    drive_of(arm, 2).power_off(arm.now_ns)
    drive_of(arm, 2).power_on(arm.now_ns)


def loses_power_unseen(arm: VirtualArm) -> None:
    drive_of(arm, 2).power_flag = "absent"
    loses_power(arm)


def trips(arm: VirtualArm) -> None:
    drive_of(arm, 2).protect(arm.now_ns, "temperature")


def is_let_go(arm: VirtualArm) -> None:
    drive_of(arm, 2).disable(arm.now_ns)


def ends(arm: VirtualArm) -> None:
    arm.memory["motion"]["closing"] = 1


def is_not_referenced(arm: VirtualArm) -> None:
    arm.loop[0]["axes"][4]["reference"]["referenced"] = 0
    arm.loop[0]["axes"][4]["reference"]["unreferenced_reason"] = Unreferenced.MOVED


def refuses_its_mark(arm: VirtualArm) -> None:
    drive_of(arm, 2).unknown = frozenset((0x22,))


def has_no_mark(arm: VirtualArm) -> None:
    arm.marks[2] = None


@pytest.mark.parametrize(
    "what", [loses_power, loses_power_unseen, trips, is_let_go, ends, is_not_referenced, has_no_mark, refuses_its_mark]
)
def test_it_stays_in_its_fault_where_anything_else_has_happened(
    moving: VirtualArm, what: Callable[[VirtualArm], None]
) -> None:
    for joint in ALL:
        drive_of(moving, joint).unplug(moving.now_ns)
    moving.until(lambda: still_faulted(moving))
    what(moving)
    moving.cycles(20)
    for joint in ALL:
        drive_of(moving, joint).plug_in(moving.now_ns)
    wait(moving)
    assert still_faulted(moving)


def test_one_silent_drive_stays_a_fault(moving: VirtualArm) -> None:
    silence(moving, joints=range(2, 3))
    wait(moving)
    assert still_faulted(moving)


def test_a_joint_that_was_moved_meanwhile_stays_a_fault(moving: VirtualArm) -> None:
    """By a hand, or a load: it stands still, and elsewhere than it can have gone by itself."""
    for joint in ALL:
        drive_of(moving, joint).unplug(moving.now_ns)
    moving.until(lambda: still_faulted(moving))
    moving.loop[0]["axes"][3]["reference"]["lost_at_rad"] += 0.5
    moving.loop[0]["axes"][3]["commanded"]["position_rad"] += 0.5
    moving.loop[0]["axes"][3]["commanded"]["next_position_rad"] += 0.5
    for joint in ALL:
        drive_of(moving, joint).plug_in(moving.now_ns)
    wait(moving)
    assert still_faulted(moving)


def test_a_silence_that_lasts_stays_a_fault(moving: VirtualArm) -> None:
    silence(moving, ENDED_WITHIN_NS * 1e-9 + 0.2)
    wait(moving)
    assert still_faulted(moving)


def test_an_arm_whose_drives_are_not_known_to_brake_stays_in_its_fault() -> None:
    arm = VirtualArm.amid("scale_1_0", 60)
    arm.heal_by_itself(unlocked=False)
    silence(arm)
    wait(arm)
    assert still_faulted(arm)
    arm.close()


def test_the_third_time_in_a_minute_stays_a_fault_and_one_later_does_not(moving: VirtualArm) -> None:
    began_ns = moving.now_ns
    for _ in range(MOST_HEALED):
        silence(moving)
        moving.until(lambda: healed(moving), at_most_s=3.0)
        wait(moving, 1.0)
    silence(moving)
    wait(moving)
    assert still_faulted(moving)
    moving.healing, healing = None, moving.healing
    moving.clear_fault()
    moving.until(lambda: moving.now_ns > began_ns + WITHIN_NS + 2_000_000_000, at_most_s=70.0)
    moving.healing = healing
    silence(moving)
    moving.until(lambda: healed(moving), at_most_s=3.0)


def test_a_persons_clear_comes_first(moving: VirtualArm) -> None:
    silence(moving)
    wait(moving, 0.1)
    assert moving.ask(Request.CLEAR_FAULT) == Answer.DONE
    wait(moving)
    assert still_faulted(moving)
    assert moving.memory["dialogue"]["bring_up_asked"] == 1


def test_a_drive_that_is_let_go_as_it_is_brought_up_stays_limp(moving: VirtualArm) -> None:
    """Nobody has asked for its being enabled."""
    silence(moving)
    moving.until(lambda: moving.memory["mode"] == Mode.BRINGING_UP, at_most_s=3.0)
    drive_of(moving, 2).disable(moving.now_ns)
    wait(moving)
    assert (moving.memory["mode"], moving.memory["fault"]["code"]) == (Mode.FAULT, Fault.BRING_UP)
    assert not drive_of(moving, 2).enabled
    moving.healing = None
    moving.clear_fault()
    assert drive_of(moving, 2).enabled
