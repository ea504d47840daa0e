"""Cases A1 …: what the upstream controller does not check, does not test, or was measured doing."""

from math import inf, nan

import numpy as np
import pytest
from control_msgs.msg import JointComponentTolerance
from stage import ABORTED, CANCELED, START, SUCCEEDED, away
from trajectory_messages import NS, goal, point, tolerance, tolerances, trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectoryPoint

from rosfront.refusals import NotServing
from shm.words import Mode, Request

STILL = (0.0, 0.0, 0.0)
OFF = tolerance("b", -1.0, -1.0, -1.0)


def smooth(distance, seconds, count=31, *, names="abc"):
    """Points of a gentle way from START with velocities and accelerations, at rest at both ends."""
    points = []
    for x in np.linspace(0.0, 1.0, count):
        position = distance * (10 * x**3 - 15 * x**4 + 6 * x**5)
        velocity = distance * (30 * x**2 - 60 * x**3 + 30 * x**4) / seconds
        acceleration = distance * (60 * x - 180 * x**2 + 120 * x**3) / seconds**2
        starts = [START["abc".index(name)] for name in names]
        rows = [[p + position for p in starts], [velocity] * len(names), [acceleration] * len(names)]
        points.append(point(x * seconds, *rows))
    return points


def refused(stage, message, code=-1):
    """The sentence with which a goal is refused; nothing of it moves the arm."""
    before = stage.commanded
    sent = stage.finish(message)
    assert sent.outcome == (ABORTED, code)
    stage.assert_stands(0.2)
    assert (stage.commanded == before).all()
    return sent.sentence


# --- what upstream does not check -------------------------------------------------------------------------


@pytest.mark.upstream(
    "A1", "better", why="Refused with point, joint and value; nothing that is no number is ever commanded."
)
@pytest.mark.parametrize("value", [nan, inf, -inf])
@pytest.mark.parametrize("field", ["positions", "velocities", "accelerations"])
def test_numbers_that_are_none(stage_for, field, value):
    fields = {"positions": START, "velocities": STILL, "accelerations": STILL} | {field: [0.0, value, 0.0]}
    sentence = refused(stage_for(), goal(point(1.0, **fields)))
    assert sentence.startswith(f"Point 0 has {value:g} as ") and " of b; all numbers must be finite" in sentence


@pytest.mark.upstream(
    "A2", "better", why="Refused with code −2 and the name; no joint receives what is left in a buffer."
)
def test_a_joint_named_twice(stage_for):
    sentence = refused(stage_for(), goal(point(1.0, START), names="aac"), code=-2)
    assert sentence == "'a' stands in joint_names more than once; name each joint once."


@pytest.mark.upstream(
    "A3",
    "better",
    why="Position, velocity and acceleration are checked along the whole way: refused with joint, value and limit.",
)
@pytest.mark.parametrize(
    ("points", "about"),
    [
        ([point(5.0, [13.0, 2.1, 3.1])], "a would be at 13.0000 rad"),
        ([point(1.0, away(3.5))], "would move at"),
        ([point(0.3, away(0.5))], "would accelerate with"),
    ],
)
def test_limits_of_the_joints(stage_for, points, about):
    assert about in refused(stage_for(gentle=True), goal(*points))


@pytest.mark.upstream(
    "A4", "better", why="Refused with joint, distance and what is allowed; nothing is commanded in one cycle."
)
def test_a_first_point_half_a_radian_away(stage_for):
    sentence = refused(stage_for(), goal(point(0.0, away(0.5)), point(1.0, away(1.0))))
    assert "0.5000 rad (28.65°) from where it is commanded" in sentence


@pytest.mark.upstream("A5", "better", why="Refused with joint, value and limit.")
@pytest.mark.parametrize("seconds", [0.001, 0.010])
def test_a_radian_in_milliseconds(stage_for, seconds):
    sentence = refused(stage_for(gentle=True), goal(point(0.0, START), point(seconds, away(1.0))))
    assert "would move at" in sentence and "give the trajectory more time" in sentence


@pytest.mark.upstream(
    "A7", "better", why="Refused: without velocities the motion between the points is undefined; nothing jumps to 0."
)
def test_accelerations_without_velocities(stage_for):
    sentence = refused(stage_for(), goal(point(0.0, START, (), STILL), point(1.0, away(0.1), (), STILL)))
    assert sentence.startswith("Point 0 has accelerations but no velocities")


