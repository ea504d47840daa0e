"""Cases 57 to 72: what a trajectory asks for between, before and after its points."""

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
import pytest
from stage import ABORTED, SUCCEEDED, upstream_arm
from trajectory_messages import NS, goal, point, trajectory

from config.errors import ConfigError
from rosfront.path import PlannedPath
from rosfront.refusals import NotServing

ZERO = (0.0, 0.0, 0.0)


def all_joints(value: float) -> Sequence[float]:
    return [value] * 3


def ask(stage, begun_ns, at_s):
    """What `~/query_state` says of a moment of the trajectory that began at `begun_ns` on the clock of ROS."""
    sample = stage.serving.sample(begun_ns + round(at_s * NS))
    return [float(values[0]) for values in (sample.position_rad, sample.velocity_rad_s, sample.acceleration_rad_s2)]


@pytest.mark.upstream(57, "same")
def test_no_points_and_the_beginning_of_a_trajectory(stage_for):
    stage = stage_for(start=ZERO)
    assert stage.finish(goal()).outcome == (ABORTED, -1)
    with pytest.raises(NotServing, match=r"No trajectory is being executed"):
        stage.serving.sample(stage.epoch_ns)
    stage.run(0.3)
    sent = stage.send(goal(point(0.5, all_joints(0.1))))
    assert sent.plan.start_ns == 0
    stage.cycle()
    assert stage.clocks_s[-1] == pytest.approx(stage.period_s), "it begins with the first cycle that sees it"
    stage.until(lambda: sent.ended)

    stamped_ns = stage.epoch_ns + NS
    sent = stage.send(goal(point(0.5, ZERO), stamp_ns=stamped_ns))
    assert sent.plan.start_ns == stage.arm.now_ns + NS
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.epoch_ns - stamped_ns == pytest.approx(0.5 * NS, abs=0.05 * NS)


@pytest.mark.upstream(
    58,
    "better",
    why="The points are met without the steps of velocity of straight lines, which `interpolation: linear` gives.",
)
@pytest.mark.parametrize("interpolation", ["spline", "linear"])
def test_positions_alone(stage_for, interpolation):
    stage = stage_for(start=ZERO, trajectory={"interpolation": interpolation})
    begun = len(stage.setpoints)
    begun_ns = stage.epoch_ns
    sent = stage.send(goal(*(point(s, all_joints(s)) for s in (1, 2, 3))))
    stage.run(0.1)
    for outside_s in (-0.5, 3.125, 30):
        with pytest.raises(NotServing, match=r"runs from 0\.000 to 3\.000 s: ask for a time in between"):
            ask(stage, begun_ns, outside_s)
    for at_s in (1, 2):
        assert ask(stage, begun_ns, at_s)[0] == pytest.approx(at_s, abs=1e-9)
    if interpolation == "linear":
        for at_s in (0.5, 1.5, 2.5):
            assert ask(stage, begun_ns, at_s) == pytest.approx([at_s, 1.0, 0.0], abs=1e-6)
    stage.until(lambda: sent.ended)
    command = stage.command_since(begun)[:, 0]
    for at_s in (1, 2, 3):
        assert command[round(at_s / stage.period_s) - 1] == pytest.approx(at_s, abs=1e-6)
    assert (np.diff(command) >= -1e-12).all(), "it never turns back between points"
    stage.run(2.0)
    assert stage.commanded.tolist() == all_joints(3.0)
    velocity_step = np.abs(np.diff(command, 2)).max() / stage.period_s
    assert velocity_step == pytest.approx(1.0, abs=1e-3) if interpolation == "linear" else velocity_step < 0.05


def played(stage, first, second):
    """Play two points one and three seconds after the start, then a third at rest; what is between the first two."""
    begun = len(stage.setpoints)
    begun_ns = stage.epoch_ns
    sent = stage.send(goal(first, second, point(4, all_joints(6), ZERO, ZERO)))
    stage.run(0.1)

    def at(seconds):
        return ask(stage, begun_ns, 1 + seconds)

    asked = [at(seconds) for seconds in np.arange(0, 2, stage.period_s)]
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0), sent.sentence
    commanded = stage.command_since(begun)[round(1 / stage.period_s) - 1 :][: len(asked), 0]
    assert commanded == pytest.approx([position for position, _, _ in asked], abs=1e-6)
    return lambda seconds: PlannedPath(sent.plan).at(np.array([round((1 + seconds) * NS)]))


def values(sample):
    return [float(array[0, 0]) for array in sample]


@pytest.mark.upstream(59, "same")
def test_cubic(stage_for):
    stage = stage_for(start=ZERO)
    first, second = point(1, ZERO, all_joints(-2)), point(3, all_joints(4), all_joints(10), all_joints(20))
    between = played(stage, first, second)
    assert values(between(sqrt(2))) == pytest.approx([0, 4, 6 * sqrt(2)], abs=1e-6)


@pytest.mark.upstream(60, "same")
def test_quintic(stage_for):
    stage = stage_for(start=ZERO)
    first = point(1, ZERO, all_joints(24), all_joints(-100))
    between = played(stage, first, point(3, ZERO, all_joints(4), ZERO))
    assert values(between(1.0)) == pytest.approx([0, -6, 10], abs=1e-6)


def refused_without_positions(stage, fields):
    points = [point(second, **row) for second, row in enumerate(fields, 1)]
    for sent in (stage.finish(goal(*points)), stage.publish(trajectory(*points))):
        assert sent.outcome == (ABORTED, -1)
        assert sent.sentence.startswith("Point 0 has 0 positions for 3 joint names")
    stage.assert_stands()
    assert not stage.commanded.any()


