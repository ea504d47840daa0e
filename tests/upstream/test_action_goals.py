"""Cases 1 to 21: goals of the action from their acceptance to their end."""

import numpy as np
import pytest
from stage import ABORTED, CANCELED, START, SUCCEEDED, away
from trajectory_messages import goal, point, tolerance, tolerances

from rosfront.path import PlannedPath
from shm.words import Mode, Request

TARGET = (1.0, 2.0, 3.0)
HALF_WAY, FAR = (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)
BOTH_DRIVES = pytest.mark.parametrize("drives", ["mock", "zdt"])


def at(expected, within=1e-3):
    return pytest.approx(expected, abs=within)


@pytest.mark.upstream(1, "same")
@BOTH_DRIVES
def test_one_point_is_reached_and_held(stage_for, drives):
    stage = stage_for(drives)
    assert stage.finish(goal(point(0.5, TARGET))).outcome == (SUCCEEDED, 0)
    stage.assert_stands()
    assert stage.commanded == at(TARGET) and stage.measured == at(TARGET)


@pytest.mark.upstream(2, "better", why="The arm comes to rest at the last point; no velocity goes on being commanded.")
def test_one_point_with_a_velocity_ends_at_rest(stage_for):
    stage = stage_for()
    stage.configure(allow_nonzero_end_velocity=True)
    assert stage.finish(goal(point(0.5, TARGET, [1, 1, 1]))).outcome == (SUCCEEDED, 0)
    assert stage.commanded == at(TARGET, 1e-9)
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(3, "same")
def test_two_points_with_feedback_on_the_way(stage_for):
    stage = stage_for()
    sent = stage.finish(goal(point(0.2, HALF_WAY), point(0.3, FAR)))
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.running.count(sent.execution.goal_id) >= 30
    assert any(np.abs(setpoint - HALF_WAY).max() < 1e-3 for setpoint in stage.setpoints)
    stage.assert_stands()
    assert stage.commanded == at(FAR)


@pytest.mark.upstream(4, "better", why="The arm comes to rest at the last point; no velocity goes on being commanded.")
def test_two_points_with_velocities_end_at_rest(stage_for):
    stage = stage_for()
    stage.configure(allow_nonzero_end_velocity=True)
    sent = stage.finish(goal(point(0.2, HALF_WAY, [1, 1, 1]), point(0.3, FAR, [2, 2, 2])))
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.commanded == at(FAR, 1e-9)
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(5, "same")
@BOTH_DRIVES
def test_one_point_with_goal_tolerances(stage_for, drives):
    stage = stage_for(drives)
    assert stage.finish(goal(point(0.5, TARGET), arrival=tolerances(0.1))).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(6, "same")
def test_two_points_with_goal_tolerances(stage_for):
    stage = stage_for()
    sent = stage.finish(goal(point(0.2, HALF_WAY), point(0.3, FAR), arrival=tolerances(0.1)))
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.running.count(sent.execution.goal_id) >= 30


@pytest.mark.upstream([7, 8, 9], "same")
def test_each_goal_has_its_own_tolerances_and_the_defaults_come_back(stage_for):
    stage = stage_for()
    settings = stage.serving.settings
    default_path = [[limit, 0.0, 0.0] for limit in settings.path_tolerance_rad]
    default_goal = [[limit, settings.stopped_velocity_rad_s, 0.0] for limit in settings.goal_tolerance_rad]

    def allowed(message):
        sent = stage.send(message)
        stage.run(0.1)
        found = stage.path_tolerances.tolist(), stage.goal_tolerances.tolist(), float(stage.path["goal_time_s"])
        stage.until(lambda: sent.ended)
        assert sent.outcome == (SUCCEEDED, 0)
        return found

    defaults = (default_path, default_goal, settings.goal_time_s)
    assert allowed(goal(point(0.5, TARGET))) == defaults
    own = goal(
        point(0.5, START),
        path=[tolerance("b", 0.3), tolerance("c", 0.4), tolerance("a", 0.2)],
        arrival=[tolerance("c", 0.3, 3.0), tolerance("a", 0.1, 1.0), tolerance("b", 0.2, 2.0)],
        time_s=2.0,
    )
    path, arrival, time_s = allowed(own)
    assert path == [[0.2, 0, 0], [0.3, 0, 0], [0.4, 0, 0]]
    assert arrival == [[0.1, 1.0, 0], [0.2, 2.0, 0], [0.3, 3.0, 0]]
    assert time_s == 2.0
    assert allowed(goal(point(0.5, TARGET))) == defaults


