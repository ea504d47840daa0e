"""Trajectory messages read from their bytes: the same as from the message, or a refusal."""

import contextlib
import struct
from unittest.mock import patch

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytest.importorskip("trajectory_msgs")

from builtin_interfaces.msg import Duration, Time
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rosfront import trajectory_bytes
from rosfront.inputs import read
from rosfront.points import Columns
from rosfront.refusals import GoalRefused, TooManyPoints, TooMuchBeside, Unreadable
from rosfront.trajectory_bytes import MOST_BESIDE, parse


def trajectory(points, width=6, velocities=True, accelerations=False, frame="", names=None):
    random = np.random.default_rng(1)

    def row(given):
        return random.normal(size=width).tolist() if given else []

    return JointTrajectory(
        header=Header(stamp=Time(sec=1_700_000_000, nanosec=999_999_999), frame_id=frame),
        joint_names=names or [f"joint{index}" for index in range(width)],
        points=[
            JointTrajectoryPoint(
                positions=row(True),
                velocities=row(velocities),
                accelerations=row(accelerations),
                time_from_start=Duration(sec=index - 1, nanosec=4_000_000_000 - index),
            )
            for index in range(points)
        ],
    )


MOST = 1000


def same(found, message):
    """Whether what was read of a message is what the message holds."""
    wanted = Columns.of(message.points)
    assert found.header.stamp == (message.header.stamp.sec, message.header.stamp.nanosec)
    assert found.joint_names == list(message.joint_names)
    assert len(found.points) == len(message.points)
    assert found.points.times_ns.tolist() == wanted.times_ns.tolist()
    for field in ("positions", "velocities", "accelerations", "effort"):
        for ours, theirs in zip(getattr(found.points, field), getattr(wanted, field), strict=True):
            assert ours.tolist() == theirs.tolist()
    return True


@settings(max_examples=examples(200), deadline=None)
@given(
    points=st.integers(1, 20),
    width=st.integers(1, 9),
    velocities=st.booleans(),
    accelerations=st.booleans(),
    frame=st.text("aé", max_size=9),
    name=st.text("bü", max_size=9),
)
def test_what_is_read_is_what_the_message_holds(points, width, velocities, accelerations, frame, name):
    """Also where nothing follows the last point; and it is found without a walk through the points."""
    names = [name + "x" * index for index in range(width)]
    message = trajectory(points, width, velocities, accelerations, frame, names)
    data = bytes(serialize_message(message))
    with patch.object(trajectory_bytes, "_any_points", side_effect=AssertionError):
        found, end = trajectory_bytes.trajectory_at(memoryview(data)[4:], 0, MOST)
        assert same(found, message)
        assert same(parse(data[: 4 + end], MOST), message)


ROWS = st.lists(st.floats(-1e3, 1e3), max_size=3)


@settings(max_examples=examples(300), deadline=None)
@given(
    rows=st.lists(st.tuples(ROWS, ROWS, ROWS, ROWS), max_size=6),
    first=st.none() | st.tuples(ROWS, ROWS, ROWS, ROWS),
    frame=st.text("aé", max_size=9),
)
def test_points_of_any_lengths_are_what_the_message_holds(rows, first, frame):
    """Also where the first points look like those of a plain one."""
    message = trajectory(0, frame=frame)
    for index, row in enumerate(rows if first is None else [first, first, *rows]):
        point = JointTrajectoryPoint(time_from_start=Duration(sec=index - 1, nanosec=index))
        point.positions, point.velocities, point.accelerations, point.effort = row
        message.points.append(point)
    assert same(parse(bytes(serialize_message(message)), MOST), message)


def odd_ones():
    message = trajectory(0)
    yield "no points", message
    message = trajectory(3)
    message.points[1].positions = [0.0] * 5
    yield "a point with fewer positions", message
    message = trajectory(3)
    message.points[0].velocities = []
    yield "a first point without velocities", message
    message = trajectory(3)
    message.points[2].velocities = []
    yield "a last point without velocities", message
    message = trajectory(3, accelerations=True)
    message.points[1].accelerations = [0.0] * 7
    yield "a point with more accelerations", message
    for index in range(3):
        message = trajectory(3)
        message.points[index].effort = [1.0]
        yield f"effort at point {index}", message
    message = trajectory(1)
    message.points[0].positions = []
    yield "no positions", message


@pytest.mark.parametrize("message", [pytest.param(message, id=name) for name, message in odd_ones()])
def test_other_shapes_are_read_too(message):
    assert same(parse(bytes(serialize_message(message)), MOST), message)


def test_too_many_points_are_refused_before_any_is_read():
    data = bytes(serialize_message(trajectory(5)))
    assert parse(data, 5) is not None
    without_points = data[: data.index(struct.pack("<II", 5, 6)) + 4]
    for sent in (data, without_points):
        with pytest.raises(TooManyPoints) as refused:
            parse(sent, 4)
        assert (refused.value.value, refused.value.limit) == (5, 4)


@pytest.mark.parametrize("names", [["x" * (MOST_BESIDE + 1)], [""] * MOST_BESIDE], ids=["long", "many"])
def test_too_many_names_are_refused_before_they_are_read(names):
    message = trajectory(1)
    message.joint_names = names
    with pytest.raises(TooMuchBeside):
        parse(bytes(serialize_message(message)), MOST)


@pytest.mark.parametrize("even", [True, False])
def test_broken_bytes_are_left_to_rclpy(even):
    message = trajectory(3)
    if not even:
        message.points[1].velocities = []
    data = bytes(serialize_message(message))
    assert parse(data, MOST) is not None
    behind = data.index(struct.pack("<iI", 1, 3_999_999_998)) + 8  # what may follow is padding
    for length in range(behind):
        assert parse(data[:length], MOST) is None, length
    assert parse(data[:behind], MOST) is not None
    assert parse(b"\x00\x00" + data[2:], MOST) is None
    for at in range(2, len(data) - 3):
        with contextlib.suppress(GoalRefused):
            parse(data[:at] + b"\xff\xff\xff\xff" + data[at + 4 :], MOST)


def test_broken_bytes_that_rclpy_cannot_read_are_refused():
    data = bytes(serialize_message(trajectory(3)))
    cut = [data[:length] for length in range(len(data))]
    overwritten = [data[:at] + b"\xff\xff\xff\xff" + data[at + 4 :] for at in range(len(data) - 3)]
    refused = 0
    for broken in (*cut, *overwritten):
        try:
            read(broken, MOST)
        except Unreadable as reason:
            assert f"{len(broken)} bytes" in reason.sentence
            refused += 1
        except (TooManyPoints, TooMuchBeside):
            refused += 1
    assert refused > len(cut) // 2
