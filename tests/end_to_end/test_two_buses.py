"""An arm whose wrist is on a bus of its own, with the identifiers of the shoulder's drives: real processes."""

import contextlib
import time

import numpy as np
import pytest
from divided_stack import DividedStack
from two_buses import NAMES

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from observer import stands_since_ns
from ros_client import ABORTED, SUCCEEDED, Client, recorded
from waiting import until

from config.loader import load_arm

pytestmark = pytest.mark.process

SHOULDER, WRIST = NAMES
GOAL = "large"


@pytest.fixture
def stack(arm_name, tmp_path):
    ends = contextlib.ExitStack()
    with ends:
        made = DividedStack(arm_name, tmp_path, recorded(GOAL).trajectory.points[0].positions)
        ends.callback(made.close)
        made.start_sims()
        made.start_loop()
        made.start_front()
        made.client = Client(f"controller_{arm_name}")
        ends.callback(made.client.close)
        yield made


def test_a_goal_moves_the_joints_of_both_buses(stack):
    goal = recorded(GOAL).trajectory
    state, code, words = stack.client.run(recorded(GOAL))
    assert (state, code) == (SUCCEEDED, 0), words
    wanted = dict(zip(goal.joint_names, goal.points[-1].positions, strict=True))
    for bus, part in stack.parts.items():
        until(lambda bus=bus: not moves(stack, bus), f"standing drives on bus {bus}")
        truth = stack.truth_of(bus)
        assert list(truth) == [joint.name for joint in part.joints]
        for joint in part.joints:
            position_rad = truth[joint.name].position_rad
            assert np.ptp(position_rad) > 0.1, joint.name
            assert position_rad[-1] == pytest.approx(wanted[joint.name], abs=joint.slack_rad)


@pytest.mark.parametrize(("gone", "left"), [(SHOULDER, WRIST), (WRIST, SHOULDER)])
def test_when_the_adapter_of_one_bus_goes_the_drives_on_the_other_come_to_rest(stack, gone, left):
    handle = stack.client.send(recorded(GOAL))
    until(lambda: moves(stack, left) and moves(stack, gone), "motion on both buses")
    stack.unplug_bus(gone)
    gone_ns = time.monotonic_ns()
    state, _, words = stack.client.result(handle)
    assert state == ABORTED, words
    report = stack.until(lambda report: report["mode"] == "fault")
    assert report["fault"]["name"] == "wire", report["fault"]

    longest_s = load_arm(stack.arm_file).longest_stop_s
    until(lambda: not moves(stack, left), f"standing drives on bus {left}", longest_s)
    truth, now_ns = stack.truth_of(left), time.monotonic_ns()
    stood_ns = stands_since_ns(truth, now_ns)
    assert gone_ns < stood_ns < gone_ns + round(longest_s * 1e9)
    assert stack.loop.process.poll() is None


def moves(stack, bus):
    truth, now_ns = stack.truth_of(bus), np.array([time.monotonic_ns()])
    return any(abs(joint.velocity_at(now_ns)[0]) > 0.0 for joint in truth.values())
