"""From a goal message to waypoints: every refusal with its sentence, and what a good goal becomes."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_messages import duration, goal_of, point, present, trajectory
from scipy.interpolate import BPoly, CubicHermiteSpline, PchipInterpolator

from config.loader import load_arm
from rosfront import refusals
from rosfront.goal import densify, plan_goal, plan_stream
from rosfront.path import PlannedPath
from rosfront.settings import Settings

GOALS = Path(__file__).parents[1] / "data" / "moveit"
ARM = load_arm("episode1")
NAMES = [joint.name for joint in ARM.joints]


def as_message(value):
    """A JSON value with attribute access, as a ROS message has."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: as_message(entry) for key, entry in value.items()})
    return [as_message(entry) for entry in value] if isinstance(value, list) else value


def recorded(name: str):
    return as_message(json.loads((GOALS / f"{name}.json").read_text()))


def goal(points, names=None, stamp_s=0.0):
    return goal_of(trajectory(points, NAMES if names is None else names, stamp_s))


def tolerance(name, position=0.0, velocity=0.0, acceleration=0.0):
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def one_joint(*points, name="joint1"):
    return goal(points, names=[name])


def planned(message, at=None, arm=ARM, **changes):
    """The plan of a goal for an arm that stands at zero, with the arm's settings but for `changes`."""
    return plan_goal(message, arm, at or present(), replace(Settings.of(arm), **changes))


def streamed(message, at=None, arm=ARM):
    """The plan of the same trajectory as a message of ~/joint_trajectory."""
    return plan_stream(message.trajectory, arm, at or present(), Settings.of(arm))


ZERO = [0.0] * 6
NAN, INF = math.nan, math.inf

