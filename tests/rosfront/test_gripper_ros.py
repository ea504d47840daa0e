"""The gripper over ROS: a real node with a simulated gripper."""

import contextlib
import math
import threading
import time

import pytest

pytest.importorskip("rclpy")

from action_msgs.srv import CancelGoal
from control_msgs.action import GripperCommand, ParallelGripperCommand
from diagnostic_msgs.msg import DiagnosticArray
from front_stage import pile_up, served
from gripper_client import Client, command
from ros_client import ABORTED, CANCELED, SUCCEEDED
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from waiting import until

from config.loader import load_arm
from rosfront.gripper import server as gripper_server
from rosfront.gripper import worker as gripper_worker

JOINTS = [f"joint{number}" for number in range(1, 7)]
NAN = math.nan


def parallel(**fields):
    return ParallelGripperCommand.Goal(command=JointState(**fields))


@contextlib.contextmanager
def serving(name, gripper, **trajectory):
    """A node with a gripper, beside a stand-in for the control process; its client and what its log says."""
    overrides = {
        "name": name,
        "trajectory": trajectory,
        "front": {"controller_name": f"arm_{name}"},
        "gripper": {"hook": "simulated", "controller_name": f"gripper_{name}", **gripper},
    }
    arm = load_arm("mock", overrides=overrides)
    with served(arm) as (_, front, _), contextlib.closing(Client(f"gripper_{name}", f"arm_{name}")) as client:
        client.front = front
        until(lambda: front._gripper.worker.shown.reading is not None, "where the gripper is")
        yield client


@pytest.fixture(scope="module")
def client(new_arm_name):
    with serving(new_arm_name(), {"options": {"object_deg": 30.0}, "lower_deg": 10.0, "stall_time_s": 0.2}) as client:
        yield client


def test_a_command_is_reached_with_feedback_on_the_way(client):
    assert client.go(1.9)[0] == SUCCEEDED
    status, result = client.go(1.0)
    assert (status, result.reached_goal, result.stalled) == (SUCCEEDED, True, False)
    assert result.position == pytest.approx(1.0, abs=0.02)
    positions = [feedback.position for feedback in client.feedback]
    assert len(positions) > 4 and positions == sorted(positions, reverse=True)
    assert math.isnan(result.effort)


def test_a_thing_between_the_fingers_stalls_it(client):
    status, result = client.go(math.radians(12.0))
    assert (status, result.reached_goal, result.stalled) == (SUCCEEDED, False, True)
    assert result.position == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize("position", [NAN, math.inf, math.radians(9.9), math.radians(110.1), -1.0])
def test_what_is_out_of_range_is_not_begun(client, position):
    before = client.front._gripper.worker.shown.reading.position_rad
    status, result = client.go(position)
    assert (status, result.reached_goal, result.stalled) == (ABORTED, False, False)
    assert client.front._gripper.worker.shown.reading.position_rad == before == result.position


@pytest.mark.parametrize("effort", [NAN, -1.0, math.inf])
def test_an_effort_that_is_none_is_refused(client, effort):
    assert client.go(1.0, effort)[0] == ABORTED


def test_why_a_goal_was_refused_stands_in_the_log(client, monkeypatch):
    said = []
    monkeypatch.setattr(client.front._gripper._servers[0]._log, "warning", said.append)
    client.go(2.5)
    assert said == [
        "Goal aborted: The gripper is to go to 2.5000 rad (143.2°), and allowed are 0.1745 rad (10°) to 1.9199 rad "
        "(110°): choose an angle in between."
    ]


def test_a_cancel_truly_stops_it(client):
    client.go(1.9)
    handle = client.send(command(0.6))
    until(lambda: client.feedback, "a motion")
    client.cancel(handle)
    status, result = client.ended(handle)
    assert (status, result.reached_goal, result.stalled) == (CANCELED, False, False)
    assert 0.6 < result.position < 1.9
    time.sleep(0.3)
    assert client.front._gripper.worker.shown.reading.position_rad == pytest.approx(result.position, abs=1e-9)


def test_a_cancel_that_is_taken_with_its_goal_counts(client, monkeypatch):
    client.go(1.9)
    taken = pile_up(client.front._gripper._servers[0], monkeypatch)
    answer = client.actions[GripperCommand].send_goal_async(command(0.6))
    name = f"/{client.front.arm.gripper.controller_name}/gripper_cmd/_action/cancel_goal"
    everything = client.node.create_client(CancelGoal, name)
    assert everything.wait_for_service(10.0)
    canceling = everything.call_async(CancelGoal.Request())
    until(canceling.done, "the answer to a cancel")
    assert {"goal", "cancel"} in taken and len(canceling.result().goals_canceling) == 1
    until(answer.done, "the answer to a goal")
    status, result = client.ended(answer.result())
    assert (status, result.reached_goal, result.stalled) == (CANCELED, False, False)
    time.sleep(0.3)
    assert client.front._gripper.worker.shown.reading.position_rad == pytest.approx(1.9, abs=0.02)


