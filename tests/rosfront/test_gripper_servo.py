"""The gripper over ROS in real processes, with a servo on a simulated bus.

They publish /joint_states, so nobody else's node may live in their ROS domain meanwhile (`test_gripper_ros.py`).
"""

import math

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from gripper_client import Client, command
from ros_client import ABORTED, CANCELED, SUCCEEDED
from sensor_msgs.msg import JointState
from stack import PATIENT, Stack
from std_srvs.srv import Trigger
from waiting import until

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def stack(new_arm_name, tmp_path_factory):
    name = new_arm_name()
    stack = Stack(name, tmp_path_factory.mktemp("arm"))
    gripper = {"hook": "servo", "controller_name": f"gripper_{name}", "servo": {"address": 7}}
    stack.change(gripper=gripper, limits=PATIENT)
    try:
        stack.start_sim()
        stack.start_loop()
        stack.start_front()
        yield stack
    finally:
        stack.close()


@pytest.fixture(scope="module")
def user(stack):
    user = Client(f"gripper_{stack.name}", f"controller_{stack.name}")
    yield user
    user.close()


def test_a_servo_on_the_bus_grips_a_thing_and_lets_it_go(stack, user):
    states = user.listen(JointState, "/joint_states")
    until(lambda: states and len(states[-1].name) == 7, "the gripper's joint", 20.0)
    assert user.go(1.9)[0] == SUCCEEDED
    stack.befall("thing:at_s=0,deg=40")
    status, result = user.go(0.0)
    assert (status, result.stalled, result.reached_goal) == (SUCCEEDED, True, False)
    assert result.position == pytest.approx(math.radians(40.0), abs=0.01)
    assert states[-1].position[6] == pytest.approx(result.position, abs=0.01)
    handle = user.send(command(1.8))
    until(lambda: user.feedback, "a motion")
    user.cancel(handle)
    status, result = user.ended(handle)
    assert status == CANCELED and result.position < 1.75
    user.forget()


def test_a_servo_that_loses_power_is_no_fault_of_the_arm(stack, user):
    diagnostics = user.listen(DiagnosticArray, "/diagnostics")

    def levels():
        found = {s.name.rpartition(": ")[2]: (s.level, s.message) for s in diagnostics[-1].status}
        return found.get("gripper", (b"", "")), found.get("arm", (b"", ""))

    stack.befall("power-loss:joint=gripper_joint,at_s=0,off_s=0.3")
    until(lambda: diagnostics and "lost power" in levels()[0][1], "the report", 20.0)
    status, _ = user.go(1.0)
    assert status == ABORTED
    homed = user.call(Trigger, f"/gripper_{stack.name}/home")
    assert homed.success, homed.message
    status, result = user.go(1.0)
    assert (status, result.reached_goal) == (SUCCEEDED, True)
    until(lambda: levels()[0][0] == b"\x00" and levels()[1] == (b"\x00", "holding"), "an arm in order")
    user.forget()