@pytest.mark.upstream(
    "A8",
    "better",
    why="Velocities that are missing are derived from the neighbours, so none steps where the fields change.",
)
def test_points_with_different_fields(stage_for):
    stage = stage_for(gentle=True)
    points = [
        point(1.0, away(0.2)),
        point(2.0, away(0.5), [0.3, 0.3, 0.3]),
        point(3.0, away(0.8), [0.3, 0.3, 0.3], STILL),
        point(4.0, away(1.0)),
        point(5.0, away(1.1), STILL),
    ]
    assert stage.finish(goal(*points)).outcome == (SUCCEEDED, 0)
    steps = np.abs(np.diff(stage.command_since(0), 2, axis=0)) / stage.period_s
    assert steps.max() < 0.02, "no step of velocity where the fields change"
    stage.assert_never_stepped()


@pytest.mark.upstream("A9", "better", why="Refused; upstream begins in the middle of the trajectory.")
def test_a_first_time_below_zero(stage_for):
    sentence = refused(stage_for(), goal(point(-0.5, START), point(1.0, away(0.1))))
    assert sentence == "Point 0 has time_from_start -0.500000 s; times start at 0 or later: shift them."


@pytest.mark.upstream(
    "A10",
    "better",
    why="Entered where it is due, or at the latest earlier place near the arm; no jump to where it would be by now.",
)
@pytest.mark.parametrize("late_s", [0.3, 1.0, 2.0])
def test_a_stamp_in_the_past(stage_for, late_s):
    stage = stage_for(gentle=True)
    begun_ns = stage.arm.now_ns
    sent = stage.finish(goal(*smooth(0.6, 3.0), stamp_ns=stage.epoch_ns - round(late_s * NS)))
    assert sent.outcome == (SUCCEEDED, 0)
    stage.assert_never_stepped()
    assert stage.commanded == pytest.approx(away(0.6), abs=1e-9)
    took_s = (stage.arm.now_ns - begun_ns) / NS
    if late_s == 0.3:
        assert took_s == pytest.approx(3.0 - late_s, abs=0.1), "on time"
    else:
        assert took_s > 3.0 - late_s + 0.1, "late instead of with a jump"


@pytest.mark.upstream("A11", "better", why="Refused with point and sizes; upstream's whole process ends.")
def test_too_many_last_velocities(stage_for):
    sentence = refused(stage_for(), goal(point(1.0, away(0.1), [0, 0, 0, 0.5])))
    assert sentence.startswith("Point 0 has 4 velocities for 3 joint names")


@pytest.mark.upstream("A12", "same")
def test_a_last_acceleration_that_is_not_zero(stage_for):
    stage = stage_for(gentle=True)
    assert stage.finish(goal(point(1.0, away(0.2), STILL, [-2.0, -2.0, -2.0]))).outcome == (SUCCEEDED, 0)
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream("A13", "better", why="Effort is refused whatever its length.")
def test_effort_of_a_wrong_length(stage_for):
    assert "leave effort empty" in refused(stage_for(), goal(point(1.0, START, effort=[1.0, 2.0])))


@pytest.mark.upstream(
    "A14",
    "better",
    why="Refused with the field's name, as ignoring it would mislead; frame_id means nothing here and is ignored.",
)
def test_parts_of_the_goal_for_other_robots(stage_for):
    stage = stage_for()
    message = goal(point(1.0, away(0.1)))
    message.multi_dof_trajectory.joint_names = ["base"]
    message.multi_dof_trajectory.points = [MultiDOFJointTrajectoryPoint()]
    assert "multi_dof_trajectory" in refused(stage, message)
    for field in ("component_path_tolerance", "component_goal_tolerance"):
        message = goal(point(1.0, away(0.1)))
        setattr(message, field, [JointComponentTolerance(joint_name="base")])
        assert field in refused(stage, message)
    message = goal(point(1.0, away(0.1)))
    message.trajectory.header.frame_id = "moon"
    assert stage.finish(message).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(
    "A15", "better", why="NaN and a joint named twice are refused with the field and the name; infinity means no limit."
)
@pytest.mark.parametrize(
    ("terms", "code", "about"),
    [
        ({"path": [tolerance("b", nan)]}, -1, "path_tolerance position of b is nan"),
        ({"arrival": [tolerance("b", 0.0, nan)]}, -1, "goal_tolerance velocity of b is nan"),
        ({"arrival": [tolerance("b", -inf)]}, -1, "goal_tolerance position of b is -inf"),
        ({"path": [tolerance("b", 0.1), tolerance("b", 0.2)]}, -2, "'b' stands in path_tolerance more than once"),
    ],
)
def test_bad_tolerances(stage_for, terms, code, about):
    assert refused(stage_for(), goal(point(1.0, away(0.1)), **terms), code).startswith(about)


