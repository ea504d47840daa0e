"""Goal requests read from their bytes: the same as from rclpy's message, or a refusal."""

import contextlib

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointComponentTolerance, JointTolerance
from rclpy.serialization import deserialize_message, serialize_message
from test_trajectory_bytes import MOST, ROWS, same
from trajectory_msgs.msg import JointTrajectoryPoint, MultiDOFJointTrajectoryPoint

from rosfront.goal_bytes import Goal, goal_id, read_goal
from rosfront.goal_requests import Request
from rosfront.points import refuse_unsupported
from rosfront.refusals import GoalRefused, NotSupported, TooManyPoints, TooMuchBeside, Unreadable
from rosfront.trajectory_bytes import MOST_BESIDE

NAMES = st.text("aü", max_size=9)
TOLERANCES = st.lists(st.builds(JointTolerance, name=NAMES, position=st.floats(-1.0, 9.0)), max_size=3)


def as_bytes(request):
    return np.frombuffer(bytes(serialize_message(request)), np.uint8)


@st.composite
def requests(draw):
    request = Request()
    request.goal_id.uuid = np.frombuffer(draw(st.binary(min_size=16, max_size=16)), np.uint8)
    goal = request.goal
    goal.trajectory.header.frame_id = draw(NAMES)
    goal.trajectory.header.stamp = Time(sec=draw(st.integers(0, 9)), nanosec=draw(st.integers(0, 9)))
    goal.trajectory.joint_names = draw(st.lists(NAMES, max_size=3))
    alike = draw(st.none() | st.tuples(ROWS, ROWS, ROWS, ROWS))
    for index in range(draw(st.integers(0, 5))):
        rows = alike or draw(st.tuples(ROWS, ROWS, ROWS, ROWS))
        point = JointTrajectoryPoint(time_from_start=Duration(sec=index, nanosec=index))
        point.positions, point.velocities, point.accelerations, point.effort = rows
        goal.trajectory.points.append(point)
    goal.multi_dof_trajectory.header.frame_id = draw(NAMES)
    goal.path_tolerance, goal.goal_tolerance = draw(TOLERANCES), draw(TOLERANCES)
    goal.goal_time_tolerance = Duration(sec=draw(st.integers(0, 9)))
    return request


@settings(max_examples=examples(300), deadline=None)
@given(request=requests())
def test_what_is_read_is_what_the_request_holds(request):
    data = as_bytes(request)
    found = read_goal(data, MOST)
    assert goal_id(data) == bytes(request.goal_id.uuid)
    assert same(found.trajectory, request.goal.trajectory)
    refuse_unsupported(found)
    for field in ("path_tolerance", "goal_tolerance"):
        wanted = [(one.name, one.position, one.velocity, one.acceleration) for one in getattr(request.goal, field)]
        assert [tuple(one) for one in getattr(found, field)] == wanted
    time = request.goal.goal_time_tolerance
    assert found.goal_time_tolerance == (time.sec, time.nanosec)


def test_the_fields_are_those_of_the_action_in_their_order():
    assert list(FollowJointTrajectory.Goal.get_fields_and_field_types()) == list(Goal._fields)


@pytest.mark.parametrize(
    ("of", "field", "value"),
    [
        ("multi_dof_trajectory", "joint_names", ["a"]),
        ("multi_dof_trajectory", "points", [MultiDOFJointTrajectoryPoint()]),
        (None, "component_path_tolerance", [JointComponentTolerance()]),
        (None, "component_goal_tolerance", [JointComponentTolerance()]),
    ],
)
def test_what_no_arm_has_is_refused_however_much_there_is(of, field, value):
    for count in (1, 100_000):
        request = plain()
        request.goal.path_tolerance = [JointTolerance(name="a")]
        setattr(getattr(request.goal, of) if of else request.goal, field, value * count)
        with pytest.raises(NotSupported, match=of or field):
            refuse_unsupported(read_goal(as_bytes(request), MOST))


def plain(points=3):
    request = Request()
    request.goal.trajectory.joint_names = ["a", "b"]
    request.goal.trajectory.points = [
        JointTrajectoryPoint(positions=[0.1, 0.2], time_from_start=Duration(sec=index)) for index in range(points)
    ]
    return request


def test_too_many_points_are_refused_with_both_numbers():
    data = as_bytes(plain(5))
    assert len(read_goal(data, 5).trajectory.points) == 5
    with pytest.raises(TooManyPoints, match="has 5 points and at most 4 are allowed"):
        read_goal(data, 4)


def test_room_behind_the_message_means_nothing():
    data = np.concatenate([as_bytes(plain()), np.full(2 * MOST_BESIDE, 255, np.uint8)])
    assert same(read_goal(data, MOST).trajectory, plain().goal.trajectory)


@pytest.mark.parametrize("field", ["path_tolerance", "goal_tolerance"])
@pytest.mark.parametrize("names", [["a" * 99] * (MOST_BESIDE // 99), ["a" * MOST_BESIDE]], ids=["many", "long"])
def test_tolerances_are_bounded_too(field, names):
    request = plain()
    setattr(request.goal, field, [JointTolerance(name=name) for name in names])
    with pytest.raises(TooMuchBeside):
        read_goal(as_bytes(request), MOST)


def test_broken_bytes_are_refused():
    request = plain()
    request.goal.path_tolerance = [JointTolerance(name="a", position=0.1)]
    data = as_bytes(request)
    for length in range(len(data)):
        with contextlib.suppress(RuntimeError):
            deserialize_message(data[:length].tobytes(), Request)
            continue  # nothing is missing but padding
        with pytest.raises(Unreadable, match="no request for control_msgs"):
            read_goal(data[:length], MOST)
    for at in range(len(data) - 3):
        broken = data.copy()
        broken[at : at + 4] = 255
        with contextlib.suppress(GoalRefused):
            read_goal(broken, MOST)