BAD = {
    "no joint names": (
        goal([point(0, [])], names=[]),
        -2,
        "names no joint; name one or more of joint1, joint2",
    ),
    "unknown joint": (
        goal([point(0, [0.0])], names=["elbow"]),
        -2,
        "'elbow' in joint_names is no joint of this arm, which has joint1, joint2",
    ),
    "duplicate joint": (
        goal([point(0, [0.0, 0.0])], names=["joint1", "joint1"]),
        -2,
        "'joint1' stands in joint_names more than once",
    ),
    "empty": (goal([]), -1, "has no points"),
    "positions missing": (
        goal([point(0, [])]),
        -1,
        "Point 0 has 0 positions for 6 joint names; give 6, in the",
    ),
    "positions too few": (
        goal([point(0, ZERO), point(1, [0.0])]),
        -1,
        "Point 1 has 1 positions for 6 joint names",
    ),
    "velocities too many": (
        one_joint(point(0, [0.0], [0.0, 0.0])),
        -1,
        "Point 0 has 2 velocities for 1 joint name; give 1 or none",
    ),
    "accelerations too few": (goal([point(0, ZERO, ZERO, [0.0])]), -1, "Point 0 has 1 accelerations for 6"),
    "accelerations alone": (
        one_joint(point(0, [0.0], [], [0.0])),
        -1,
        "Point 0 has accelerations but no velocities",
    ),
    "effort": (one_joint(point(0, [0.0], effort=[1.0])), -1, "Point 0 has effort"),
    "NaN position": (
        goal([point(0, ZERO), point(1, [0, 0, NAN, 0, 0, 0])]),
        -1,
        "Point 1 has nan as position of joint3",
    ),
    "infinite velocity": (
        one_joint(point(0, [0.0], [INF]), point(1, [0.0], [0.0])),
        -1,
        "inf as velocity of joint1",
    ),
    "NaN acceleration": (one_joint(point(0, [0.0], [0.0], [NAN])), -1, "nan as acceleration of joint1"),
    "NaN last velocity": (one_joint(point(0, [0.0], [0.0]), point(1, [0.0], [NAN])), -1, "nan as velocity"),
    "negative time": (one_joint(point(-0.5, [0.0])), -1, "Point 0 has time_from_start -0.500000 s"),
    "times equal": (
        one_joint(point(1, [0.0]), point(1, [0.0])),
        -1,
        "Point 1 has time_from_start 1.000000 s after 1.000000 s at point 0",
    ),
    "times falling": (
        one_joint(point(0, [0.0]), point(2, [0.0]), point(1, [0.0])),
        -1,
        "Point 2 has time_from_start 1.000000 s after 2.000000 s at point 1",
    ),
    "no timing": (one_joint(point(0, [0.0]), point(0, [0.1])), -1, "All 2 points have time_from_start 0"),
    "ends moving": (
        one_joint(point(0, [0.0], [0.0]), point(1, [0.1], [0.2])),
        -1,
        "The last point leaves joint1 moving at 0.2000 rad/s; at most 0.001 rad/s",
    ),
    "old stamp": (
        goal([point(0, ZERO), point(1, ZERO)], stamp_s=1_799_999_990.0),
        -3,
        "counted from its header stamp, ended 9.000 s ago",
    ),
    "too far away": (
        one_joint(point(0, [0.3]), point(1, [0.3])),
        -1,
        "The first point has joint1 at 0.3000 rad (17.19°), 0.3000 rad (17.19°) from where it is commanded; "
        "allowed are 0.0500 rad (2.86°)",
    ),
    "out of limits at a point": (
        one_joint(point(0, [0.0]), point(20, [1.6]), name="joint2"),
        -1,
        "joint2 would be at 1.6000 rad (91.67°) at 20.0000 s, at point 1; allowed are -1.5708 rad (-90.00°) "
        "to 1.5708 rad (90.00°)",
    ),
    "out of limits between points": (
        one_joint(
            point(0, [0.0]),
            point(10, [1.55], [0.2]),
            point(11, [1.55], [-0.2]),
            point(21, [0.0]),
            name="joint2",
        ),
        -1,
        "joint2 would be at 1.6000 rad (91.67°) at 10.5000 s, between points 1 and 2",
    ),
    "out of limits on the way to the first point": (
        one_joint(point(4, [1.55], [0.3]), point(10, [1.0]), name="joint2"),
        -1,
        "joint2 would be at",
    ),
    "too fast at a point": (
        one_joint(point(0, [0.0], [0.0]), point(1, [0.3], [0.6]), point(2, [0.6], [0.0])),
        -1,
        "joint1 would move at 0.6000 rad/s at 1.0000 s, at point 1; allowed are 0.4398 rad/s",
    ),
    "too fast between points": (
        one_joint(point(0, [0.0]), point(2, [1.0])),
        -1,
        "joint1 would move at 0.7500 rad/s at 1.0000 s, between points 0 and 1; allowed are 0.4398 rad/s",
    ),
    "too fast on the way to the first point": (
        one_joint(point(0.1, [0.1])),
        -1,
        "on the way to point 0; allowed are 0.4398 rad/s",
    ),
    "a jump that no cycle falls into": (
        one_joint(point(0, [0.0]), point(0.101, [0.0]), point(0.102, [0.04]), point(1, [0.04])),
        -1,
        "joint1 would move at 4.8000 rad/s",
    ),
    "too hard at a point": (
        one_joint(point(0, [0.0], [0.0], [5.0]), point(1, [0.0], [0.0], [0.0])),
        -1,
        "joint1 would accelerate with 5.000 rad/s² at 0.0000 s, at point 0; allowed are 4.000 rad/s²",
    ),
    "too hard between points": (
        one_joint(point(0, [0.0], [0.0]), point(0.2, [0.05], [0.0])),
        -1,
        "joint1 would accelerate with",
    ),
    "too hard in a long segment": (
        one_joint(
            point(0, [0.0], [0.0]),
            point(1.5, [0.3], [0.43]),
            point(2.1, [0.3], [0.43]),
            point(3.6, [0.6], [0.0]),
        ),
        -1,
        "joint1 would accelerate with 4.182 rad/s² at 1.5081 s, between points 1 and 2",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_goals_are_refused_with_a_sentence(case):
    message, code, words = BAD[case]
    with pytest.raises(refusals.GoalRefused) as refused:
        planned(message)
    assert refused.value.code == code
    assert words in refused.value.sentence
    assert refused.value.sentence.endswith(".") and ". " not in refused.value.sentence


def test_too_many_points():
    message = goal([point(i, ZERO) for i in range(6)])
    arm = load_arm("episode1", overrides={"trajectory": {"max_points": 5}})
    with pytest.raises(refusals.TooManyPoints, match="has 6 points and at most 5 are allowed"):
        planned(message, arm=arm)


@pytest.mark.parametrize("field", ["multi_dof_trajectory", "component_path_tolerance", "component_goal_tolerance"])
def test_what_the_arm_cannot_do_is_refused_and_not_ignored(field):
    message = goal([point(0, ZERO)])
    if field == "multi_dof_trajectory":
        message.multi_dof_trajectory.joint_names = ["base"]
    else:
        setattr(message, field, [tolerance("joint1")])
    with pytest.raises(refusals.NotSupported, match=f"The goal has a {field}"):
        planned(message)


def test_a_refusal_holds_joint_value_and_limit():
    with pytest.raises(refusals.PositionBeyondLimit) as refused:
        planned(BAD["out of limits at a point"][0])
    assert (refused.value.joint, refused.value.value) == ("joint2", 1.6)
    assert refused.value.limit == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("file", sorted(GOALS.glob("*.json")), ids=lambda f: f.stem)
def test_recorded_moveit_goals_are_accepted_from_their_start(file):
    message = recorded(file.stem)
    plan = planned(message, present(message.trajectory.points[0].positions))
    assert not plan.approach and plan.start_ns == 0 and plan.joint_mask == 0b111111
    assert set(plan.orders.tolist()) == {5}
    assert plan.joints[:, :, 0].tolist() == [p.positions for p in message.trajectory.points]
    assert plan.joints[:, :, 1].tolist() == [p.velocities for p in message.trajectory.points]
    assert plan.joints[:, :, 2].tolist() == [p.accelerations for p in message.trajectory.points]


@pytest.mark.parametrize("rate_hz", [100.0, 120.0, 200.0])
@pytest.mark.parametrize("file", sorted(GOALS.glob("*.json")), ids=lambda f: f.stem)
@pytest.mark.parametrize("fields", ["all", "no accelerations"])
def test_recorded_moveit_goals_are_accepted_whatever_the_rate(file, rate_hz, fields):
    """They come within 80 % of the margin for any phase of the cycle; last intervals are as short as 0.4 ms."""
    arm = load_arm("mock", overrides={"control": {"rate_hz": rate_hz}, "limits": {"acceleration_margin": 1.6}})
    message = recorded(file.stem)
    if fields == "no accelerations":
        for p in message.trajectory.points:
            p.accelerations = []
    planned(message, present(message.trajectory.points[0].positions), arm)


def test_recorded_goals_from_elsewhere_are_refused():
    with pytest.raises(refusals.TooFar, match="from where it is commanded"):
        planned(recorded("large_back"))


def test_while_the_arm_moves_the_first_point_is_left_to_the_control_process():
    planned(recorded("large_back"), present(standing=False))


def test_any_joint_order_and_a_subset():
    message = goal([point(0, [0.01, 0.02]), point(2, [0.3, 0.1])], names=["joint4", "joint2"])
    plan = planned(message, present([0.5, 0.02, 0.7, 0.01, 0.9, 1.0]))
    assert plan.joint_mask == 0b001010
    assert plan.joints[1, :, 0].tolist() == [0.5, 0.1, 0.7, 0.3, 0.9, 1.0]
    assert not plan.joints[:, [0, 2, 4, 5], 1:].any()


def test_positions_only_becomes_a_monotone_cubic_at_rest_at_both_ends():
    p = [0.0, 0.05, 0.25, 0.3]
    plan = planned(one_joint(*[point(i, [x]) for i, x in enumerate(p)]))
    assert set(plan.orders.tolist()) == {3}
    expected = PchipInterpolator(range(4), p).derivative()(range(4))
    assert plan.joints[:, 0, 1] == pytest.approx([0.0, expected[1], expected[2], 0.0])


def test_fewer_fields_on_some_points_give_the_lower_order_there():
    rest = ([0.0], [0.0])
    message = one_joint(
        point(0, [0.0], *rest),
        point(1, [0.1], [0.1], [0.0]),
        point(2, [0.2], [0.1]),
        point(3, [0.3]),
        point(4, [0.3], *rest),
    )
    plan = planned(message)
    assert plan.orders[1:].tolist() == [5, 3, 3, 3]
    assert plan.joints[2, 0, 2] == 0.0


def test_a_first_point_later_than_zero_is_approached_from_the_commanded_state():
    plan = planned(one_joint(point(2, [0.4])))
    assert plan.approach and plan.times_ns.tolist() == [2_000_000_000]
    assert plan.orders.tolist() == [3]


NOW_S = 1_800_000_000.0
NOW_NS = 5_000_000_000


def test_a_stamp_ahead_is_a_start_ahead():
    ahead = planned(goal([point(0, ZERO), point(1, ZERO)], stamp_s=NOW_S + 2.5))
    assert (ahead.start_ns, ahead.entry_ns) == (NOW_NS + 2_500_000_000, 0)


def slow_way(stamp_s):
    """joint1 by 0.3 rad in 3 s, gently, in waypoints 0.1 s apart."""
    times = np.arange(0.0, 3.01, 0.1)
    x = times / 3.0
    shape = 0.3 * (10 * x**3 - 15 * x**4 + 6 * x**5)
    speed = 0.3 * (30 * x**2 - 60 * x**3 + 30 * x**4) / 3.0
    return goal([point(t, [p], [v]) for t, p, v in zip(times, shape, speed, strict=True)], ["joint1"], stamp_s)


def test_a_stamp_in_the_past_enters_where_the_trajectory_is_due():
    plan = planned(slow_way(NOW_S - 0.75))
    assert plan.start_ns == NOW_NS - 750_000_000 and plan.entry_ns == 750_000_000
    assert plan.times_ns[0] == 700_000_000 and not plan.approach
    assert len(plan.times_ns) == len(plan.orders) == len(plan.joints) == 24


def test_where_that_is_too_far_it_is_entered_late_where_the_arm_is_near():
    plan = planned(slow_way(NOW_S - 2.0))
    assert 0.7e9 < plan.entry_ns < 1.2e9
    assert plan.start_ns == NOW_NS - plan.entry_ns
    path = PlannedPath(plan)
    here = path.at(np.array([plan.entry_ns]))[0][0, 0]
    assert 0.8 * 0.8 * 0.05 < here <= 0.8 * 0.05
    with pytest.raises(refusals.TooFar, match=r"The trajectory, by now 2\.000 s after its start .* has joint1 at"):
        planned(slow_way(NOW_S - 2.0), present([-0.2, 0, 0, 0, 0, 0]))


def test_a_moving_arm_is_left_to_the_control_process():
    plan = planned(slow_way(NOW_S - 2.0), present(standing=False))
    assert (plan.entry_ns, plan.start_ns) == (2 * 10**9, NOW_NS - 2 * 10**9)


def test_the_way_to_a_first_point_that_is_still_ahead_gets_the_time_that_is_left():
    message = goal([point(2, [0.2])], ["joint1"], NOW_S - 1.0)
    plan = planned(message)
    assert plan.approach and plan.entry_ns == 10**9
    with pytest.raises(refusals.VelocityBeyondLimit):
        planned(goal([point(2, [0.2])], ["joint1"], NOW_S - 1.5))


@settings(max_examples=examples(40), deadline=None)
@given(st.floats(0.0, 2.9))
def test_an_entry_is_always_near_the_arm_and_never_late_without_need(late_s):
    plan = planned(slow_way(NOW_S - late_s))
    distance = float(PlannedPath(plan).at(np.array([plan.entry_ns]))[0][0, 0])
    assert distance <= 0.05
    elapsed_ns = NOW_NS - plan.start_ns if plan.start_ns else 0
    assert elapsed_ns == plan.entry_ns
    assert plan.entry_ns == pytest.approx(late_s * 1e9, abs=300) or distance > 0.75 * 0.8 * 0.05


# --- the end --------------------------------------------------------------------------------------------


def moving_end(velocity=0.3):
    return one_joint(point(0, [0.0], [0.0]), point(1, [0.15], [velocity]))


def test_a_moving_end_needs_the_setting():
    with pytest.raises(refusals.EndsMoving, match="allow_nonzero_velocity_at_trajectory_end"):
        planned(moving_end())
    assert planned(moving_end(), allow_nonzero_end_velocity=True).joints[-1, 0, 1] == 0.3


@pytest.mark.parametrize("velocity", [0.3, 9e-4])
def test_behind_a_moving_end_nothing_is_judged(velocity):
    """The control process brings the clock to rest where the path ends; its last segment is a hard, short one."""
    points = [point(0, [0.0], [0.0]), point(1, [0.2], [velocity]), point(1.0005, [0.2 + velocity * 0.0005], [velocity])]
    planned(one_joint(*points), allow_nonzero_end_velocity=True)


def test_partial_goals_can_be_forbidden():
    with pytest.raises(refusals.PartialGoal, match="The goal leaves out joint2, joint3") as refused:
        planned(moving_end(0.0), allow_partial_joints_goal=False)
    assert refused.value.code == -2


# --- streams --------------------------------------------------------------------------------------------


def test_a_stream_may_end_in_motion_and_its_first_point_may_be_near():
    """From rest it is too near: the arm follows, with a lag that is no limit the message would break."""
    plan = streamed(one_joint(point(0.01, [0.004], [0.4])))
    assert plan.stream and plan.wanted is not None and plan.reason is None
    plan = streamed(one_joint(point(1.0, [0.1], [0.1])))
    assert plan.stream and plan.approach and plan.wanted is None, "what can be done in time is handed on as it came"
    with pytest.raises(refusals.GoalRefused):
        planned(one_joint(point(0.01, [0.004], [0.4])))


def test_a_stream_needs_room_to_stop():
    upper = ARM.joints[0].upper_rad
    at = present([upper - 0.02, 0, 0, 0, 0, 0])
    plan = streamed(one_joint(point(0.01, [upper - 0.02], [0.4])), at)
    assert isinstance(plan.reason, refusals.NoRoomToStop)
    assert "joint1 moving at 0.4000 rad/s, and stopping from there ends at" in plan.reason.sentence
    assert plan.joints[:, 0, 0].max() <= upper
    assert streamed(one_joint(point(0.01, [upper - 0.02], [0.0])), at).reason is None
    assert streamed(one_joint(point(0.01, [upper - 0.02], [-0.4])), at).reason is None


def test_even_the_shortest_stop_takes_its_time():
    """joint5 could brake within 15 ms, but the control process tries no stop below 76 ms, a fortieth of the longest."""
    upper = ARM.joints[4].upper_rad
    message = one_joint(point(0.01, [upper - 0.005], [0.15]), name="joint5")
    assert isinstance(streamed(message, present([0, 0, 0, 0, upper - 0.005, 0])).reason, refusals.NoRoomToStop)


def test_a_stream_must_not_speed_up_beyond_the_limit_behind_its_last_point():
    """The acceleration there fades within 25 ms and adds a third of what it would have added in that time."""
    at = present([0.0] * 6)
    assert streamed(one_joint(point(0.01, [0.0], [0.41], [0.5])), at).reason is None
    reason = streamed(one_joint(point(0.01, [0.0], [0.41], [1.8])), at).reason
    assert isinstance(reason, refusals.VelocityBeyondLimit)
    assert "joint1 would move at 0.4250 rad/s at 0.0100 s" in reason.sentence
    assert streamed(one_joint(point(0.01, [0.0], [0.41], [-1.8])), at).reason is None


def test_a_stream_is_judged_as_the_arm_will_run_on_past_it():
    """A change of velocity between the last two points, a millisecond apart, is no standstill behind them."""
    message = goal([point(0.0102, [0.0], [0.0]), point(0.0112, [-0.00013], [-0.27])], ["joint3"])
    assert isinstance(streamed(message).reason, refusals.AccelerationBeyondLimit)


def test_a_stamp_long_past_is_refused_without_a_long_search():
    message = goal([point(0.0, [1.0], [0.0]), point(2_000_000_000, [1.1], [0.0])], ["joint1"], NOW_S - 1_900_000_000)
    begun = time.monotonic()
    with pytest.raises(refusals.TooFar):
        planned(message)
    assert time.monotonic() - begun < 5.0


@pytest.mark.parametrize(
    "message",
    [
        one_joint(point(0.01, [NAN], [0.0])),
        one_joint(point(0.01, [9.0], [0.0])),
        goal([]),
        goal([point(0, [0.0])], ["elbow"]),
        goal([point(0, ZERO)], stamp_s=NOW_S - 1.0),
        one_joint(point(0.01, [0.0], [0.0], effort=[1.0])),
    ],
)
def test_a_bad_message_of_a_stream_is_refused_like_a_goal(message):
    with pytest.raises(refusals.GoalRefused):
        streamed(message)


def test_tolerances_default_replace_and_switch_off():
    message = goal([point(0, ZERO)])
    message.path_tolerance = [tolerance("joint3", 0.2, 0.3, 0.4), tolerance("joint1", -1.0)]
    message.goal_tolerance = [tolerance("joint2", 0.5, 0.7, 0.9), tolerance("joint6", 0.0, -1.0 - 1e-8)]
    message.goal_tolerance.append(tolerance("joint5", math.inf))
    terms = planned(message).terms
    way, arrival = [0.1, 0.0, 0.0], [0.01, 0.05, 0.0]
    assert terms.path_tolerances.tolist() == [[0.0, 0.0, 0.0], way, [0.2, 0.3, 0.4], way, way, way]
    last = [[0.0, 0.05, 0.0], [0.01, 0.0, 0.0]]
    assert terms.goal_tolerances.tolist() == [arrival, [0.5, 0.7, 0.9], arrival, arrival, *last]
    assert terms.goal_time_s == 0.4


def test_the_defaults_are_the_settings_of_the_moment():
    changed = {
        "path_tolerance_rad": tuple(0.1 * i for i in range(6)),
        "stopped_velocity_rad_s": 0.2,
        "goal_time_s": 2.0,
    }
    terms = planned(goal([point(0, ZERO)]), **changed).terms
    assert terms.path_tolerances[:, 0].tolist() == [0.1 * i for i in range(6)]
    assert set(terms.goal_tolerances[:, 1]) == {0.2} and terms.goal_time_s == 2.0


@pytest.mark.parametrize(("given_s", "expected_s"), [(0.0, 0.4), (1.5, 1.5), (-1.0, 0.0)])
def test_goal_time(given_s, expected_s):
    message = goal([point(0, ZERO)])
    message.goal_time_tolerance = duration(given_s)
    assert planned(message).terms.goal_time_s == expected_s


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (
            tolerance("joint1", -0.5),
            "path_tolerance position of joint1 is -0.5; allowed are a positive limit",
        ),
        (tolerance("joint1", NAN), "path_tolerance position of joint1 is nan"),
        (tolerance("joint1", 0.1, -2.0), "path_tolerance velocity of joint1 is -2; allowed"),
        (tolerance("elbow", 0.1), "'elbow' in path_tolerance is no joint"),
    ],
)
def test_bad_tolerances(entry, words):
    message = goal([point(0, ZERO)])
    message.path_tolerance = [entry]
    with pytest.raises(refusals.GoalRefused, match=words):
        planned(message)


