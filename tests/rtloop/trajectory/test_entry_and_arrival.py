"""Where a trajectory is entered, how one that ends in motion is brought to rest, and what is judged on the way."""

import math

import numpy as np
import pytest
from commanded import CommandedArm
from depth import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm, recorded_goal

from rtloop.dialogues.release import Release
from shm.words import Answer, Fault, Mode, Outcome, Phase, Request
from sim.faults import CountSlip, PowerLoss, Stall

trials = settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.too_slow])


def recorded_at(arm: VirtualArm, name: str, elapsed_s: float, **options) -> int:
    """A recorded goal whose start lies `elapsed_s` back (or ahead, where negative)."""
    return arm.play(name, start_ns=arm.now_ns - round(elapsed_s * 1e9), **options)


# --- where it is entered --------------------------------------------------------------------------------


@trials
@given(st.floats(0.0, 0.35))
def test_a_start_in_the_past_is_entered_where_it_is_due_without_a_jump(late_s: float) -> None:
    goal = recorded_goal("scale_1_0")
    arm = CommandedArm(start_rad=goal["joints"][0, :, 0])
    begun_ns = arm.now_ns - round(late_s * 1e9)
    number = recorded_at(arm, "scale_1_0", late_s)
    arm.cycles(2)
    if arm.outcome(number) == Outcome.REFUSED_START:
        assert arm.result(number)["value"] > 0.05 and late_s > 0.1
        assert arm.acceleration_ratio() == 0.0
        return
    assert arm.end_of(number) == Outcome.SUCCEEDED
    assert arm.acceleration_ratio() <= 1.9
    # it ends when it was to end, unless the way onto it had to be slower than the wanted rate
    end_ns = begun_ns + goal["times_ns"][-1]
    assert arm.now_ns - end_ns <= 0.6e9
    arm.close()


def test_a_start_in_the_past_of_a_moving_arm_is_blended_too() -> None:
    """The same trajectory twice, the second time as it is by now: nothing happens to the motion."""
    goal = recorded_goal("large")
    arm = CommandedArm(start_rad=goal["joints"][0, :, 0])
    begun_ns = arm.now_ns
    first = arm.play("large", start_ns=begun_ns)
    arm.cycles(100)
    second = arm.play("large", start_ns=begun_ns)
    assert arm.end_of(second) == Outcome.SUCCEEDED and arm.outcome(first) == Outcome.REPLACED
    assert arm.acceleration_ratio() <= 1.3
    arm.close()


def test_a_start_ahead_leaves_the_arm_standing_until_then() -> None:
    goal = recorded_goal("small")
    arm = CommandedArm(start_rad=goal["joints"][0, :, 0])
    number = recorded_at(arm, "small", -0.5)
    arm.cycles(48)
    assert np.ptp(np.array(arm.positions), axis=0).max() == 0.0
    assert arm.reader.snapshot()["goal_phase"] == Phase.WAITING
    assert arm.end_of(number) == Outcome.SUCCEEDED
    arm.close()


def test_the_way_to_a_first_point_gets_the_time_that_is_left() -> None:
    arm = CommandedArm()
    joints = np.zeros((1, 6, 3))
    joints[:, :, 0] = 0.1
    begun_ns = arm.now_ns - 10**9
    goal = arm.send_goal(np.array([2 * 10**9]), joints, approach=True, start_ns=begun_ns)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.now_ns - begun_ns == pytest.approx(2e9, abs=4 * arm.period_ns)
    arm.close()


# --- an end in motion -----------------------------------------------------------------------------------


