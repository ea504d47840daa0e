"""A MoveIt client, the ROS process, the control process and drives on real SocketCAN; and a clock that is set."""

import time
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

import ros_client
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from observer import motion_violations
from ros_client import SUCCEEDED, Client
from stack import Stack
from trajectory_msgs.msg import JointTrajectoryPoint
from vcan_arm import JOINTS, RATE_HZ, start_on_vcan
from waiting import until

NAME = "rosonvcan"
SWING_S = 4.0
SWING_RAD = 0.1
HOUR_NS = 3600 * 10**9
LATE_S = 1.0
"""From a measurement to its message: emulated processors are slow, and hours are steps."""


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    with closing(Stack(NAME, tmp_path_factory.mktemp("ros"))) as found:
        found.config = start_on_vcan(found)
        found.start_loop()
        found.start_front()
        yield found


@pytest.fixture(scope="module")
def client(stack):
    ros_client.PATIENCE_S = ros_client.LONGEST_GOAL_S = 120.0
    found = Client(f"controller_{NAME}")
    yield found
    found.close()


def swing(stack, client):
    """A goal that swings all joints out and back from where /joint_states says they are."""
    until(lambda: client.states, "joint states", 60.0)
    here = dict(zip(client.states[-1][1].name, client.states[-1][1].position, strict=True))
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = [joint.name for joint in stack.config.joints]
    home = np.array([here[name] for name in goal.trajectory.joint_names])
    omega = 2 * np.pi / SWING_S
    for at_s in np.linspace(0.0, SWING_S, 41):
        position = home + SWING_RAD * (1 - np.cos(omega * at_s)) / 2
        velocity = np.full(JOINTS, SWING_RAD * omega * np.sin(omega * at_s) / 2 if 0 < at_s < SWING_S else 0.0)
        sec, nanosec = divmod(round(at_s * 1e9), 10**9)
        goal.trajectory.points.append(
            JointTrajectoryPoint(
                positions=position.tolist(),
                velocities=velocity.tolist(),
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    return goal


def stamps_of(client, since):
    """When messages were heard and what their stamps say (s), from the message with that number on."""
    found = [(heard_s, message.header.stamp) for heard_s, message in client.states[since:]]
    return np.array([(heard_s, stamp.sec + stamp.nanosec * 1e-9) for heard_s, stamp in found])


@pytest.mark.parametrize("step_ns", [0, HOUR_NS, -HOUR_NS])
def test_a_goal_over_ros_runs_on_real_socketcan_whatever_the_clock_says(stack, client, step_ns):
    """The clock is set in the middle of the motion: stamps follow it, nothing else does."""
    goal = swing(stack, client)
    first, start_ns = len(client.states), time.monotonic_ns()
    handle = client.send(goal)
    assert handle.accepted
    until(lambda: len(client.states) > first + RATE_HZ, "a second of joint states", 60.0)
    before, stepped_s = len(client.states), time.monotonic()
    time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() + step_ns)
    offset_s = time.time() - time.monotonic()
    status, _, sentence = client.result(handle)
    assert status == SUCCEEDED, sentence
    late_s = stamps_of(client, first)
    late_s[:, 1] -= late_s[:, 0] + offset_s
    until(lambda: len(client.states) > before + RATE_HZ, "a second of joint states after the step", 60.0)
    after = late_s[late_s[:, 0] > stepped_s + LATE_S, 1]
    assert len(after) > RATE_HZ
    assert np.all((after > -LATE_S) & (after <= 0.0))
    if step_ns:
        still = late_s[late_s[:, 0] < stepped_s, 1]
        assert np.all(np.abs(still + step_ns * 1e-9) < LATE_S)
    there = np.array(goal.trajectory.points[-1].positions)
    assert np.allclose(client.states[-1][1].position[:JOINTS], there, atol=2e-3)
    assert motion_violations(stack.config, stack.truth(), start_ns, time.monotonic_ns()) == []


def test_both_processes_end_in_order(stack):
    for process in (stack.front, stack.loop):
        process.process.terminate()
        assert process.code() == 0
