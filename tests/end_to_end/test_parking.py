"""An orderly end that parks the arm first, with real processes: where it goes, and what keeps it from going."""

import math
import signal
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from ros_client import Client, recorded
from stack import PATIENT, Process, Stack
from waiting import until

pytestmark = pytest.mark.process

PARK_DEG = [10.0, -20.0, 15.0, 30.0, -10.0, 40.0]
WITHIN_DEG = 0.2


@pytest.fixture
def stack(arm_name, tmp_path):
    found = Stack(arm_name, tmp_path, start_deg=[0.0] * 6)
    found.start_sim()
    found.change(parking={"joints_deg": PARK_DEG, "speed_ratio": 1.0}, limits=PATIENT)
    yield found
    found.close()


def off_deg(stack):
    """How far each joint is from where it parks, all of them standing."""
    truth = stack.truth().values()
    assert all(abs(joint.velocity_rad_s[-1]) < 1e-9 for joint in truth)
    return np.abs(np.array([math.degrees(joint.position_rad[-1]) for joint in truth]) - PARK_DEG)


def moved(stack):
    return any(abs(joint.position_rad[-1]) > math.radians(1.0) for joint in stack.truth().values())


def test_the_end_of_an_arm_that_stands_parks_it_first(stack):
    up = stack._keep(Process("rtarm", "up", str(stack.arm_file), needs_ros=True))
    up.line_with("running; Ctrl-C")
    up.process.send_signal(signal.SIGINT)
    up.line_with("Parking, for")
    up.line_with("Parked.")
    assert up.code() == 0, up.text
    assert off_deg(stack).max() < WITHIN_DEG


def test_a_second_signal_stops_the_arm_instead(stack):
    up = stack._keep(Process("rtarm", "up", str(stack.arm_file), needs_ros=True))
    up.line_with("running; Ctrl-C")
    up.process.send_signal(signal.SIGINT)
    up.line_with("Parking, for")
    until(lambda: moved(stack), "the first degree of the way")
    up.process.send_signal(signal.SIGINT)
    assert up.code() == 0, up.text
    assert "Parked." not in up.text
    assert off_deg(stack).max() > 5.0


def test_who_ends_a_motion_gets_a_stop_and_no_parking(stack):
    stack.start_loop()
    stack.start_front()
    with closing(Client(f"controller_{stack.name}")) as client:
        client.send(recorded("near_limits_high"))
        until(lambda: moved(stack), "the first degree of the goal")
        stack.front.process.terminate()
        assert stack.front.code() == 0
    assert "Not parked: The arm is executing another goal" in stack.front.text
    assert off_deg(stack).max() > 5.0


def test_a_way_that_takes_too_long_is_not_begun(stack):
    stack.change(parking={"speed_ratio": 0.01, "timeout_s": 2.0})
    stack.start_loop()
    stack.start_front()
    stack.front.process.terminate()
    assert stack.front.code() == 0
    assert "Not parked: It would take" in stack.front.text
    assert not moved(stack)