def accelerating(arm: VirtualArm, seconds: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Waypoints from rest to `speed` (share of each joint's limit) at the last one, upwards on every joint."""
    times = np.linspace(0.0, seconds, 21)
    velocity = speed * np.array([joint.max_velocity_rad_s for joint in arm.arm.joints])
    velocity = np.minimum(velocity, 0.5 * seconds * np.array([j.max_acceleration_rad_s2 for j in arm.arm.joints]))
    velocity = np.minimum(velocity, 1.8 / seconds * np.array([j.upper_rad for j in arm.arm.joints]))
    x = (times / seconds)[:, None]
    joints = np.zeros((21, len(velocity), 3))
    joints[..., 0] = velocity * seconds * (x**3 - 0.5 * x**4)
    joints[..., 1] = velocity * (3 * x**2 - 2 * x**3)
    joints[..., 2] = velocity / seconds * (6 * x - 6 * x**2)
    return (times * 1e9).astype(np.int64), joints


@trials
@given(st.floats(0.5, 2.0), st.floats(0.05, 1.0), st.floats(0.1, 1.0))
def test_an_end_in_motion_is_reached_at_rest_exactly_there(seconds: float, speed: float, scale: float) -> None:
    arm = CommandedArm()
    times, joints = accelerating(arm, seconds, speed)
    arm.writer.scale(scale)
    goal = arm.send_goal(times, joints)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.commanded() == pytest.approx(joints[-1, :, 0], abs=1e-9)
    assert arm.acceleration_ratio() <= 1.9 and arm.memory["fault"]["code"] == Fault.NONE
    # on the path, never beyond the point and back
    assert (np.array(arm.positions) <= joints[-1, :, 0] + 1e-9).all()
    arm.close()


@trials
@given(st.floats(0.0, 1.0), st.integers(0, 60))
@example(0.6875, 5)  # turned round in mid-stop, with too little path left for the full rate
def test_a_pause_on_the_way_to_such_an_end_does_not_miss_it(moment: float, cycles: int) -> None:
    arm = CommandedArm()
    times, joints = accelerating(arm, 1.2, 0.8)
    goal = arm.send_goal(times, joints)
    arm.cycles(2 + round(moment * 125))
    arm.writer.hold()
    arm.cycles(1 + cycles)
    arm.writer.resume()
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.commanded() == pytest.approx(joints[-1, :, 0], abs=1e-9)
    assert arm.acceleration_ratio() <= 1.99 and arm.memory["fault"]["code"] == Fault.NONE
    arm.close()


# --- tolerances -----------------------------------------------------------------------------------------


def of_joint2(*tolerances: float) -> np.ndarray:
    rows = np.zeros((6, 3))
    rows[1] = tolerances
    return rows


def stalled(virtual_arm, **options):
    arm = virtual_arm(goal="scale_1_0")
    goal = arm.play("scale_1_0", **options)
    arm.sim.inject(Stall(joint="joint2", at_s=0.3), since_ns=arm.now_ns)
    arm.end_of(goal)
    return arm, goal


def test_a_velocity_tolerance_is_judged_on_the_way(virtual_arm) -> None:
    arm, goal = stalled(virtual_arm, tolerances=of_joint2(0.0, 0.05, 0.0))
    result = arm.result(goal)
    assert (arm.outcome(goal), result["joint"]) == (Outcome.PATH_VELOCITY, 1)
    assert abs(result["value"]) > 0.05 and result["limit"] == 0.05


def test_an_acceleration_tolerance_is_judged_on_the_way(virtual_arm) -> None:
    arm, goal = stalled(virtual_arm, tolerances=of_joint2(0.0, 0.0, 0.5))
    assert (arm.outcome(goal), arm.result(goal)["joint"]) == (Outcome.PATH_ACCELERATION, 1)


def test_a_sound_arm_keeps_tight_tolerances_of_every_kind(virtual_arm) -> None:
    """What is judged is the error against the setpoint of the same instants, so sound drives pass easily."""
    arm = virtual_arm(goal="scale_1_0")
    slower = 0.5 * np.array([joint.max_velocity_rad_s for joint in arm.arm.joints]).min()
    goal = arm.play("scale_1_0", tolerances=(0.05, slower, 5.0), goal_tolerances=(0.005, 0.02, 0.5))
    assert arm.end_of(goal) == Outcome.SUCCEEDED


def test_the_path_tolerance_ends_where_the_path_does(virtual_arm) -> None:
    """Once the last point is commanded only the goal's own tolerances count."""
    arm = virtual_arm(goal="small")
    goal = arm.play("small", tolerances=(0.004, 0.0, 0.0), goal_tolerances=(1e-6, 0.0, 0.0), goal_time_s=0.5)
    arm.until(lambda: arm.running["settle_start_ns"] != 0)
    arm.sim.inject(Stall(joint="joint1", at_s=0.0), since_ns=arm.now_ns)
    arm.loop[0]["axes"][0]["measured"]["position_rad"] += 0.02  # as if something had pushed it
    assert arm.end_of(goal) == Outcome.GOAL_TOLERANCE


def test_a_joint_that_still_moves_has_not_arrived(virtual_arm) -> None:
    arm = virtual_arm("mock")
    joints = np.zeros((1, 6, 3))
    joints[:, 0, 0] = 0.05
    goal = arm.send_goal(np.array([10**9]), joints, approach=True, goal_tolerances=(0.0, 0.01, 0.0), goal_time_s=0.3)
    arm.until(lambda: arm.running["settle_start_ns"] != 0)
    for _ in range(200):
        arm.loop[0]["axes"][2]["measured"]["velocity_rad_s"] = 0.5
        arm.cycle()
        if arm.outcome(goal) != Outcome.NONE:
            break
    assert (arm.outcome(goal), arm.result(goal)["joint"]) == (Outcome.GOAL_VELOCITY, 2)
    assert arm.result(goal)["value"] == 0.5


# --- limp ---------------------------------------------------------------------------------------------


def ask(arm: VirtualArm, kind: Request) -> Answer:
    sequence = arm.request(kind)
    arm.cycles(2)
    answer = arm.reader.snapshot()["answers"][sequence % 16]
    assert int(answer["sequence"]) == sequence
    return Answer(int(answer["answer"]))


@pytest.mark.parametrize(("request_", "mode"), [(Request.DISABLE, Mode.DISABLED), (Request.FREE, Mode.FREE)])
def test_limp_drives_are_followed_and_hold_where_they_are_when_enabled(virtual_arm, request_, mode) -> None:
    arm = virtual_arm(start_rad=[0.3, 0.2, -0.1, 1.0, 0.5, 2.0])
    assert ask(arm, request_) == Answer.DONE
    assert arm.memory["mode"] == mode
    assert arm.release().failure is None
    assert not any(drive.enabled for drive in arm.sim.drives)
    arm.cycles(30)
    assert arm.memory["fault"]["code"] == Fault.NONE and arm.memory["mode"] == mode
    goal = arm.play("small")
    arm.cycles(3)
    assert arm.outcome(goal) == Outcome.REFUSED_MODE
    arm.pending.clear()
    assert ask(arm, Request.ENABLE) == Answer.DONE
    assert arm.memory["dialogue"]["bring_up_asked"] == 1
    arm.memory["dialogue"]["bring_up_asked"] = 0
    assert arm.bring_up().failure is None
    assert arm.memory["mode"] == Mode.HOLDING and all(drive.enabled for drive in arm.sim.drives)
    arm.cycles(60)
    for joint, angle in enumerate([0.3, 0.2, -0.1, 1.0, 0.5, 2.0]):
        assert arm.sim.true_position_rad(joint, arm.now_ns - 1) == pytest.approx(angle, abs=1e-3)


def test_a_moving_arm_is_never_let_go(virtual_arm) -> None:
    arm = virtual_arm(goal="large")
    goal = arm.play("large")
    arm.cycles(60)
    for kind in (Request.DISABLE, Request.FREE):
        assert ask(arm, kind) == Answer.REFUSED_MOVING
    assert arm.end_of(goal) == Outcome.SUCCEEDED and all(drive.enabled for drive in arm.sim.drives)


def test_a_drive_that_does_not_let_go_is_a_fault_with_its_name(virtual_arm) -> None:
    arm = virtual_arm()
    stubborn = arm.sim.drives[2]
    assert ask(arm, Request.FREE) == Answer.DONE
    talk = Release(arm.arm, arm.port, now_ns=arm.now_ns)
    while not talk.poll(arm.now_ns):
        stubborn.enabled = True  # as by a jumper that overrules the command
        arm.cycle()
    arm.cycles(2)
    assert talk.failure is not None and "joint3 stays enabled" in str(talk.failure)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.RELEASE, 2)


def test_losing_power_while_limp_still_loses_the_reference(virtual_arm) -> None:
    arm = virtual_arm()
    assert ask(arm, Request.FREE) == Answer.DONE
    assert arm.release().failure is None
    arm.sim.inject(PowerLoss(joint="joint4", at_s=0.1), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["fault"]["code"] != Fault.NONE, at_most_s=3.0)
    assert arm.memory["fault"]["code"] in (Fault.REFERENCE_LOST, Fault.STALE_READING)
    assert math.isfinite(arm.loop[0]["axes"][3]["commanded"]["position_rad"])


def test_after_a_fault_a_limp_joint_may_still_be_led_by_hand(virtual_arm) -> None:
    """The drives were let go before and hold nothing, whatever the mode is called now."""
    arm = virtual_arm()
    assert ask(arm, Request.FREE) == Answer.DONE
    assert arm.release().failure is None
    arm.cycles(20)
    arm.sim.inject(PowerLoss(joint="joint4", at_s=0.0), since_ns=arm.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=3.0)
    row, params = arm.loop[0]["joints"][0], arm.loop[0]["params"]
    step_rad = float(params["position_jump_rad"] + row["max_velocity_rad_s"] * arm.period_ns * 1e-9)
    arm.sim.inject(CountSlip("joint1", 0.0, deg=math.degrees(step_rad)), since_ns=arm.now_ns)
    arm.cycles(10)
    assert arm.loop[0]["axes"][0]["reference"]["referenced"] == 1
    arm.close()


def test_enabling_at_once_takes_a_release_back(virtual_arm) -> None:
    """free and enable before the conversation has begun: the drives are never let go afterwards."""
    arm = virtual_arm()
    assert ask(arm, Request.FREE) == Answer.DONE
    assert ask(arm, Request.DISABLE) == Answer.DONE
    assert ask(arm, Request.ENABLE) == Answer.DONE
    assert (arm.memory["dialogue"]["release_asked"], arm.memory["dialogue"]["bring_up_asked"]) == (0, 1)
    assert arm.bring_up().failure is None
    assert arm.memory["dialogue"]["release_asked"] == 0 and all(drive.enabled for drive in arm.sim.drives)


# --- goals that wait ------------------------------------------------------------------------------------


@pytest.mark.parametrize("comes_back", [True, False])
def test_a_goal_that_waits_does_not_outlive_its_front(comes_back: bool) -> None:
    arm = CommandedArm()
    joints = np.full((1, 6, 3), 0.0)
    joints[:, :, 0] = 0.2
    goal = arm.send_goal(np.array([10**9]), joints, approach=True, start_ns=arm.now_ns + 2 * 10**9)
    arm.cycles(20)
    arm.front_alive = False
    arm.cycles(100)
    arm.front_alive = comes_back
    arm.cycles(300)
    assert arm.outcome(goal) == Outcome.FRONT_LOST
    assert np.ptp(np.array(arm.positions), axis=0).max() == 0.0
    arm.close()


def test_held_means_held_for_a_newer_goal_too() -> None:
    arm = CommandedArm()
    joints = np.zeros((1, 6, 3))
    joints[:, :, 0] = 0.2
    first = arm.send_goal(np.array([2 * 10**9]), joints, approach=True)
    arm.cycles(60)
    arm.writer.hold()
    arm.cycles(100)
    stood = arm.commanded()
    newer = arm.send_goal(np.array([2 * 10**9]), joints * 0.5, approach=True)
    arm.cycles(200)
    assert (arm.commanded() == stood).all()
    assert arm.outcome(newer) == Outcome.REFUSED_HELD
    arm.writer.resume()
    assert arm.end_of(first) == Outcome.SUCCEEDED
    assert arm.acceleration_ratio() <= 1.9
    arm.close()