@pytest.mark.upstream(10, "same")
def test_a_newer_goal_aborts_the_older_one_at_once(stage_for):
    stage = stage_for()
    older = stage.send(goal(point(2.0, HALF_WAY)))
    stage.run(0.2)
    newer = stage.send(goal(point(1.0, FAR)))
    stage.run(0.03)
    assert older.outcome == (ABORTED, -1) and "replaced by a newer goal" in older.sentence
    stage.until(lambda: newer.ended)
    assert newer.outcome == (SUCCEEDED, 0)
    assert stage.commanded == at(FAR)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    11,
    "better",
    why="Comes to rest on its path, without a step back; the sentence names joint, error and limit.",
)
def test_stuck_joints_break_the_path_tolerance(stage_for):
    stage = stage_for("zdt")
    stage.configure(path_tolerance_rad=(1e-4,) * 3)
    stage.hold_shafts()
    sent = stage.finish(goal(point(0.0, START), point(0.1, away(0.05))))
    assert sent.outcome == (ABORTED, -4)
    assert "rad from its setpoint and 0.0001 rad are allowed" in sent.sentence
    stage.until(lambda: stage.mode is Mode.HOLDING)
    assert ((stage.commanded >= np.array(START) - 1e-3) & (stage.commanded <= np.array(away(0.05)))).all()
    assert stage.measured == at(START)
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    12,
    "better",
    why="A target out of reach at time 0 is refused (−1) and never commanded; where one is merely not reached, −5.",
)
def test_the_time_to_arrive_is_exceeded(stage_for):
    stage = stage_for("zdt")
    stage.configure(goal_tolerance_rad=(0.1,) * 3, goal_time_s=1e-6, path_tolerance_rad=(0.0,) * 3)
    refused = stage.finish(goal(point(0.0, HALF_WAY), time_s=1.0))
    assert refused.outcome == (ABORTED, -1) and "The first point has b at 5.0000 rad" in refused.sentence
    stage.assert_stands()
    assert stage.commanded == at(START)

    stage.hold_shafts()
    sent = stage.send(goal(point(0.5, away(0.2)), time_s=0.3))
    stage.run(0.7)
    assert not sent.ended
    stage.run(0.2)
    assert sent.outcome == (ABORTED, -5)
    assert "rad from its target when the time to arrive was over, and 0.1000 rad are allowed" in sent.sentence
    stage.assert_never_stepped()


@pytest.mark.upstream(
    13, "better", why="A first point that is not where the arm stands is refused (−1); nothing of it is commanded."
)
def test_a_single_point_elsewhere_at_time_zero(stage_for):
    stage = stage_for("zdt")
    stage.configure(path_tolerance_rad=(1e-4,) * 3)
    stage.hold_shafts()
    sent = stage.finish(goal(point(0.0, HALF_WAY)))
    assert sent.outcome == (ABORTED, -1) and "plan from the present state" in sent.sentence
    stage.assert_stands()
    assert stage.commanded == at(START)


@pytest.mark.upstream(
    14,
    "better",
    why="The stop begins at the commanded state and stays on the path; upstream steps to the measured one.",
)
@BOTH_DRIVES
def test_a_cancel_stops_on_the_path(stage_for, drives):
    stage = stage_for(drives, gentle=True)
    sent = stage.send(goal(point(1.0, away(1.0))))
    stage.run(0.5)
    stage.cancel(sent)
    stage.until(lambda: sent.ended, 1.0)
    assert sent.outcome == (CANCELED, 0) and sent.sentence.startswith(
        "Canceled: the arm is at rest and has not left its path"
    )
    moved = stage.commanded - START
    assert moved == at(moved[0], 1e-3) and 0.5 < moved[0] < 1.0
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    [15, 16],
    "better",
    why="Every cancel decelerates within the joints' limits, whatever is configured, and all joints stay on the path.",
)
@pytest.mark.parametrize("shares", [(1.0, 1.0, 1.0), (1.0, 0.5, -0.2)])
def test_a_cancel_always_decelerates(stage_for, shares):
    stage = stage_for(gentle=True)
    sent = stage.send(goal(point(1.0, away(1.0, *shares))))
    stage.run(0.5)
    stage.cancel(sent)
    stage.run(0.02)
    assert stage.velocity[0] > 0.5, "one step would be no deceleration"
    stage.run(0.48)
    assert sent.outcome == (CANCELED, 0)
    assert not stage.velocity.any()
    moved = stage.commanded - START
    assert moved == at(moved[0] * np.array(shares), 1e-9)
    stage.assert_never_stepped()


