"""Motions of our own making: never faster than the limits, never off the line, refused where a line cannot be led."""

from contextlib import closing

import numpy as np
import pytest
from depth import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plain_messages import present
from virtual import VirtualArm

from config.kinematics import flange_pose
from config.loader import load_arm
from rosfront import refusals
from rosfront.full_node.inverse import Inverse
from rosfront.full_node.moves import Line, Profile, joint_move
from rosfront.full_node.rotations import matrix_of, turn_of
from rosfront.goal import plan_move
from rosfront.path import PlannedPath
from rosfront.settings import Settings
from shm.words import Outcome

ARM = load_arm("episode1")
LINEAR = load_arm("episode1", overrides={"trajectory": {"interpolation": "linear"}})
INVERSE = Inverse(ARM.kinematics, ARM.joints)
LOWER = np.array([joint.lower_rad for joint in ARM.joints])
UPPER = np.array([joint.upper_rad for joint in ARM.joints])
FASTEST = np.array([joint.max_velocity_rad_s for joint in ARM.joints])
HARDEST = np.array([joint.max_acceleration_rad_s2 for joint in ARM.joints])
OVER_THE_TABLE = np.radians([0, 10, 40, 0, 50, 70])
shares = st.lists(st.floats(0, 1), min_size=6, max_size=6).map(np.array)
ways_mm = st.lists(st.floats(-80, 80), min_size=3, max_size=3).map(np.array)
turns_deg = st.lists(st.floats(-40, 40), min_size=3, max_size=3).map(np.array)


def planned(trajectory, start, arm=ARM):
    return plan_move(trajectory, arm, present(start), Settings.of(arm))


def moved(start, way_mm, turn_deg=(0, 0, 0)):
    pose = flange_pose(ARM.kinematics, start).copy()
    pose[:3, 3] += np.array(way_mm) / 1e3
    pose[:3, :3] = matrix_of(np.array(turn_deg, dtype=float), "zyx") @ pose[:3, :3]
    return pose


def sampled(plan):
    """Positions, velocities and accelerations at many moments of a plan, its points among them."""
    times_ns = np.union1d(np.linspace(0, plan.times_ns[-1], 2000).astype(np.int64), plan.times_ns)
    return PlannedPath(plan).at(times_ns)


def off_the_line(positions, start, pose):
    """Distance of the flange (m) from the line, and its rotation (rad) from the one due there, for joints (n, 6)."""
    begin = flange_pose(ARM.kinematics, start)
    flange = flange_pose(ARM.kinematics, positions)
    way = pose[:3, 3] - begin[:3, 3]
    turn = turn_of(pose[:3, :3] @ begin[:3, :3].T)
    gone = flange[:, :3, 3] - begin[:3, 3]
    length = np.linalg.norm(way)
    share = gone @ way / length**2
    aside = np.linalg.norm(gone - share[:, np.newaxis] * way, axis=-1)
    due = [turn_of(f[:3, :3] @ begin[:3, :3].T) - s * turn for f, s in zip(flange, share, strict=True)]
    return aside, np.linalg.norm(due, axis=-1)


@given(st.floats(1e-3, 50), st.floats(1e-2, 100), st.floats(1e-3, 1.0))
def test_a_profile_covers_its_way_within_speed_and_acceleration(speed, acceleration, widest):
    profile = Profile.fastest(speed, acceleration)
    times = np.linspace(0.0, profile.duration_s, 2001)
    share, rate, bend = profile.at(times)
    assert (share[0], share[-1]) == pytest.approx((0.0, 1.0), abs=1e-9)
    assert (rate[0], rate[-1], bend[0], bend[-1]) == pytest.approx((0, 0, 0, 0), abs=1e-6)
    assert rate.max() <= speed * (1 + 1e-9) and np.abs(bend).max() <= acceleration * (1 + 1e-9)
    step = times[1]
    assert np.gradient(share, step)[2:-2] == pytest.approx(rate[2:-2], abs=acceleration * step)
    waypoints = profile.times_s(widest)
    assert (np.diff(waypoints) >= 0).all() and np.diff(profile.at(waypoints)[0]).max() <= widest * (1 + 1e-9)


