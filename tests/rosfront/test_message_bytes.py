"""Numbers patched into serialised messages."""

import struct
from array import array

import numpy as np
import pytest

from config.loader import load_arm
from rosfront.message_bytes import MessageBytes, finite


def packed(times, rows):
    return b"begin" + b"".join(
        [struct.pack("<iI", *time) for time in times] + [struct.pack(f"<I{len(row)}d", len(row), *row) for row in rows]
    )


@pytest.mark.parametrize("lengths", [(1,), (6, 6, 6), (3, 1, 9, 2)])
@pytest.mark.parametrize("times", [1, 3])
def test_the_numbers_are_replaced_and_nothing_else(times, lengths):
    message = MessageBytes(packed, times, lengths)
    rng = np.random.default_rng(len(lengths))
    times_ns = rng.integers(0, 2**31 * 10**9, times).tolist()
    rows = [rng.normal(size=length).tolist() for length in lengths]
    assert message.fill(times_ns, rows) == packed([divmod(time_ns, 10**9) for time_ns in times_ns], rows)


@pytest.mark.parametrize("wrong", [lambda times, rows: b"other", lambda times, rows: 2 * packed(times, rows)])
def test_a_serialisation_that_is_not_understood_is_not_patched(wrong):
    with pytest.raises(ValueError, match="does not hold its numbers once each"):
        MessageBytes(wrong, 1, [6])


@pytest.mark.parametrize("rows", [[[1.0], [1.0] * 3], [[1.0] * 2, [1.0] * 4], [[1.0] * 3, [1.0] * 2]])
def test_too_few_or_too_many_numbers_are_not_taken(rows):
    with pytest.raises(struct.error):
        MessageBytes(packed, 1, [2, 3]).fill([0], rows)


@pytest.mark.parametrize("times, rows", [([0], []), ([], [[1.0] * 2]), ([0], [[1.0] * 2] * 2)])
def test_too_few_or_too_many_rows_are_not_taken(times, rows):
    with pytest.raises(ValueError, match="and the message has 2"):
        MessageBytes(packed, 1, [2]).fill(times, rows)


def test_a_velocity_is_never_nan():
    assert finite([1.0, float("nan"), float("-inf"), -2.0]) == [1.0, 0.0, 0.0, -2.0]


# --- the real messages ---


@pytest.fixture
def arm():
    pytest.importorskip("rclpy")
    pytest.importorskip("control_msgs")
    return load_arm("mock")


TIMES_NS = [1_800_000_000_000_000_007, 12_345_678_901, 13_000_000_002]


def deserialised(message, kind):
    from rclpy.serialization import deserialize_message

    return deserialize_message(message, kind)


def nanoseconds(time):
    return time.sec * 10**9 + time.nanosec


def test_joint_state(arm):
    from sensor_msgs.msg import JointState

    from rosfront.state_topics import joint_state_bytes

    rows = np.random.default_rng(3).normal(size=(3, 6))
    rows[2] = np.nan
    message = deserialised(joint_state_bytes(arm).fill(TIMES_NS[:1], rows), JointState)
    assert list(message.name) == [joint.name for joint in arm.joints]
    assert message.header.frame_id == "base_link" and nanoseconds(message.header.stamp) == TIMES_NS[0]
    assert list(message.position) == rows[0].tolist() and list(message.velocity) == rows[1].tolist()
    assert np.isnan(message.effort).all()


def test_controller_state(arm):
    from control_msgs.msg import JointTrajectoryControllerState

    from rosfront.state_topics import controller_state_bytes

    rows = [*np.random.default_rng(4).normal(size=(8, 6)).tolist(), [0.25]]
    message = deserialised(controller_state_bytes(arm).fill(TIMES_NS, rows), JointTrajectoryControllerState)
    assert list(message.joint_names) == [joint.name for joint in arm.joints]
    times = [message.header.stamp, message.reference.time_from_start, message.feedback.time_from_start]
    assert [nanoseconds(time) for time in times] == TIMES_NS
    assert list(message.reference.positions) == rows[0]
    assert list(message.reference.velocities) == rows[1]
    assert list(message.reference.accelerations) == rows[2]
    assert list(message.feedback.positions) == rows[3]
    assert list(message.feedback.velocities) == rows[4]
    assert list(message.error.positions) == rows[5]
    assert list(message.error.velocities) == rows[6]
    assert list(message.output.positions) == rows[7]
    assert message.speed_scaling_factor == 0.25


def goal_ids():
    first_time = struct.pack("<iI", 0x5A5B5C5D, 0x3A2B1C0D)
    return [bytes(range(240, 256)), bytes(16), 2 * first_time, b"1234" + first_time + b"5678", struct.pack("<2d", 1, 2)]


@pytest.mark.parametrize("goal", goal_ids(), ids=bytes.hex)
def test_feedback_whatever_id_a_client_chose(arm, goal):
    from control_msgs.action import FollowJointTrajectory

    from rosfront.state_topics import feedback_bytes

    rows = np.random.default_rng(6).normal(size=(7, 6)).tolist()
    message = deserialised(feedback_bytes(arm, goal).fill(TIMES_NS, rows), FollowJointTrajectory.Impl.FeedbackMessage)
    assert bytes(message.goal_id.uuid) == goal
    feedback = message.feedback
    desired, actual, error = feedback.desired, feedback.actual, feedback.error
    assert feedback.header.frame_id == "base_link"
    assert list(feedback.joint_names) == [joint.name for joint in arm.joints]
    times = [feedback.header.stamp, desired.time_from_start, actual.time_from_start]
    assert [nanoseconds(time) for time in times] == TIMES_NS
    assert [desired.positions, desired.velocities, desired.accelerations] == [array("d", row) for row in rows[:3]]
    assert [actual.positions, actual.velocities] == [array("d", row) for row in rows[3:5]]
    assert [error.positions, error.velocities] == [array("d", row) for row in rows[5:]]


def test_dynamic_joint_state(arm):
    from control_msgs.msg import DynamicJointState

    from rosfront.state_topics import INTERFACES, dynamic_joint_state_bytes

    rows = np.random.default_rng(5).normal(size=(6, len(INTERFACES))).tolist()
    message = deserialised(dynamic_joint_state_bytes(arm).fill(TIMES_NS[:1], rows), DynamicJointState)
    assert list(message.joint_names) == [joint.name for joint in arm.joints]
    assert [list(values.values) for values in message.interface_values] == rows
    assert all(tuple(values.interface_names) == INTERFACES for values in message.interface_values)