def test_a_bad_goal_time():
    message = goal([point(0, ZERO)])
    message.goal_time_tolerance = duration(-3.0)
    with pytest.raises(refusals.BadTolerance, match=r"goal_time_tolerance \(s\) is -3"):
        planned(message)


def test_the_residue_of_a_planners_last_velocity_stays_in_the_plan():
    plan = planned(one_joint(point(0, [0.0], [0.0]), point(1, [0.1], [5e-4])))
    assert plan.joints[-1, 0, 1] == 5e-4


def test_a_residual_segment_is_not_judged_by_its_curvature():
    # 1.3e-7 rad in 0.36 ms, as at the end of near_limits_low: 6 rad/s² on paper, nothing for a drive
    message = one_joint(point(0, [0.0], [0.0]), point(1, [0.1], [0.0]), point(1.00036, [0.10000013], [0.0]))
    planned(message)


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_ripple_in_step_with_the_cycle_is_judged_at_the_speed_that_finds_it(share):
    """At full speed every cycle finds the same positions; at half of it they swing by a quarter of v times a cycle."""
    half_s = 0.5 / ARM.control.rate_hz
    swing = share * 2.0 * 4.0 / ARM.control.rate_hz  # joint1 may accelerate with twice its 2 rad/s²
    points = [point(i * half_s, [0.0], [swing * min(i / 40, 1.0, (120 - i) / 40) * (-1) ** i]) for i in range(121)]
    if share < 1.0:
        planned(one_joint(*points))
        return
    with pytest.raises(refusals.AccelerationBeyondLimit) as refused:
        planned(one_joint(*points))
    assert 4.0 < refused.value.value <= 4.0 * share * (1 + 1e-6)
    assert "noisy or rounded, thin them to 16.7 ms or smooth them" in str(refused.value)
    assert "points only 4.17 ms apart" in str(refused.value)