@pytest.mark.upstream("A15", "better")
def test_an_infinite_tolerance_is_none(stage_for):
    stage = stage_for()
    sent = stage.send(goal(point(0.5, away(0.1)), path=tolerances(inf), arrival=tolerances(inf)))
    stage.run(0.1)
    assert not stage.path_tolerances.any() and not stage.goal_tolerances[:, 0].any()
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(
    "A16",
    "better",
    why="The arm brakes on its path after missed readings, then faults; the sentence names the joint and the silence.",
)
def test_a_drive_that_does_not_answer_any_more(stage_for):
    stage = stage_for("zdt", gentle=True)
    sent = stage.send(goal(point(2.0, away(1.0))))
    stage.run(0.7)
    stage.unplug("b")
    stage.until(lambda: sent.ended, 1.0)
    assert sent.outcome == (ABORTED, -1) and sent.sentence.startswith("b has given no believable answer for")
    assert stage.mode is Mode.FAULT
    stage.until(lambda: not stage.velocity.any(), 1.0)
    assert stage.commanded[0] < START[0] + 0.6
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream("A17", "better", why="More than `trajectory.max_points` (200,000) are refused with both numbers.")
def test_the_number_of_points(stage_for):
    stage = stage_for(trajectory={"max_points": 500})
    assert refused(stage, goal(*smooth(0.1, 5.0, 501))).startswith("The trajectory has 501 points and at most 500")
    assert stage.finish(goal(*smooth(0.1, 5.0, 500))).outcome == (SUCCEEDED, 0)


# --- what upstream does not test --------------------------------------------------------------------------


@pytest.mark.upstream(
    "A18", "better", why="The goal is ABORTED −1 and says by what it was replaced; a bad message leaves it alone."
)
def test_a_topic_trajectory_during_a_goal(stage_for):
    stage = stage_for(gentle=True)
    sent = stage.send(goal(*smooth(0.6, 3.0)))
    stage.run(1.5)
    bad = stage.publish(trajectory(point(1.0, [nan, 0, 0])))
    assert bad.outcome == (ABORTED, -1)
    stage.run(0.1)
    assert not sent.ended
    streamed = stage.publish(trajectory(point(1.5, away(0.1))))
    stage.run(0.05)
    assert sent.outcome == (ABORTED, -1) and "by a trajectory on ~/joint_trajectory" in sent.sentence
    stage.until(lambda: streamed.ended)
    assert streamed.outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(away(0.1), abs=1e-6)
    stage.assert_never_stepped()


@pytest.mark.upstream("A19", "same")
def test_two_goals_within_one_cycle(stage_for):
    stage = stage_for(gentle=True)
    first, second = stage.send(goal(point(1.0, away(0.2)))), stage.send(goal(point(1.0, away(-0.2))))
    stage.until(lambda: second.ended)
    assert first.outcome == (ABORTED, -1) and "replaced" in first.sentence
    assert second.outcome == (SUCCEEDED, 0)
    assert (stage.command_since(0) <= np.array(START) + 1e-9).all(), "nothing of the first one is played"


@pytest.mark.upstream(
    "A20", "better", why="Whenever a cancel meets the end of a goal, exactly one result comes, within 0.1 s."
)
@pytest.mark.parametrize("drives", ["mock", "zdt"])
def test_a_cancel_around_the_end(stage_for, drives):
    stage = stage_for(drives)
    for cycles in range(44, 56):
        sent = stage.send(goal(point(0.5, away(0.1 if cycles % 2 else 0.0))))
        for _ in range(cycles):
            stage.cycle()
        stage.cancel(sent)
        stage.run(0.1)
        assert sent.outcome in ((SUCCEEDED, 0), (CANCELED, 0))
        stage.cancel(sent)
        stage.run(0.1)
        assert len(sent.verdicts) == 1


