"""Cases 22 to 45: which messages are taken, by the action and by the topic alike, and what becomes of their columns."""

import pytest
from stage import ABORTED, START, SUCCEEDED
from trajectory_messages import goal, point, trajectory

TARGET = (1.0, 2.0, 3.0)
STILL = (0.0, 0.0, 0.0)
AT = 0.25


def refused(stage, *points, code=-1, **options):
    """The sentence with which both ways in refuse a message; nothing of it moves the arm."""
    told = stage.finish(goal(*points, **options))
    assert told.outcome == (ABORTED, code)
    dropped = stage.publish(trajectory(*points, **options))
    assert (dropped.outcome, dropped.sentence) == (told.outcome, told.sentence)
    stage.assert_stands(0.3)
    assert stage.commanded == pytest.approx(START, abs=1e-12)
    return told.sentence


@pytest.mark.upstream(22, "same")
def test_a_good_message_is_taken(stage_for):
    stage = stage_for()
    assert stage.finish(goal(point(AT, TARGET, STILL))).outcome == (SUCCEEDED, 0)
    taken = stage.publish(trajectory(point(AT, START, STILL)))
    stage.until(lambda: taken.ended)
    assert taken.outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(23, "same")
def test_an_unknown_joint(stage_for):
    sentence = refused(stage_for(), point(AT, TARGET, STILL), names="abx", code=-2)
    assert sentence == "'x' in joint_names is no joint of this arm, which has a, b, c; correct the name."


@pytest.mark.upstream(24, "same")
def test_no_points(stage_for):
    assert refused(stage_for()) == "The trajectory has no points; send at least one."


@pytest.mark.upstream([25, 26, 27, 28, 29], "same")
@pytest.mark.parametrize(
    ("fields", "what"),
    [
        pytest.param({}, "0 positions", id="25"),
        pytest.param({"positions": TARGET[:2]}, "2 positions", id="26"),
        pytest.param({"positions": [1, 2, 3, 4]}, "4 positions", id="27"),
        pytest.param({"positions": TARGET, "velocities": [0, 0]}, "2 velocities", id="28"),
        pytest.param({"positions": TARGET, "accelerations": [0, 0]}, "2 accelerations", id="29"),
    ],
)
def test_wrong_numbers_of_values(stage_for, fields, what):
    sentence = refused(stage_for(), point(AT, **{"velocities": STILL} | fields))
    assert sentence.startswith(f"Point 0 has {what} for 3 joint names")


@pytest.mark.upstream(30, "same")
def test_effort_needs_an_interface_that_drives_told_positions_have_not(stage_for):
    sentence = refused(stage_for(), point(AT, TARGET, STILL, effort=[1, 1, 1]))
    assert sentence == "Point 0 has effort, and this arm's drives are told positions; leave effort empty."


@pytest.mark.upstream(31, "same")
def test_the_same_point_twice(stage_for):
    sentence = refused(stage_for(), point(AT, TARGET, STILL), point(AT, TARGET, STILL))
    assert sentence.startswith("Point 1 has time_from_start 0.250000 s after 0.250000 s at point 0")


@pytest.mark.upstream(32, "same")
def test_a_stamp_of_a_nanosecond_is_long_past(stage_for):
    sentence = refused(stage_for(), point(AT, TARGET, STILL), stamp_ns=1, code=-3)
    assert sentence.startswith("The trajectory, counted from its header stamp, ended 1800000000.7")


@pytest.mark.upstream(33, "same")
def test_a_stamp_of_now_is_taken(stage_for):
    stage = stage_for()
    begun_ns = stage.arm.now_ns
    sent = stage.finish(goal(point(10, TARGET, STILL), stamp_ns=stage.epoch_ns))
    assert sent.outcome == (SUCCEEDED, 0)
    assert stage.arm.now_ns - begun_ns == pytest.approx(10e9, abs=0.05e9)