def test_noise_is_judged_by_what_a_drive_gets_of_it():
    """Positions in whole counts every 2 ms: velocities jump by twice of what a cycle allows, setpoints do not."""
    count_rad, times_s = 4e-5, np.arange(0, 1.0005, 0.002)
    positions = np.round(0.1 * (3 * times_s**2 - 2 * times_s**3) / count_rad) * count_rad
    planned(one_joint(*[point(t, [p]) for t, p in zip(times_s, positions, strict=True)]))


def test_points_that_are_apart_are_not_called_noisy():
    with pytest.raises(refusals.AccelerationBeyondLimit, match=r"more time or smooth it there\.$"):
        planned(one_joint(point(0, [0.0], [0.0]), point(0.2, [0.05], [0.0])))


@pytest.mark.parametrize(("top_s", "accepted"), [(0.002, True), (0.02, False)])
def test_velocity_is_judged_as_the_mean_over_a_cycle(top_s, accepted):
    """Between two points the velocity rises to 0.46 rad/s for a moment; allowed are 0.4398."""
    fast = (0.46 - 0.43) * top_s * 2 / 3
    points = [
        point(0, [0.0], [0.0]),
        point(0.5, [0.1075], [0.43]),
        point(0.5 + top_s, [0.1075 + 0.43 * top_s + fast], [0.43]),
        point(1.0 + top_s, [0.215 + 0.43 * top_s + fast], [0.0]),
    ]
    if accepted:
        planned(one_joint(*points))
        return
    with pytest.raises(refusals.VelocityBeyondLimit, match=r"joint1 would move at 0\.4"):
        planned(one_joint(*points))