def test_a_newer_goal_of_either_action_takes_over(client):
    client.go(1.9)
    first = client.send(command(0.6))
    until(lambda: client.feedback, "a motion")
    second = client.send(parallel(name=["gripper_joint"], position=[1.9]))
    assert client.ended(first)[0] == ABORTED
    status, result = client.ended(second)
    assert (status, result.reached_goal) == (SUCCEEDED, True)
    assert (result.state.name, result.state.position[0]) == (["gripper_joint"], pytest.approx(1.9, abs=0.02))


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"name": ["gripper_joint"]},
        {"position": [1.0, 1.0]},
        {"name": ["gripper_joint", "joint1"], "position": [1.0, 0.0]},
        {"name": ["joint1"], "position": [1.0]},
        {"name": ["gripper_joint"], "position": [1.0], "effort": [1.0, 2.0]},
        {"name": ["gripper_joint"], "position": [NAN]},
    ],
)
def test_a_parallel_command_is_for_one_joint(client, fields):
    assert client.ended(client.send(parallel(**fields)))[0] == ABORTED


def test_a_parallel_command_needs_no_name_and_may_name_maxima(client):
    status, result = client.ended(client.send(parallel(position=[1.5], velocity=[0.1], effort=[3.0])))
    assert (status, result.reached_goal) == (SUCCEEDED, True)


def test_joint_states_have_its_joint_behind_the_arms_own(client):
    client.go(1.2)
    states = client.listen(JointState, "/joint_states")
    until(lambda: len(states) > 20, "joint states")
    for state in states:
        assert list(state.name) == [*JOINTS, "gripper_joint"]
        assert len(state.position) == len(state.velocity) == len(state.effort) == 7
    assert states[-1].position[6] == pytest.approx(1.2, abs=0.02)
    client.forget()


def test_without_a_fresh_reading_its_joint_is_left_out(client, monkeypatch):
    worker = client.front._gripper.worker
    states = client.listen(JointState, "/joint_states")
    hook = worker._hook
    monkeypatch.setattr(hook, "read", _raise)
    until(lambda: states and list(states[-1].name) == JOINTS, "the arm's joints alone")
    monkeypatch.undo()
    until(lambda: list(states[-1].name) == [*JOINTS, "gripper_joint"], "the gripper's joint again")
    client.forget()


def _raise():
    raise OSError("the port is gone")


def test_a_hook_that_hangs_ends_its_goals_and_a_cancel(client, monkeypatch):
    monkeypatch.setattr(gripper_worker, "HANGS_AFTER_S", 0.3)
    client.go(1.9)
    returns = threading.Event()
    handle = client.send(command(0.6))
    monkeypatch.setattr(client.front._gripper.worker._hook, "read", returns.wait)
    client.cancel(handle)
    late = client.send(command(1.0))
    assert client.ended(handle)[0] == client.ended(late)[0] == ABORTED
    monkeypatch.undo()
    returns.set()
    assert client.go(1.5)[0] == SUCCEEDED


def test_diagnostics_tell_of_it(client):
    reports = client.listen(DiagnosticArray, "/diagnostics")

    def gripper():
        return [s for report in reports for s in report.status if s.name.endswith(": gripper")]

    until(gripper, "the gripper's diagnostics")
    values = {value.key: value.value for value in gripper()[-1].values}
    assert values["hook"] == "simulated" and values["position"].endswith(" rad")
    client.forget()


def test_the_full_nodes_services(client):
    pytest.importorskip("robot_arm_interfaces")
    from robot_arm_interfaces.srv import GripperControl, ServoGripper

    opened = client.call(GripperControl, "/gripper_control", GripperControl.Request(enable=False))
    assert (opened.success, opened.message) == (True, "The gripper is at 110.0° (1.9199 rad).")
    gripped = client.call(GripperControl, "/gripper_control", GripperControl.Request(enable=True))
    assert gripped.success and gripped.message.startswith("The gripper holds something at 30.0°")
    turned = client.call(ServoGripper, "/servo_gripper", ServoGripper.Request(angle=57))
    assert (turned.success, turned.actual_angle) == (True, 57)
    clamped = client.call(ServoGripper, "/servo_gripper", ServoGripper.Request(angle=400))
    assert (clamped.success, clamped.actual_angle) == (True, 110)
    assert clamped.message.endswith("(The angle was 400°; it goes from 10° to 110°.)")


def test_a_hook_that_cannot_home_says_so(client):
    response = client.call(Trigger, f"/{client.front.arm.gripper.controller_name}/home")
    assert (response.success, response.message) == (
        False,
        "The gripper's hook simulated has no way to find out where it is.",
    )


def test_strict_reject_rejects_a_bad_goal(arm_name):
    with serving(arm_name, {"speed_deg_s": 500.0}, strict_reject=True) as client:
        assert not client.send(command(5.0)).accepted
        assert client.go(1.0)[0] == SUCCEEDED


def test_the_end_of_the_node_ends_a_goal_with_its_reason(arm_name, monkeypatch):
    with serving(arm_name, {"speed_deg_s": 5.0}) as client:
        handle = client.send(command(0.2))
        until(lambda: client.feedback, "a motion")
        future = handle.get_result_async()
        client.front.close(2.0)
        until(future.done, "the result")
        assert future.result().status == ABORTED


def test_without_robot_arm_interfaces_there_is_everything_else(arm_name, monkeypatch):
    import sys

    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_arm_interfaces"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "robot_arm_interfaces", None)
    monkeypatch.setattr(gripper_server, "WITHOUT_SERVICES", "left out", raising=True)
    with serving(arm_name, {"speed_deg_s": 500.0}) as client:
        assert client.go(1.0)[0] == SUCCEEDED
