"""Homing by collision, and joints that stand where a person says, in virtual time on the simulated drives."""

import dataclasses
import math

import numpy as np
import pytest
from observer import command_violations, frames_sent, motion_after, motion_frames, truth_of
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.dialogues.referencing import referencing_asked_for
from rtloop.kept.reference_store import NotSaved
from rtloop.service.port import HOME_ALL
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim.faults import PowerLoss, Protection, Silent

ALL = 0b111111
JOINT2 = 0b000010
NEAR_STOPS_DEG = (-176.0, -86.0, -79.0, -25.0, -105.0, -20.0)
WITHIN_RAD = 0.002


def new_arm(start_deg=NEAR_STOPS_DEG, *, overrides=None, **options):
    arm = VirtualArm.brought_up(
        load_arm("episode1", overrides=overrides or {}), start_rad=np.radians(start_deg), **options
    )
    return arm


@pytest.fixture
def arm():
    found = new_arm()
    yield found
    found.close()


def after_power_loss(arm, joint="joint2"):
    """One drive was off for a second; the fault is cleared, the joint has no reference."""
    arm.sim.inject(PowerLoss(joint, 0.0, off_s=1.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(240)
    assert arm.clear_fault().failure is None
    assert arm.memory["mode"] == Mode.HOLDING


def true_rad(arm, joint):
    return arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)


def test_a_drive_that_lost_power_is_homed_and_obeys_again(arm):
    after_power_loss(arm)
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.POWER_LOST
    since = len(arm.sent)
    others = {name: truth for name, truth in truth_of(arm.sim).items() if name != "joint2"}
    began_ns = arm.now_ns
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert arm.memory["mode"] == Mode.REFERENCING
    assert arm.reference().failure is None
    config, axis = arm.arm.joints[1], arm.loop[0]["axes"][1]
    assert (arm.memory["mode"], axis["reference"]["referenced"], arm.memory["fault"]["code"]) == (
        Mode.HOLDING,
        1,
        Fault.NONE,
    )
    assert abs(true_rad(arm, 1) - config.lower_rad) < WITHIN_RAD
    assert abs(axis["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD
    assert not arm.sim.drives[1].power_lost
    assert 120_000 < arm.sim.drives[1].homing.timeout_ms <= 121_000
    assert arm.sim.drives[1]._homing_flash.timeout_ms != arm.sim.drives[1].homing.timeout_ms
    assert motion_frames(frames_sent(arm.sent[since:]), 2, 0) == 0
    others = {name: truth for name, truth in truth_of(arm.sim).items() if name in others}
    assert motion_after(others, began_ns, arm.now_ns) == []
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    assert command_violations(arm.arm, frames_sent(arm.sent)) == []
    assert abs(axis["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD


def test_a_whole_arm_is_homed_in_its_order():
    arm = new_arm(overrides={"homing": {"order": ["joint3", "joint1", "joint2", "joint5", "joint6", "joint4"]}})
    seen = []

    def note():
        joint = int(arm.reader.snapshot()["referencing_joint"])
        if joint >= 0 and joint not in seen:
            seen.append(joint)

    assert arm.ask(Request.HOME) == Answer.DONE
    assert arm.reference(each_cycle=note).failure is None
    assert seen == [2, 0, 1, 4, 5, 3]
    assert arm.reader.snapshot()["referencing_joint"] == -1
    for joint, config in enumerate(arm.arm.joints):
        assert abs(true_rad(arm, joint) - config.lower_rad) < WITHIN_RAD
        assert arm.loop[0]["axes"][joint]["reference"]["referenced"] == 1
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()


@pytest.mark.parametrize("ask", ["stop", "hold"])
@pytest.mark.parametrize("after_cycles", [30, 60])
def test_a_homing_run_is_ended_at_once_whenever_somebody_asks(ask, after_cycles):
    arm = new_arm((0.0,) * 6)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    cycles = []

    def stop():
        cycles.append(arm.now_ns)
        if len(cycles) == after_cycles:
            getattr(arm.writer, ask)()

    assert arm.reference(each_cycle=stop, at_most_s=3.0).failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.NOT_HOMED
    ended_ns = arm.now_ns
    arm.cycles(60)
    assert motion_after(truth_of(arm.sim), ended_ns, arm.now_ns) == []
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.REFUSED_HELD
    arm.resume()
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.REFUSED_UNREFERENCED
    # nobody knows whether its drive has just set its count anew
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.nan) == Answer.REFUSED_VALUE
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=true_rad(arm, 1)) == Answer.DONE
    assert arm.reference().failure is None
    assert abs(arm.loop[0]["axes"][1]["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()


def test_a_ros_process_that_begins_amid_a_homing_run_leaves_it_alone(arm):
    """It cancels what goals its predecessor has left, whatever goes on."""
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    cycles = []

    def begin():
        cycles.append(arm.now_ns)
        if len(cycles) == 20:
            arm.writer.cancel_all()

    assert arm.reference(each_cycle=begin).failure is None
    assert len(cycles) > 30
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 1
    assert abs(true_rad(arm, 1) - arm.arm.joints[1].lower_rad) < WITHIN_RAD


@pytest.mark.parametrize("mask", [JOINT2, ALL])
def test_a_fault_of_another_drive_ends_a_homing_run(mask):
    """Whether or not its own turn is still to come."""
    arm = new_arm((0.0,) * 6, overrides={"homing": {"order": ["joint2", *(f"joint{n}" for n in (1, 3, 4, 5, 6))]}})
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    assert arm.ask(Request.HOME, joint_mask=mask) == Answer.DONE
    arm.sim.inject(Silent("joint5", 0.5), since_ns=arm.now_ns)
    arm.reference(at_most_s=3.0)
    assert (arm.memory["mode"], arm.memory["fault"]["code"]) == (Mode.FAULT, Fault.STALE_READING)
    assert not arm.sim.drives[1].homing_now
    ended_ns = arm.now_ns
    arm.cycles(60)
    assert motion_after(truth_of(arm.sim), ended_ns, arm.now_ns) == []
    arm.close()


def test_a_stop_that_is_not_found_in_time_is_a_fault():
    arm = new_arm((0.0,) * 6, overrides={"homing": {"timeout_s": 2.0}})
    homing = arm.sim.drives[1].homing
    arm.sim.drives[1].homing = type(homing)(timeout_ms=homing.timeout_ms)  # which is its mark
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    failure = arm.reference(at_most_s=6.0).failure
    assert "joint2 has not found its homing stop within 2 s" in str(failure)
    assert (arm.memory["mode"], arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (
        Mode.FAULT,
        Fault.HOMING,
        1,
    )
    ended_ns = arm.now_ns
    assert arm.clear_fault().failure is None
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.NOT_HOMED
    assert motion_after(truth_of(arm.sim), ended_ns, arm.now_ns) == []
    arm.close()


def test_a_run_that_ends_away_from_the_stop_is_no_reference(arm, monkeypatch):
    """The count must be zero afterwards, whatever the flags say."""
    after_power_loss(arm)
    monkeypatch.setattr(type(arm.sim.drives[1]), "_home_found", lambda drive: drive._hold())
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert "so it has not found its stop" in str(arm.reference().failure)
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0


def test_a_drive_in_protection_is_not_homed(arm):
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    arm.sim.inject(Protection("joint2", 0.0), since_ns=arm.now_ns)
    arm.reference()
    assert arm.memory["fault"]["code"] in (Fault.DRIVE_FAULT, Fault.HOMING)  # whoever sees it first
    assert not arm.sim.drives[1].homing_now


@pytest.mark.parametrize("said_deg", [-86.0, 20.0])
def test_a_joint_is_where_a_person_says(arm, said_deg):
    """The drive counts from where power came back; the person knows better, and answers for it."""
    after_power_loss(arm)
    stands_rad = true_rad(arm, 1)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.radians(said_deg)) == Answer.DONE
    assert arm.reference().failure is None
    axis = arm.loop[0]["axes"][1]
    assert (arm.memory["mode"], axis["reference"]["referenced"]) == (Mode.HOLDING, 1)
    assert abs(axis["measured"]["position_rad"] - math.radians(said_deg)) < WITHIN_RAD
    assert true_rad(arm, 1) == stands_rad
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    moved_rad = true_rad(arm, 1) - stands_rad
    assert abs(moved_rad - 0.05) < WITHIN_RAD


def test_what_a_person_said_outlives_a_clear_but_not_the_next_loss_of_power(arm):
    after_power_loss(arm)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.radians(-86.0)) == Answer.DONE
    assert arm.reference().failure is None
    arm.sim.inject(Protection("joint4", 0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    assert arm.clear_fault().failure is None
    axis = arm.loop[0]["axes"][1]
    assert axis["reference"]["referenced"] == 1
    assert abs(axis["measured"]["position_rad"] - math.radians(-86.0)) < WITHIN_RAD
    after_power_loss(arm)
    assert axis["reference"]["referenced"] == 0


def test_a_count_from_nowhere_cannot_be_believed(arm):
    after_power_loss(arm)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.nan) == Answer.REFUSED_VALUE
    assert arm.memory["mode"] == Mode.HOLDING


@pytest.mark.parametrize("value", [math.radians(-90.2), math.radians(91.0), math.inf, -math.inf])
def test_no_joint_stands_outside_its_limits(arm, value):
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=value) == Answer.REFUSED_VALUE


@pytest.mark.parametrize("mask", [-1, 1 << 6, ALL | 1 << 6, -(2**63), 2**62])
@pytest.mark.parametrize("kind", [Request.HOME, Request.REFERENCE])
def test_joints_that_the_arm_does_not_have_are_refused(arm, mask, kind):
    assert arm.ask(kind, joint_mask=mask) == Answer.REFUSED_VALUE
    assert arm.memory["mode"] == Mode.HOLDING


def test_a_moving_arm_is_not_homed(arm):
    goal = arm.play("large")
    arm.cycles(3)
    joints = np.zeros((2, 6, 3))
    joints[:, :, 0] = arm.loop[0]["axes"]["commanded"]["position_rad"][:6]
    joints[1, :, 0] += 0.1
    goal = arm.send_goal(np.array([0, 2_000_000_000]), joints)
    arm.until(lambda: arm.memory["mode"] == Mode.EXECUTING)
    assert arm.ask(Request.HOME, joint_mask=ALL) == Answer.REFUSED_MOVING
    assert arm.end_of(goal) == Outcome.SUCCEEDED


def test_nothing_else_is_begun_while_a_joint_is_homed():
    arm = new_arm((0.0,) * 6)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    for kind in (Request.HOME, Request.REFERENCE):
        assert arm.ask(kind, joint_mask=1) == Answer.REFUSED_MODE
    for kind in (Request.FREE, Request.DISABLE, Request.ENABLE, Request.CLEAR_FAULT):
        assert arm.ask(kind) == Answer.REFUSED_MODE
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.REFUSED_MODE
    arm.close()


def test_a_pose_is_due_after_homing_at_the_start_until_somebody_asks_for_something():
    def homed_at_the_start():
        arm = new_arm()
        arm.port.post(HOME_ALL)
        arm.cycles(2)
        assert arm.memory["mode"] == Mode.REFERENCING
        assert arm.reference().failure is None
        assert (arm.memory["mode"], arm.reader.snapshot()["pose_due"]) == (Mode.HOLDING, 1)
        return arm

    for kind in ("hold", "stop", Request.HOME, Request.FREE, Request.REFERENCE):
        arm = homed_at_the_start()
        arm.scale(0.5)
        arm.cancel_all()  # as a ROS process does when it begins
        assert arm.reader.snapshot()["pose_due"] == 1
        if isinstance(kind, Request):
            arm.ask(kind)
        else:
            getattr(arm, kind)()
        arm.cycles(1)
        assert arm.reader.snapshot()["pose_due"] == 0
        arm.close()
    arm = homed_at_the_start()
    until_ns = int(arm.memory["dialogue"]["pose_due_ns"])
    assert 119e9 < until_ns - arm.now_ns <= 120e9
    arm.cycles(round(1e9 / arm.period_ns))
    assert int(arm.memory["dialogue"]["pose_due_ns"]) == until_ns and arm.reader.snapshot()["pose_due"] == 1
    arm.memory["dialogue"]["pose_due_ns"] = arm.now_ns + 1_000_000_000  # as if all but the last second had passed
    began_ns = arm.now_ns
    arm.until(lambda: arm.reader.snapshot()["pose_due"] == 0, at_most_s=2.0)
    assert arm.now_ns - began_ns == pytest.approx(1e9, abs=2 * arm.period_ns)
    arm.close()
    arm = homed_at_the_start()
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    assert arm.reader.snapshot()["pose_due"] == 0
    arm.close()
    arm = new_arm()
    assert arm.ask(Request.HOME) == Answer.DONE  # by hand: nobody expects the arm to go anywhere afterwards
    assert arm.reference().failure is None
    assert arm.reader.snapshot()["pose_due"] == 0
    arm.close()


def test_joints_without_drives_are_where_they_are_commanded():
    arm = VirtualArm.brought_up(load_arm("mock"))
    here = arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy()
    assert arm.ask(Request.HOME, joint_mask=ALL) == Answer.DONE
    assert arm.reference().failure is None
    assert np.array_equal(arm.loop[0]["axes"]["commanded"]["position_rad"][:6], here)
    assert arm.loop[0]["axes"]["reference"]["referenced"][:6].all()
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()


# --- what a review found


def garbled_once(arm, joint, after_reads):
    """One answer to 3B, of a drive that homes, says that it does not."""
    drive, reads = arm.sim.drives[joint], []
    honest = drive._reads[0x3B]

    def answer():
        reads.append(drive.homing_now)
        if sum(reads) == after_reads and drive.homing_now:
            return bytes((0x3B, drive.homing_byte & ~0x04))
        return honest()

    drive._reads[0x3B] = answer


def without_command(arm, code, times):
    """The wire loses a command so many times; how often it was said."""
    said = []
    honest = arm.write

    def write(data):
        if code in data:
            said.append(data)
            if len(said) <= times:
                arm.taken(0)
                return
        honest(data)

    arm.write = write
    return said


@pytest.mark.parametrize("times", [1, 3, 1000])
def test_a_run_that_was_never_begun_is_no_reference(times):
    """A drive that lost power counts 0 where it stands: not homing, not failed, at 0."""
    arm = new_arm((0.0, -80.0, 0.0, 0.0, 0.0, 0.0))
    after_power_loss(arm)
    without_command(arm, b"9A02006B", times)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    failure = arm.reference().failure
    axis = arm.loop[0]["axes"][1]
    if times == 1000:
        assert "does not begin its homing run" in str(failure)
        assert (axis["reference"]["referenced"], arm.sim.drives[1].power_lost) == (0, True)
    else:
        assert failure is None
        assert abs(axis["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD
    arm.close()


@pytest.mark.parametrize("after_reads", [1, 2, 3, 4, 40])
@pytest.mark.parametrize("acknowledge", [False, True])
def test_one_garbled_answer_changes_nothing(after_reads, acknowledge):
    overrides = {"bus": {"acknowledge": acknowledge}, "control": {"rate_hz": 100.0}}
    arm = new_arm((0.0, -75.0, 0.0, 0.0, 0.0, 0.0), overrides=overrides)
    after_power_loss(arm)
    garbled_once(arm, 1, after_reads)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert arm.reference().failure is None
    assert not arm.sim.drives[1].homing_now
    assert abs(arm.loop[0]["axes"][1]["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD
    assert abs(true_rad(arm, 1) - arm.arm.joints[1].lower_rad) < WITHIN_RAD
    arm.close()


def test_a_drive_that_lets_go_at_its_stop_is_not_homed():
    arm = new_arm((0.0,) * 6)
    drive = arm.sim.drives[1]
    found = drive._home_found

    def let_go():
        found()
        drive.enabled = False

    drive._home_found = let_go
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert "is not enabled after its homing run" in str(arm.reference().failure)
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    arm.close()


@pytest.mark.parametrize("power_was_lost", [False, True])
@pytest.mark.parametrize("at_s", [0.3, 1.0, 1.5])
def test_a_drive_that_reboots_amid_its_run_is_not_homed(power_was_lost, at_s):
    """It counts 0 where it stands, as one does that has met its stop."""
    arm = new_arm((0.0, -70.0, 0.0, 0.0, 0.0, 0.0))
    if power_was_lost:
        after_power_loss(arm)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    arm.sim.inject(PowerLoss("joint2", at_s, off_s=0.15), since_ns=arm.now_ns)
    assert arm.reference().failure is not None
    axis = arm.loop[0]["axes"][1]
    assert (arm.memory["fault"]["code"], axis["reference"]["referenced"], arm.sim.drives[1].power_lost) == (
        Fault.HOMING,
        0,
        True,
    )
    arm.close()


def test_a_drive_that_stops_answering_amid_its_run_is_told_to_end_it():
    arm = new_arm((0.0,) * 6)
    drive = arm.sim.drives[1]
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    honest, began_ns = drive._reads[0x3B], arm.now_ns

    def garbled():
        return honest() if not drive.homing_now or arm.now_ns < began_ns + 10**9 else b"\x3c\x00"

    drive._reads[0x3B] = garbled
    assert "homing state" in str(arm.reference(at_most_s=10.0).failure)
    assert not drive.homing_now
    arm.close()


@pytest.mark.parametrize("blocked_deg", np.linspace(-30.0, -29.0, 12).tolist())
def test_a_person_in_the_way_is_not_the_stop(blocked_deg):
    """Where the joint's angle was known, what it meets far from its stop is something else, at whatever moment."""
    arm = new_arm((0.0, -20.0, 0.0, 0.0, 0.0, 0.0))
    drive, config = arm.sim.drives[1], arm.arm.joints[1]
    drive.shaft.low += drive._grains(round(math.radians(blocked_deg + 90.0) * config.command_pulses_per_rad))
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert "joint2 met something at -" in str(arm.reference().failure)
    assert (arm.loop[0]["axes"][1]["reference"]["referenced"], arm.lost) == (0, {1: Unreferenced.NOT_HOMED})
    arm.close()


def test_bring_up_ends_a_run_that_nobody_watches():
    """The control process was killed amid it, and another one starts."""
    arm = new_arm((0.0,) * 6)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    talk = referencing_asked_for(
        arm.arm, arm.loop, arm.port, arm.now_ns, arm.told.append, arm.lost.__setitem__, arm.marks
    )
    for _ in range(150):
        talk.poll(arm.now_ns)
        arm.cycle()
    assert arm.sim.drives[1].homing_now
    after = arm.next_process()
    assert after.bring_up().failure is None
    assert not after.sim.drives[1].homing_now
    axis = after.loop[0]["axes"][1]
    assert (axis["reference"]["referenced"], axis["reference"]["unreferenced_reason"]) == (0, Unreferenced.NOT_HOMED)
    after.close()
    arm.close()


def test_a_homing_run_takes_no_reference_before_its_turn():
    arm = new_arm((0.0,) * 6)
    assert arm.ask(Request.HOME) == Answer.DONE
    cycles = []

    def stop():
        cycles.append(arm.now_ns)
        if len(cycles) == 60:
            arm.writer.stop()

    arm.reference(each_cycle=stop)
    assert arm.loop[0]["axes"]["reference"]["referenced"][:6].tolist() == [0, 1, 1, 1, 1, 1]
    arm.close()


def test_a_lost_flag_is_seen_whatever_the_reason_was_called(arm):
    """SILENT at first; power was lost after the clear. Its count would be believed without the drive's own word."""
    arm.marks[1] = None  # it proves nothing
    arm.sim.inject(Silent("joint2", 0.0, until_s=1.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(240)
    assert arm.ask(Request.CLEAR_FAULT) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up().failure is None
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.SILENT
    arm.sim.inject(PowerLoss("joint2", 0.0, off_s=0.1), since_ns=arm.now_ns)
    arm.cycles(60)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.nan) == Answer.DONE
    arm.reference()
    axis = arm.loop[0]["axes"][1]
    assert (axis["reference"]["referenced"], axis["reference"]["unreferenced_reason"]) == (0, Unreferenced.POWER_LOST)


@pytest.mark.parametrize("at_s", np.arange(0.0, 0.3, 0.03).tolist())
def test_power_lost_amid_a_bring_up_is_noticed_although_the_flag_says_nothing_new(at_s):
    arm = new_arm((0.0, 20.0, 0.0, 0.0, 0.0, 0.0))
    after_power_loss(arm)
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.radians(20.0)) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.end_of(arm.send_shift(0.3), at_most_s=8.0) == Outcome.SUCCEEDED  # away from where the drive counts from
    arm.sim.inject(Protection("joint4", 0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(60)
    assert arm.ask(Request.CLEAR_FAULT) == Answer.DONE
    arm.memory["dialogue"]["bring_up_asked"] = 0
    arm.sim.inject(PowerLoss("joint2", at_s, off_s=0.09), since_ns=arm.now_ns)
    arm.bring_up(clears_protection=True)
    arm.cycles(120)
    axis = arm.loop[0]["axes"][1]
    assert axis["reference"]["referenced"] == 0 or abs(axis["measured"]["position_rad"] - true_rad(arm, 1)) < 0.06
    arm.close()


def test_a_home_that_a_fault_overtook_is_not_begun_later(arm):
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    arm.sim.inject(Protection("joint4", 0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT)
    arm.cycles(60)
    assert arm.clear_fault().failure is None
    assert (arm.memory["dialogue"]["home_asked"], arm.memory["mode"]) == (0, Mode.HOLDING)


def test_a_drive_that_keeps_its_old_target_is_not_led_there(arm):
    """After a run its target register may still say where it was."""
    arm.sim.drives[1]._reads[0x33] = lambda: b"\x33\x00\x00\x01\x00\x00"
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert "from its own target" in str(arm.reference().failure)
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0


def test_a_joint_at_its_stop_is_homed_again(arm):
    """Its run is over in the 60 ms of a collision."""
    for _ in range(3):
        assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
        assert arm.reference().failure is None
        assert abs(arm.loop[0]["axes"][1]["measured"]["position_rad"] - true_rad(arm, 1)) < WITHIN_RAD


def test_what_is_known_of_a_count_outlives_the_process(arm):
    """A homed joint is believed by the next process, one that was refused or placed by a person's word is not."""
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.lost == {1: None}
    assert arm.ask(Request.REFERENCE, joint_mask=JOINT2, value=math.radians(20.0)) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.lost == {1: Unreferenced.NOT_HOMED}
    after = arm.next_process()
    after.bring_up(lost_before={joint: reason for joint, reason in arm.lost.items() if reason is not None})
    assert after.loop[0]["axes"]["reference"]["referenced"][:6].tolist() == [1, 0, 1, 1, 1, 1]
    assert after.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.NOT_HOMED
    after.close()


def test_what_cannot_be_kept_is_not_begun(arm):
    """The next process would believe a count that means nothing."""

    def refuse(joint, reason):
        raise NotSaved("no room")

    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    talk = referencing_asked_for(arm.arm, arm.loop, arm.port, arm.now_ns, arm.told.append, refuse, arm.marks)
    arm.until(lambda: talk.poll(arm.now_ns))
    assert str(talk.failure) == "no room"
    assert not arm.sim.drives[1].homing_now
    assert not any(b"9A02006B" in data for _, data in arm.sent)


def test_a_run_that_a_stop_need_not_end_is_ended_when_its_drive_is_heard_again():
    """Out of reach for longer than anybody told it to end: its first reading is answered with both commands."""
    arm = new_arm((0.0,) * 6)
    drive = arm.sim.drives[1]
    honest = drive._commands[0xFE]
    drive._commands[0xFE] = dataclasses.replace(honest, act=lambda a: 2 if drive.homing_now else honest.act(a))
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    arm.sim.inject(Silent("joint2", 0.5, until_s=5.0), since_ns=arm.now_ns)
    arm.reference(at_most_s=8.0)
    assert drive.homing_now
    arm.cycles(round(5.0e9 / arm.period_ns))
    assert not drive.homing_now
    arm.close()


@pytest.mark.parametrize("encoder", ["incremental", "absolute"])
def test_a_joint_whose_drive_has_no_homing_run_is_passed_by_without_a_fault(encoder):
    """Whoever homes an arm of ODrives has it as it was before, whether its joints are referenced or not."""
    shipped = load_arm("odrive6")
    joints = [
        joint.model_copy(update={"drive": joint.drive.model_copy(update={"encoder": encoder})})
        for joint in shipped.joints
    ]
    arm = VirtualArm.brought_up(shipped.model_copy(update={"joints": joints}))
    for homed in (0, JOINT2):
        assert arm.ask(Request.HOME, joint_mask=homed) == Answer.DONE
        assert arm.reference().failure is None
        assert (arm.memory["mode"], arm.memory["fault"]["code"]) == (Mode.HOLDING, Fault.NONE)
        assert set(arm.loop[0]["axes"]["reference"]["referenced"][:6]) == {int(encoder == "absolute")}
    arm.close()