@pytest.mark.upstream(34, "same")
def test_a_moving_end_and_an_empty_message_are_refused_without_raising(stage_for):
    stage = stage_for()
    moving = stage.finish(goal(point(AT, TARGET, [0, 0, 0.5])))
    assert moving.outcome == (ABORTED, -1) and moving.sentence.startswith("The last point leaves c moving")
    assert refused(stage, names="", code=-2) == "The goal names no joint; name one or more of a, b, c."


@pytest.mark.upstream(35, "same")
def test_positions_velocities_and_accelerations(stage_for):
    stage = stage_for()
    assert stage.finish(goal(point(AT, TARGET, STILL, STILL))).outcome == (SUCCEEDED, 0)


@pytest.mark.upstream(
    [36, 37],
    "different",
    why="Nothing is integrated: positions summed up from derivatives drift from where the planner meant to be.",
)
@pytest.mark.parametrize(
    "fields",
    [
        pytest.param({"velocities": STILL, "accelerations": STILL}, id="36"),
        pytest.param({"accelerations": STILL}, id="37"),
    ],
)
def test_derivatives_alone(stage_for, fields):
    assert refused(stage_for(), point(AT, **fields)).startswith("Point 0 has 0 positions for 3 joint names; give 3")


@pytest.mark.upstream([38, 39, 40, 41, 42], "same")
@pytest.mark.parametrize(
    ("fields", "what"),
    [
        pytest.param({}, "0 positions", id="38"),
        pytest.param({"positions": [1, 2], "velocities": STILL}, "2 positions", id="39"),
        pytest.param({"positions": [1, 2, 3, 4], "velocities": STILL}, "4 positions", id="40"),
        pytest.param({"positions": TARGET, "velocities": [0]}, "1 velocities", id="41"),
        pytest.param({"positions": TARGET, "velocities": STILL, "accelerations": [0]}, "1 accelerations", id="42"),
    ],
)
def test_wrong_numbers_where_upstream_would_integrate(stage_for, fields, what):
    assert refused(stage_for(), point(AT, **fields)).startswith(f"Point 0 has {what} for 3 joint names")


@pytest.mark.upstream(43, "same")
def test_some_of_the_joints_where_that_is_off(stage_for):
    stage = stage_for()
    stage.configure(allow_partial_joints_goal=False)
    assert refused(stage, point(AT, TARGET[:2]), names="ab", code=-2).startswith("The goal leaves out c;")


@pytest.mark.upstream(44, "same")
def test_some_of_the_joints_in_another_order(stage_for):
    stage = stage_for()
    stage.configure(allow_partial_joints_goal=True)
    begun = len(stage.setpoints)
    assert stage.finish(goal(point(AT, [2.0, 1.0], [0, 0]), names="ba")).outcome == (SUCCEEDED, 0)
    stage.assert_stands()
    assert stage.commanded == pytest.approx([1.0, 2.0, START[2]], abs=1e-9)
    assert (stage.command_since(begun)[:, 2] == START[2]).all()


@pytest.mark.upstream(45, "same")
def test_all_joints_in_another_order(stage_for):
    stage = stage_for()
    sent = stage.send(
        goal(
            point(AT, [3.0, 1.0, 2.0], [0.3, 0.1, 0.2], [3, 1, 2]),
            point(2 * AT, [3.1, 1.1, 2.1], STILL, [0, 0, 0]),
            names="cab",
        )
    )
    assert sent.plan.joints[0].tolist() == [[1.0, 0.1, 1.0], [2.0, 0.2, 2.0], [3.0, 0.3, 3.0]]
    begun = len(stage.setpoints)
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    at_first_point = stage.setpoints[begun + round(AT / stage.period_s) - 1]
    assert at_first_point == pytest.approx([1.0, 2.0, 3.0], abs=1e-6)
    assert stage.commanded == pytest.approx([1.1, 2.1, 3.1], abs=1e-9)