@pytest.mark.upstream(
    [61, 62, 63],
    "different",
    why="Nothing is integrated: points without positions are refused, and the arm stands.",
)
@pytest.mark.parametrize(
    "fields",
    [
        pytest.param([{"velocities": all_joints(v)} for v in (1, 2, 1)], id="61"),
        pytest.param([{"velocities": all_joints(v)} for v in (2, 1)], id="62"),
        pytest.param([{"accelerations": all_joints(a)} for a in (1, 2, 1)], id="63"),
    ],
)
def test_points_without_positions(stage_for, fields):
    refused_without_positions(stage_for(start=ZERO), fields)


@pytest.mark.upstream(72, "same")
def test_points_without_anything(stage_for):
    refused_without_positions(stage_for(start=ZERO), [{}, {}, {}])


@pytest.mark.upstream(
    71, "different", why="Nothing is integrated: refused as a whole, however short the segment that lacks positions is."
)
def test_a_short_last_segment_without_positions(stage_for):
    stage = stage_for(start=ZERO)
    sent = stage.finish(goal(point(1, all_joints(0.1), ZERO), point(1.001, (), ZERO)))
    assert sent.outcome == (ABORTED, -1) and sent.sentence.startswith("Point 1 has 0 positions")
    stage.assert_stands()


@pytest.mark.upstream(64, "same")
def test_a_start_state_is_at_rest(stage_for):
    stage = stage_for(start=ZERO)
    begun = len(stage.setpoints)
    sent = stage.send(
        goal(point(1, all_joints(1), all_joints(0.5), all_joints(2)), point(2, all_joints(1.2), ZERO, ZERO))
    )
    position, velocity, acceleration = values(PlannedPath(sent.plan).at(np.array([0])))
    assert (position, velocity, acceleration) == (0, 0, 0)
    assert sent.plan.orders.tolist() == [5, 5]
    stage.until(lambda: sent.ended)
    # a quintic from rest: position, velocity and acceleration all begin at zero
    first = stage.command_since(begun)[:3, 0]
    assert 0 < first[0] < 1e-4 and first[1] / first[0] == pytest.approx(8, rel=0.1)


@pytest.mark.upstream(
    65,
    "different",
    why="There is no stepping from waypoint to waypoint; the arm file offers spline and linear and refuses `none`.",
)
def test_interpolation_none(stage_for):
    with pytest.raises(ConfigError, match="interpolation is the text 'none', but must be 'spline' or 'linear'"):
        upstream_arm(trajectory={"interpolation": "none"})
    stage = stage_for(start=ZERO, gentle=True)
    sent = stage.send(goal(point(1, all_joints(1)), point(2, ZERO)))
    stage.run(0.5)
    assert 0.3 < stage.commanded[0] < 0.7
    stage.until(lambda: sent.ended)
    stage.assert_never_stepped()


@pytest.mark.upstream(66, "same")
def test_a_new_message_restarts_the_sampling(stage_for):
    stage = stage_for(start=ZERO)
    assert stage.finish(goal(point(1, all_joints(1), ZERO, ZERO))).outcome == (SUCCEEDED, 0)
    for target in (all_joints(3), all_joints(0.5)):
        origin = stage.commanded[0]
        begun = len(stage.setpoints)
        sent = stage.finish(goal(point(1, target, ZERO, ZERO)))
        assert sent.outcome == (SUCCEEDED, 0)
        assert stage.clocks_s[begun] == pytest.approx(stage.period_s)
        half_way = stage.command_since(begun)[round(0.5 / stage.period_s) - 1]
        assert half_way == pytest.approx(all_joints((origin + target[0]) / 2), abs=1e-6)


@pytest.mark.upstream([67, 70], "same")
def test_angles_are_taken_as_they_are(stage_for):
    stage = stage_for(start=ZERO)
    assert stage.finish(goal(point(1, all_joints(0.1)))).outcome == (SUCCEEDED, 0)
    assert stage.finish(goal(point(1, all_joints(0.1)))).outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(all_joints(0.1), abs=1e-12)


@pytest.mark.upstream(
    [68, 69],
    "different",
    why="No joint is continuous: each has limits and turns to the angle that is named, the way the points go.",
)
@pytest.mark.parametrize("target", [(1.5 * pi, 0.0, 0.0), all_joints(1.5 * pi)])
def test_no_joint_takes_the_short_way_round(stage_for, target):
    stage = stage_for(start=ZERO)
    begun = len(stage.setpoints)
    assert stage.finish(goal(point(1, target))).outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(target, abs=1e-9)
    command = stage.command_since(begun)
    assert (command >= -1e-9).all() and (command[:, 0] > pi).any()


@pytest.mark.upstream(
    "A6",
    "better",
    why="The interpolant itself is checked: refused with the joint, the angle and the place between the points.",
)
def test_a_cubic_that_leaves_the_limits_between_legal_points(stage_for):
    stage = stage_for(start=ZERO)
    near = stage.arm.arm.joints[0].upper_rad - 0.1
    assert stage.finish(goal(point(1, [near, 0, 0]))).outcome == (SUCCEEDED, 0)
    stage.configure(allow_partial_joints_goal=True)
    beyond = goal(point(0, [near], [4.0]), point(1, [near], [-4.0]), point(2, [0.0], [0.0]), names="a")
    sent = stage.finish(beyond)
    assert sent.outcome == (ABORTED, -1)
    assert sent.sentence.startswith("a would be at 13.46") and "between points 0 and 1" in sent.sentence
    stage.assert_stands()