@pytest.mark.upstream("A21", "same")
def test_a_cancel_before_the_first_cycle(stage_for):
    stage = stage_for()
    sent = stage.send(goal(point(1.0, away(0.3))))
    stage.cancel(sent)
    stage.until(lambda: sent.ended, 0.5)
    assert sent.outcome == (CANCELED, 0)
    stage.assert_stands()
    assert (stage.command_since(0) == START).all(), "nothing of it is played"


@pytest.mark.upstream("A24", "same")
@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_jump_of_the_clock(stage_for, jump_s):
    stage = stage_for(gentle=True)
    sent = stage.send(goal(*smooth(0.6, 3.0), stamp_ns=stage.epoch_ns))
    stage.run(1.0)
    stage.arm.memory["timing"]["epoch_offset_ns"] += round(jump_s * NS)
    stage.run(1.9)
    assert not sent.ended
    stage.until(lambda: sent.ended, 0.3)
    assert sent.outcome == (SUCCEEDED, 0)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A25",
    "better",
    why="The factor changes along a ramp inside the limits, at any moment; upstream applies it in one cycle.",
)
@pytest.mark.parametrize("seed", range(5))
def test_a_change_of_speed_in_mid_segment(stage_for, seed):
    random = np.random.default_rng(seed)
    stage = stage_for("zdt" if seed == 0 else "mock", gentle=True)
    sent = stage.send(goal(*smooth(0.9, 1.5)))
    for factor in (*random.uniform(0.0, 1.0, 8), 0.0, 1.0):
        stage.run(random.uniform(0.02, 0.3))
        stage.ask(Request.SPEED_SCALE, float(factor))
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(away(0.9), abs=1e-9)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A26",
    "better",
    why="Joints that a replacement leaves out come to rest within their limits; upstream stops them in one cycle.",
)
def test_a_partial_goal_replaces_a_whole_one(stage_for):
    stage = stage_for(gentle=True)
    whole = stage.send(goal(*smooth(0.9, 1.5)))
    stage.run(0.7)
    partial = stage.send(goal(point(1.0, [START[1]]), names="b"))
    stage.until(lambda: partial.ended)
    assert whole.outcome == (ABORTED, -1)
    assert partial.outcome == (SUCCEEDED, 0)
    assert stage.commanded[1] == pytest.approx(START[1], abs=1e-9)
    assert 0.3 < stage.commanded[0] - START[0] < 1.0
    assert (np.diff(stage.command_since(0)[:, [0, 2]], axis=0) >= -1e-12).all(), "they stop ahead and never turn back"
    stage.assert_stands()
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A27", "better", why="The arm stands until the trajectory is due; it does not creep towards it before."
)
def test_a_stamp_in_the_future(stage_for):
    stage = stage_for(gentle=True)
    due_ns = stage.epoch_ns + 2 * NS
    sent = stage.send(goal(point(1.0, away(0.2)), stamp_ns=due_ns))
    begun = len(stage.setpoints)
    stage.run(1.97)
    assert np.ptp(stage.command_since(begun), axis=0).max() == 0.0
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.epoch_ns - due_ns == pytest.approx(NS, abs=0.05 * NS)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A28", "better", why="A topic trajectory is judged by the defaults, never by what the goal before it allowed."
)
def test_tolerances_end_with_their_goal(stage_for):
    stage = stage_for()
    stage.finish(goal(point(0.5, away(0.1)), path=tolerances(0.7), arrival=tolerances(0.8), time_s=9.0))
    streamed = stage.publish(trajectory(point(0.5, START)))
    stage.run(0.1)
    settings = stage.serving.settings
    assert stage.path_tolerances[:, 0].tolist() == list(settings.path_tolerance_rad)
    assert stage.goal_tolerances[:, 0].tolist() == list(settings.goal_tolerance_rad)
    assert float(stage.path["goal_time_s"]) == settings.goal_time_s
    stage.until(lambda: streamed.ended)