MOVING_END = goal(point(0.2, HALF_WAY, [1, 1, 1]), point(0.3, FAR, [0.1, 0.0, 0.0]))


@pytest.mark.upstream(17, "same")
def test_a_moving_end_is_accepted_where_that_is_allowed(stage_for):
    stage = stage_for()
    stage.configure(allow_nonzero_end_velocity=True)
    assert stage.finish(MOVING_END).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(18, "same")
def test_a_moving_end_is_refused_where_it_is_not(stage_for):
    stage = stage_for()
    refused = stage.finish(MOVING_END)
    assert refused.outcome == (ABORTED, -1) and "leaves a moving at 0.1000 rad/s" in refused.sentence
    assert stage.commanded == at(START, 0.0)
    resting = goal(point(0.2, HALF_WAY, [1, 1, 1]), point(0.3, FAR, [0, 0, 0]))
    assert stage.finish(resting).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(
    19,
    "better",
    why="Disabling a moving arm is refused; an orderly end stops it on its path first, and the goal is ABORTED −1.",
)
def test_nothing_lets_go_of_a_moving_arm(stage_for):
    stage = stage_for(gentle=True)
    sent = stage.send(goal(point(2.5, away(1.0))))
    stage.run(0.5)
    for kind in (Request.DISABLE, Request.FREE):
        done, sentence = stage.ask(kind)
        assert not done and "moving" in sentence
    assert not sent.ended and stage.mode is Mode.EXECUTING
    stage.arm.memory["motion"]["closing"] = 1
    stage.until(lambda: sent.ended, 0.1)
    assert sent.outcome == (ABORTED, -1) and "shutting down" in sent.sentence
    stage.until(lambda: stage.mode is Mode.HOLDING, 1.0)
    moved = stage.commanded - START
    assert moved == at(moved[0], 1e-9)
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    20,
    "better",
    why="0.25, 0.87 and 1 as upstream; 2 is refused, as trajectories are checked at the speed they ask for.",
)
@pytest.mark.parametrize("factor", [0.25, 0.87, 1.0, 2.0])
def test_a_scaled_goal_succeeds_twice(stage_for, factor):
    stage = stage_for()
    stage.ask(Request.SPEED_SCALE, factor)
    if factor > 1.0:
        assert stage.snapshot["speed_scale_asked"] == 1.0
        factor = 1.0
    for target in (TARGET, START):
        begun = len(stage.setpoints)
        sent = stage.finish(goal(point(0.5, target), path=tolerances(0.3), arrival=tolerances(1e-10)))
        assert sent.outcome == (SUCCEEDED, 0)
        under_way = round(0.5 / factor / stage.period_s) - 1
        elapsed_s = stage.period_s * np.arange(1, under_way + 1)
        assert stage.clocks_s[begun : begun + under_way] == at(factor * elapsed_s)


@pytest.mark.upstream(21, "same")
@pytest.mark.parametrize("factor", [0.25, 0.87, 1.0])
def test_a_scaled_goal_follows_the_unscaled_path(stage_for, factor):
    stage = stage_for()
    stage.ask(Request.SPEED_SCALE, factor)
    begun = len(stage.setpoints)
    still = (0.0, 0.0, 0.0)
    sent = stage.finish(goal(point(0.2, HALF_WAY, (9.0, 9.0, 9.0), still), point(0.5, FAR, still, still)))
    command = stage.command_since(begun)
    elapsed_ns = stage.arm.period_ns * np.arange(1, len(command) + 1)
    wanted, _, _ = PlannedPath(sent.plan).at(np.round(factor * elapsed_ns))
    assert np.abs(command - wanted).max() < 1e-6