@settings(deadline=None, max_examples=examples(60))
@given(start=shares, target=shares, ratio=st.floats(0.01, 1.0), arm=st.sampled_from([ARM, LINEAR]))
def test_a_move_of_the_joints_keeps_its_share_of_every_limit(start, target, ratio, arm):
    """And one of them at least is used up: no slower than need be."""
    start, target = (LOWER + share * (UPPER - LOWER) for share in (start, target))
    assume(np.abs(target - start).max() > 1e-3)
    plan = planned(joint_move(arm, start, target, ratio), start, arm)
    position, velocity, acceleration = sampled(plan)
    assert position[-1] == pytest.approx(target, abs=1e-9)
    fast, hard = np.abs(velocity) / (ratio * FASTEST), np.abs(acceleration) / HARDEST
    assert fast.max() < 1 + 1e-4 and hard.max() < 1 + 1e-4
    assert max(fast.max(), hard.max()) > 0.99
    assert velocity[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_move_to_where_the_arm_stands_is_over_at_once():
    plan = planned(joint_move(ARM, OVER_THE_TABLE, OVER_THE_TABLE, 1.0), OVER_THE_TABLE)
    assert plan.duration_s == 0.0
    line = Line(ARM, INVERSE, OVER_THE_TABLE, moved(OVER_THE_TABLE, (0, 0, 0)))
    assert planned(line.trajectory(8e-3), OVER_THE_TABLE).duration_s < 0.5


@settings(deadline=None, max_examples=examples(60))
@given(near=shares, way_mm=ways_mm, turn_deg=turns_deg, step_mm=st.sampled_from([0.5, 8.0, 1e6]))
def test_a_line_is_straight_between_its_waypoints_too(near, way_mm, turn_deg, step_mm):
    """Better than a micrometre and 0.001° through the curves that the control process follows, within every limit."""
    start = OVER_THE_TABLE + (near - 0.5) * np.radians([120, 20, 40, 60, 40, 120])
    pose = moved(start, way_mm, turn_deg)
    assume(np.linalg.norm(way_mm) > 5.0)
    try:
        line = Line(ARM, INVERSE, start, pose)
    except refusals.GoalRefused:
        assume(False)
    plan = planned(line.trajectory(step_mm / 1e3), start)
    position, velocity, acceleration = sampled(plan)
    aside, turned = off_the_line(position[::3], start, pose)
    assert aside.max() < 1e-6 and np.degrees(turned.max()) < 0.001
    assert flange_pose(ARM.kinematics, position[-1]) == pytest.approx(pose, abs=1e-7)
    fast, hard = np.abs(velocity) / FASTEST, np.abs(acceleration) / HARDEST
    assert fast.max() < 1.02 and hard.max() < 1.1


@settings(deadline=None, max_examples=examples(100))
@given(share=shares, way_mm=st.lists(st.floats(-600, 600), min_size=3, max_size=3), turn_deg=turns_deg)
def test_a_refused_line_says_where_and_why(share, way_mm, turn_deg):
    start = LOWER + share * (UPPER - LOWER)
    try:
        Line(ARM, INVERSE, start, moved(start, way_mm, turn_deg))
    except refusals.OffTheStraight as refused:
        assert " at " in refused.sentence and "%)" in refused.sentence
        assert refused.sentence.endswith("lead the line another way.")
    except refusals.Unreachable as refused:
        assert "choose" in refused.sentence


def refusal(start_deg, way_mm, turn_deg=(0, 0, 0)):
    start = np.radians(start_deg)
    with pytest.raises(refusals.GoalRefused) as refused:
        Line(ARM, INVERSE, start, moved(start, way_mm, turn_deg))
    return refused.value


def test_a_line_from_a_straight_wrist_is_refused_at_its_beginning():
    refused = refusal([0, 0, 0, 0, 0, 0], (-20, 0, -20))
    assert isinstance(refused, refusals.Singular)
    assert "at 0.0 mm of its 28.3 mm (0%) joints 4 and 6 turn about almost one axis" in refused.sentence


def test_a_line_through_a_straight_wrist_is_refused_in_between():
    refused = refusal([0, 0, 0, 0, 30, 0], (0, 0, 0), (0, -60, 0))
    assert isinstance(refused, refusals.Singular)
    assert "° of its 60.0° (38%) joints 4 and 6" in refused.sentence


def test_a_line_over_the_first_axis_is_refused():
    pose = np.eye(4)  # the flange looks up
    pose[:3, 3] = 0.12, 0.06, 0.45
    start = INVERSE.nearest(pose, np.zeros(6))
    refused = refusal(np.degrees(start), (-240, -120, 0))
    assert isinstance(refused, refusals.Singular) and "joint 1's axis" in refused.sentence
    assert "(46%)" in refused.sentence


def test_a_line_into_the_stretched_arm_is_refused():
    """Upper arm and forearm are in line at joint3 -73.74°."""
    start, end = np.radians([0, 40, -60, 0, 50, 70]), np.radians([0, 40, -73.5, 0, 50, 70])
    with pytest.raises(refusals.Singular, match="the arm is stretched out or folded up"):
        Line(ARM, INVERSE, start, flange_pose(ARM.kinematics, end))


def test_a_line_through_the_hollow_around_the_shoulder_is_refused():
    """With an upper arm of 300 mm and a forearm of 200 mm the wrist comes no nearer to joint 2 than 100 mm."""
    rows = list(ARM.kinematics.dh)
    rows[1] = rows[1].model_copy(update={"a_mm": 300.0})
    arm = ARM.model_copy(update={"kinematics": ARM.kinematics.model_copy(update={"dh": rows})})
    inverse = Inverse(arm.kinematics, arm.joints)
    begin, end = np.eye(4), np.eye(4)
    begin[:3, :3] = end[:3, :3] = matrix_of(np.array([180.0, 0.0, 0.0]), "xyz")
    begin[:3, 3], end[:3, 3] = (0.1, 0.25, 0.111), (0.1, -0.25, 0.111)
    inverse.lower_rad, inverse.upper_rad = np.full(6, -7.0), np.full(6, 7.0)
    start = inverse.nearest(begin, np.zeros(6))
    with pytest.raises(refusals.OffTheLine, match=r"at \d+\.\d mm of its 500\.0 mm \(\d+%\) it leaves the arm's reach"):
        Line(arm, inverse, start, end)


def test_a_line_out_of_reach_is_refused():
    refused = refusal(np.degrees(OVER_THE_TABLE), (500, 0, 0))
    assert isinstance(refused, refusals.Unreachable) and "out of reach" in refused.sentence


def test_a_line_that_leads_a_joint_out_of_its_limits_is_refused():
    refused = refusal([0, 10, 40, 0, 50, 250], (0, 0, 0), (0, 0, -80))
    assert isinstance(refused, refusals.OutOfLimits)
    assert (
        "joint6 comes to" in refused.sentence
        and "allowed are -0.5236 rad (-30.00°) to 5.0615 rad (290.00°)" in refused.sentence
    )


@pytest.mark.parametrize(
    ("way_mm", "turn_deg"), [((0, 200, 0), (0, 0, 0)), ((-60, 40, 120), (0, 0, 40)), ((0, 0, 0.5), (30, 0, 0))]
)
def test_the_simulated_arm_moves_its_flange_straight(way_mm, turn_deg):
    """True joint angles of the simulated drives, in virtual time; the figures of docs/guides/full-node.md."""
    pose = moved(OVER_THE_TABLE, way_mm, turn_deg)
    with closing(VirtualArm(start_rad=OVER_THE_TABLE)) as arm:
        assert arm.bring_up().failure is None
        commanded_rad = arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy()
        plan = planned(Line(ARM, INVERSE, commanded_rad, pose).trajectory(8e-3), commanded_rad)
        begun_ns = arm.now_ns
        goal = arm.send_goal(plan.times_ns, plan.joints)
        commanded = []
        while arm.outcome(goal) == Outcome.NONE:
            arm.cycle()
            commanded.append(arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy())
        assert arm.outcome(goal) == Outcome.SUCCEEDED
        times_ns = np.arange(begun_ns, arm.now_ns, 2_000_000)
        true = np.stack([arm.sim.truth(joint, times_ns)[0] for joint in range(6)], axis=1)
    aside, _ = off_the_line(np.array(commanded), commanded_rad, pose)
    true_aside, _ = off_the_line(true, commanded_rad, pose)
    print(
        f"{way_mm}: commanded {aside.max() * 1e3:.4f} mm, true {true_aside.max() * 1e3:.4f} mm, {plan.duration_s:.2f} s"
    )
    assert aside.max() < 1e-6
    assert true_aside.max() < 1e-4