@pytest.mark.upstream(
    "A29",
    "better",
    why="A goal that never arrives never succeeds: −5 after its time, or it waits for its cancel.",
)
def test_a_goal_that_waits_for_ever(stage_for):
    stage = stage_for("zdt")
    stage.hold_shafts("a")
    sent = stage.send(goal(point(0.5, away(0.2)), path=tolerances(-1.0), time_s=-1.0))
    stage.run(4.0)
    assert not sent.ended, "and after that the drive's own protection against stalling ends it"
    stage.cancel(sent)
    stage.until(lambda: sent.ended, 0.5)
    assert sent.outcome == (CANCELED, 0) and "a is 0.2" in sent.sentence


@pytest.mark.upstream(
    "A30", "better", why="Whatever cannot be sampled is answered with a sentence; upstream's message stays empty."
)
def test_a_query_without_an_answer_says_why(stage_for):
    stage = stage_for()
    with pytest.raises(NotServing, match="No trajectory is being executed: ask while one is"):
        stage.serving.sample(stage.epoch_ns)
    begun_ns = stage.epoch_ns
    sent = stage.send(goal(point(1.0, away(0.1))))
    stage.run(0.5)
    for at_s in (-0.1, 1.0, 5.0):
        with pytest.raises(NotServing, match=r"runs from 0\.000 to 1\.000 s: ask for a time in between"):
            stage.serving.sample(begun_ns + round(at_s * NS))
    assert stage.serving.sample(begun_ns + NS // 2).position_rad == pytest.approx(away(0.05), abs=1e-6)
    stage.until(lambda: sent.ended)


# --- what upstream was measured doing ---------------------------------------------------------------------


@pytest.mark.upstream(
    "A31",
    "better",
    why="Begins at the commanded position, velocity and acceleration; upstream steps by 5 to 7 × the limit.",
)
@pytest.mark.parametrize("drives", ["mock", "zdt"])
@pytest.mark.parametrize("target", [-0.5, 0.0, 1.5])
def test_a_replacement_at_peak_speed(stage_for, drives, target):
    stage = stage_for(drives, gentle=True)
    older = stage.send(goal(*smooth(0.9, 1.5)))
    stage.run(0.75)
    newer = stage.send(goal(point(2.0, away(target))))
    stage.until(lambda: newer.ended)
    assert older.outcome == (ABORTED, -1)
    assert newer.outcome == (SUCCEEDED, 0)
    assert stage.commanded == pytest.approx(away(target), abs=1e-6)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A32", "better", why="The command slows down from where it is, on the path; it never goes backwards."
)
@pytest.mark.parametrize("drives", ["mock", "zdt"])
def test_a_cancel_at_peak_speed(stage_for, drives):
    stage = stage_for(drives, gentle=True)
    begun = len(stage.setpoints)
    sent = stage.send(goal(*smooth(0.9, 1.5)))
    stage.run(0.75)
    stage.cancel(sent)
    stage.until(lambda: sent.ended, 1.0)
    assert sent.outcome == (CANCELED, 0)
    assert (np.diff(stage.command_since(begun), axis=0) >= -1e-12).all()
    stage.assert_never_stepped()


@pytest.mark.upstream("A33", "better", why="Residues of a planner up to 1e-3 rad/s count as rest.")
@pytest.mark.parametrize("residue", [1e-7, 1e-5, 1e-4])
def test_a_residue_of_velocity_at_the_end(stage_for, residue):
    stage = stage_for(gentle=True)
    assert stage.finish(goal(point(1.0, away(0.2), [0.0, residue, -residue]))).outcome == (SUCCEEDED, 0)
    stage.assert_stands()


@pytest.mark.upstream(
    "A34",
    "better",
    why="A long goal enters piece by piece, so the running one goes on; at most 256 waypoints are written at a time.",
)
def test_many_points_during_a_running_goal(stage_for):
    stage = stage_for(gentle=True)
    running = stage.send(goal(*smooth(0.9, 2.0)))
    stage.run(1.0)
    newer = stage.send(goal(point(1.0, away(0.5)), *(point(1.0 + 0.001 * n, away(0.5)) for n in range(1, 20_000))))
    written = stage.arm.writer.setpoints_written
    for _ in range(300):
        stage.cycle()
        assert stage.arm.writer.setpoints_written - written <= 256
        written = stage.arm.writer.setpoints_written
    assert running.outcome == (ABORTED, -1)
    assert stage.commanded == pytest.approx(away(0.5), abs=1e-6)
    stage.cancel(newer)
    stage.until(lambda: newer.ended, 1.0)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A35",
    "better",
    why="The result comes at most three cycles after the last setpoint's time; upstream's up to 54 ms.",
)
@pytest.mark.parametrize("drives", ["mock", "zdt"])
def test_a_result_comes_at_once(stage_for, drives):
    stage = stage_for(drives)
    for target in (away(0.1), START):
        begun = len(stage.setpoints)
        sent = stage.finish(goal(point(0.5, target, STILL)))
        assert sent.outcome == (SUCCEEDED, 0)
        command = stage.command_since(begun)
        assert (command[1] != command[-1]).all()
        assert len(command) <= round(0.5 / stage.period_s) + 3


