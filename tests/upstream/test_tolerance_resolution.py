"""Cases 46 to 56: what a goal's tolerances become; defaults are 0.1 for path, goal, velocity at the goal and time."""

import pytest
from stage import ABORTED, START, SUCCEEDED
from trajectory_messages import goal, point, tolerance

TARGET = (1.0, 2.0, 3.0)


@pytest.fixture
def stage(stage_for):
    stage = stage_for()
    stage.configure(
        path_tolerance_rad=(0.1,) * 3,
        goal_tolerance_rad=(0.1,) * 3,
        stopped_velocity_rad_s=0.1,
        goal_time_s=0.1,
    )
    return stage


def taken(stage, **terms):
    """What the control process judges the goal by: path, arrival, time."""
    sent = stage.send(goal(point(0.5, TARGET), **terms))
    stage.run(0.1)
    found = stage.path_tolerances.tolist(), stage.goal_tolerances.tolist(), float(stage.path["goal_time_s"])
    stage.until(lambda: sent.ended)
    assert sent.outcome == (SUCCEEDED, 0)
    return found


@pytest.mark.upstream(46, "same")
def test_positive_values_are_taken_in_any_order(stage):
    path, arrival, time_s = taken(
        stage,
        path=[tolerance("c", 3.0, 3.1, 300.0), tolerance("a", 1.0, 1.1, 100.0), tolerance("b", 2.0, 2.1, 200.0)],
        arrival=[tolerance("b", 0.2, 0.21, 20.0), tolerance("c", 0.3, 0.31, 30.0), tolerance("a", 0.1, 0.11, 10.0)],
        time_s=0.8,
    )
    assert path == [[1.0, 1.1, 100.0], [2.0, 2.1, 200.0], [3.0, 3.1, 300.0]]
    assert arrival == [[0.1, 0.11, 10.0], [0.2, 0.21, 20.0], [0.3, 0.31, 30.0]]
    assert time_s == 0.8


@pytest.mark.upstream(47, "same")
def test_minus_one_switches_off(stage):
    off = [tolerance(name, -1.0, -1.0, -1.0) for name in "abc"]
    path, arrival, time_s = taken(stage, path=off, arrival=off, time_s=-1.0)
    assert (path, arrival, time_s) == ([[0, 0, 0]] * 3, [[0, 0, 0]] * 3, 0.0)


@pytest.mark.upstream(
    [48, 49, 50, 51, 52, 53, 54],
    "better",
    why="Refused (−1) with joint and value; upstream runs the goal with other tolerances than asked.",
)
@pytest.mark.parametrize(
    ("terms", "about"),
    [
        pytest.param({"time_s": -123.0}, "goal_time_tolerance (s) is -123", id="48"),
        pytest.param({"path": [tolerance("b", -123.0)]}, "path_tolerance position of b is -123", id="49"),
        pytest.param({"path": [tolerance("b", 0.2, -123.0)]}, "path_tolerance velocity of b is -123", id="50"),
        pytest.param({"path": [tolerance("b", 0.2, 0.2, -123.0)]}, "path_tolerance acceleration of b is -123", id="51"),
        pytest.param({"arrival": [tolerance("c", -123.0)]}, "goal_tolerance position of c is -123", id="52"),
        pytest.param({"arrival": [tolerance("c", 0.2, -123.0)]}, "goal_tolerance velocity of c is -123", id="53"),
        pytest.param(
            {"arrival": [tolerance("c", 0.2, 0.2, -123.0)]}, "goal_tolerance acceleration of c is -123", id="54"
        ),
    ],
)
def test_illegal_values_are_refused(stage, terms, about):
    sent = stage.finish(goal(point(0.5, TARGET), **{"time_s": 3.0} | terms))
    assert sent.outcome == (ABORTED, -1)
    assert sent.sentence.startswith(about) and "allowed are a positive limit" in sent.sentence
    assert stage.commanded.tolist() == list(START)


@pytest.mark.upstream(
    [55, 56],
    "better",
    why="Refused (−2) with the name; upstream runs the goal with other tolerances than asked.",
)
@pytest.mark.parametrize(
    ("field", "named"),
    [pytest.param("path", "path_tolerance", id="55"), pytest.param("arrival", "goal_tolerance", id="56")],
)
def test_unknown_joints_are_refused(stage, field, named):
    sent = stage.finish(goal(point(0.5, TARGET), **{field: [tolerance("x", 0.2)]}))
    assert sent.outcome == (ABORTED, -2)
    assert sent.sentence.startswith(f"'x' in {named} is no joint of this arm")
    assert stage.commanded.tolist() == list(START)
