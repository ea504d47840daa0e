"""The gripper over ROS: a real node with a simulated gripper, and real processes with a servo on a simulated bus."""

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
from ros_client import ABORTED, CANCELED, SUCCEEDED, Operator
from sensor_msgs.msg import JointState
from stack import PATIENT, Stack
from std_srvs.srv import Trigger
from waiting import until

from config.loader import load_arm
from rosfront.action_client import ActionClient
from rosfront.gripper import server as gripper_server
from rosfront.gripper import worker as gripper_worker

JOINTS = [f"joint{number}" for number in range(1, 7)]
NAN = math.nan


class Client(Operator):
    """What MoveIt and the full node's clients are to a gripper."""

    def __init__(self, gripper, controller):
        super().__init__(controller)
        self.actions = {
            kind: ActionClient(self.node, kind, f"/{gripper}/{name}")
            for kind, name in ((GripperCommand, "gripper_cmd"), (ParallelGripperCommand, "parallel_gripper_cmd"))
        }
        for action in self.actions.values():
            assert action.wait_for_server(20.0)

    def send(self, goal):
        self.feedback.clear()
        kind = GripperCommand if isinstance(goal, GripperCommand.Goal) else ParallelGripperCommand
        return self.sent(self.actions[kind], goal)

    def go(self, position, max_effort=0.0):
        return self.ended(self.send(command(position, max_effort)))

    def cancel(self, handle):
        future = handle.cancel_goal_async()
        until(future.done, "the answer to a cancel")
        assert len(future.result().goals_canceling) == 1


def command(position, max_effort=0.0):
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, max_effort
    return goal


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


# --- real processes -------------------------------------------------------------------------------------


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


@pytest.mark.process
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


@pytest.mark.process
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