@pytest.mark.upstream("A36", "same")
def test_an_empty_message_on_the_topic(stage_for):
    stage = stage_for()
    sent = stage.send(goal(point(1.0, away(0.2))))
    stage.run(0.3)
    assert stage.publish(JointTrajectory()).outcome == (ABORTED, -2)
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)


# --- what users ask for -----------------------------------------------------------------------------------


@pytest.mark.upstream(
    "A38", "better", why="Watched on measured values: −4 on the way, −5 at the end, with joint, value and limit."
)
@pytest.mark.parametrize(
    ("on_the_way", "at_the_end", "code", "about"),
    [
        (tolerance("b", -1.0, 0.01), OFF, -4, "The velocity of b was"),
        (tolerance("b", -1.0, 0.0, 0.1), OFF, -4, "The acceleration of b, smoothed, was"),
        (OFF, tolerance("b", -1.0, 0.001), -5, "b still moved at"),
        (OFF, tolerance("b", -1.0, -1.0, 0.001), -5, "The acceleration of b, smoothed, was"),
    ],
    ids=["velocity on the way", "acceleration on the way", "velocity at the end", "acceleration at the end"],
)
def test_tolerances_of_velocity_and_acceleration(stage_for, on_the_way, at_the_end, code, about):
    stage = stage_for("zdt", gentle=True, lag_s=0.3)
    others = [tolerance(name, -1.0, -1.0, -1.0) for name in "ac"]
    message = goal(point(0.5, away(0.2)), path=[*others, on_the_way], arrival=[*others, at_the_end], time_s=0.05)
    sent = stage.finish(message)
    assert sent.sentence.startswith(about)
    assert sent.outcome == (ABORTED, code)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A39",
    "better",
    why="A deferred goal leaves the running one alone until it is due; a second deferred one replaces it.",
)
def test_deferred_goals(stage_for):
    stage = stage_for(gentle=True)
    begun_ns = stage.epoch_ns
    running = stage.send(goal(point(3.0, away(1.0))))
    stage.run(0.3)
    deferred = stage.send(goal(point(1.0, away(0.1)), stamp_ns=begun_ns + 3 * NS // 2))
    stage.run(0.3)
    later = stage.send(goal(point(1.0, away(0.2)), stamp_ns=begun_ns + 2 * NS))
    stage.run(0.05)
    assert deferred.outcome == (ABORTED, -1) and "replaced" in deferred.sentence
    stage.run(1.3)
    assert not running.ended
    assert (stage.velocity > 0.4).all()
    stage.until(lambda: later.ended)
    assert running.outcome == (ABORTED, -1)
    assert later.outcome == (SUCCEEDED, 0)
    assert stage.epoch_ns - begun_ns == pytest.approx(3 * NS, abs=0.05 * NS)
    stage.assert_never_stepped()


@pytest.mark.upstream(
    "A40",
    "better",
    why="A pause stops on the path and keeps the goal, whose time to arrive does not run; resume goes on.",
)
@pytest.mark.parametrize("after_s", [0.1, 0.5, 0.95])
def test_pause_and_resume(stage_for, after_s):
    stage = stage_for("zdt", gentle=True)
    sent = stage.send(goal(point(1.0, away(0.5)), time_s=0.2))
    stage.run(after_s)
    assert stage.ask(Request.HOLD)[0]
    stage.until(lambda: not stage.velocity.any(), 1.0)
    stage.assert_stands(3.0)
    assert not sent.ended
    assert stage.ask(Request.RESUME)[0]
    stage.until(lambda: sent.ended, 2.0)
    assert sent.outcome == (SUCCEEDED, 0)
    stage.assert_never_stepped()