def some_points(seed):
    """Random points of joint1 from rest to rest, closer together and farther apart than a cycle of 8.3 ms."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 30))
    times_ns = np.concatenate([[0], np.cumsum(rng.integers(200_000, 10 ** rng.uniform(6, 8), count - 1))])
    velocities = rng.uniform(-1, 1, count) * 0.02 * rng.uniform(0.3, 1.5)
    velocities[[0, -1]] = 0.0
    steps = np.diff(times_ns) / 1e9 * (velocities[1:] + velocities[:-1]) / 2
    positions = np.concatenate([[0.0], np.cumsum(steps)])
    return times_ns, positions, velocities


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10**9))
def test_second_differences_are_judged_exactly(seed):
    """Accepted or refused as dense sampling by scipy says, for setpoints that are any time up to a cycle apart."""
    times_ns, positions, velocities = some_points(seed)
    rows = zip(times_ns, positions, velocities, strict=True)
    message = one_joint(*[point(float(t) / 1e9, [p], [v]) for t, p, v in rows])
    period_s, end_s, steps = 1.0 / ARM.control.rate_hz, times_ns[-1] / 1e9, 100
    fine_s = np.clip(np.arange(-2 * period_s, end_s + 2 * period_s, period_s / steps), 0.0, end_s)
    fine = CubicHermiteSpline(times_ns / 1e9, positions, velocities)(fine_s)
    bends = [np.abs(fine[2 * k :] - 2 * fine[k:-k] + fine[: -2 * k]).max() for k in range(1, steps + 1)]
    share = max(bends) / (4.0 * period_s**2)
    try:
        planned(message)
        assert share <= 1.0 + 1e-6
    except refusals.AccelerationBeyondLimit as refused:
        assert share >= 0.95
        assert refused.value / 4.0 <= 1.05 * share


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10**9), st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_what_is_accepted_keeps_the_limit_at_any_phase_and_rate(seed, rate, phase):
    """The second difference of setpoints a cycle apart, while the trajectory clock runs at a rate of at most 1."""
    times_ns, positions, velocities = some_points(seed)
    rows = zip(times_ns, positions, velocities, strict=True)
    message = one_joint(*[point(float(t) / 1e9, [p], [v]) for t, p, v in rows])
    try:
        planned(message)
    except refusals.AccelerationBeyondLimit:
        return
    period_s, end_s = 1.0 / ARM.control.rate_hz, times_ns[-1] / 1e9
    clock_s = rate * period_s * (np.arange(-2, end_s / (rate * period_s) + 3) + phase)
    setpoints = CubicHermiteSpline(times_ns / 1e9, positions, velocities)(np.clip(clock_s, 0.0, end_s))
    assert np.abs(np.diff(setpoints, 2)).max() / period_s**2 <= 4.0 * (1 + 1e-6)


def test_an_arm_at_its_limit_may_leave_it():
    upper = ARM.joints[1].upper_rad + ARM.joints[1].encoder_count_rad
    planned(one_joint(point(0, [upper]), point(5, [1.0]), name="joint2"), present([0, upper, 0, 0, 0, 0]))


def test_a_very_long_trajectory_costs_no_more_than_its_points():
    message = one_joint(point(0, [0.0], [0.0]), point(2_000_000, [1.0], [0.0]))
    planned(message)
    message = one_joint(point(0, [0.0], [0.0]), point(1_000_000, [1.0], [0.44]), point(2_000_000, [1.0], [0.0]))
    with pytest.raises(refusals.BeyondLimits):
        planned(message)


def test_points_that_last_for_too_short_a_time_to_stop_in():
    points = [point(0.00005 * i, [0.0]) for i in range(8000)]
    sentence = r"The 4000 points from point 0 on last only 0\.2000 s, .* at least 1\.52\d+ s ahead to be able to stop"
    with pytest.raises(refusals.TooDense, match=sentence):
        planned(one_joint(*points))
    planned(one_joint(*points[:4000]))
    longest_s = ARM.longest_stop_s
    planned(one_joint(*[point(0.501 * longest_s / 4000 * i, [0.0]) for i in range(8000)]))
    with pytest.raises(refusals.TooDense):
        planned(one_joint(*[point(0.499 * longest_s / 4000 * i, [0.0]) for i in range(8000)]))


def test_the_points_that_are_put_between_count_too():
    """In the tutorial's way of interpolating, 15 between each two."""
    dense = [point(0.002 * i, [0.0]) for i in range(400)]
    planned(one_joint(*dense))
    with pytest.raises(refusals.TooDense, match=r"The 250 points from point 0 on last only 0\.5000 s"):
        planned(one_joint(*dense), arm=LINEAR)


LINEAR = load_arm("episode1", overrides={"trajectory": {"interpolation": "linear"}})


def test_the_tutorials_densification():
    points = [point(0.1 * i, [0.0001 * i], [0.001]) for i in range(104)] + [point(10.4, [0.0104], [0.0])]
    plan = planned(one_joint(*points), arm=LINEAR)
    assert len(plan.times_ns) == 1665
    assert set(plan.orders.tolist()) == {1}
    assert plan.times_ns[::16].tolist() == [100_000_000 * i for i in range(105)]
    assert np.diff(plan.times_ns).tolist() == [6_250_000] * 1664
    assert plan.joints[::16, 0, 0] == pytest.approx([0.0001 * i for i in range(105)])


def test_straight_lines_are_refused_where_their_corners_ask_for_too_much():
    with pytest.raises(refusals.AccelerationBeyondLimit, match=r"joint\d would accelerate with"):
        message = recorded("scale_1_0")
        planned(message, present(message.trajectory.points[0].positions), LINEAR)


def test_densification_counts_against_the_most_points():
    arm = load_arm("episode1", overrides={"trajectory": {"interpolation": "linear", "max_points": 33}})
    planned(one_joint(*[point(i, [0.0]) for i in range(3)]), arm=arm)
    with pytest.raises(refusals.TooManyPoints):
        planned(one_joint(*[point(i, [0.0]) for i in range(4)]), arm=arm)


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), min_size=0, max_size=20), st.integers(1, 20))
def test_densified_times_rise_and_keep_the_given_waypoints(gaps_ns, factor):
    times = np.concatenate([[0], np.cumsum(np.array(gaps_ns, dtype=np.int64))]).astype(np.int64)
    waypoints = np.arange(len(times), dtype=float)[:, np.newaxis, np.newaxis] * np.ones((1, 2, 3))
    dense_times, dense = densify(times, waypoints, factor)
    assert (np.diff(dense_times) > 0).all()
    for at, value in zip(times, waypoints, strict=True):
        assert (dense[dense_times.tolist().index(at)][:, :2] == value[:, :2]).all()


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**6))
def test_whatever_is_accepted_keeps_the_limits_everywhere(seed):
    """Random quintic goals: an accepted one, sampled finely by scipy, is inside the limits."""
    rng = np.random.default_rng(seed)
    joint = ARM.joints[0]
    count = int(rng.integers(2, 8))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.005, 1.5, count - 1))])
    rows = np.stack(
        [
            np.concatenate([[2.3], 2.3 + np.cumsum(rng.normal(0, 0.1, count - 1))]),
            rng.normal(0, 0.2, count),
            rng.normal(0, 1.0, count),
        ]
    )
    rows[1, -1] = 0.0
    message = one_joint(*[point(t, [p], [v], [a]) for t, p, v, a in zip(times, *rows, strict=True)])
    times = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.trajectory.points])
    spline = BPoly.from_derivatives(times, rows.T[:, :])
    period = 1.0 / ARM.control.rate_hz
    fine, cycles = np.linspace(0, times[-1], 4000), np.arange(0, times[-1], period)
    inside = spline(fine).max() <= joint.upper_rad + 1e-4
    slow = np.abs(np.diff(spline(cycles))).max(initial=0.0) / period <= 1.05 * joint.max_velocity_rad_s * (1 + 1e-6)
    soft = np.abs(np.diff(spline(cycles), 2)).max(initial=0.0) / period**2 <= 4.0 * (1 + 1e-6)
    try:
        planned(message, present([2.3, 0, 0, 0, 0, 0]))
    except refusals.BeyondLimits:
        return
    assert inside and slow and soft


def test_a_name_from_outside_is_shown_on_one_printable_line_of_bounded_length():
    """What a sender calls a joint goes into logs and onto terminals."""
    message = recorded("small")
    message.trajectory.joint_names[0] = "x\x1b[31m\n" + "y" * 10_000
    with pytest.raises(refusals.UnknownJoint) as refused:
        plan_goal(message, ARM, present(), Settings.of(ARM))
    assert refused.value.sentence.startswith("'x\\x1b[31m\\nyyy")
    assert refused.value.sentence.isprintable() and len(refused.value.sentence) < 250
