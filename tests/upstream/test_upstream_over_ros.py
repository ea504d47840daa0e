"""The cases that only a client can see, with real messages, the real front and the real control process."""

from contextlib import closing
from dataclasses import dataclass

import numpy as np
import pytest
import yaml
from stack import Process
from stage import ARM_FILE
from trajectory_messages import NS, goal, point, trajectory

pytest.importorskip("rclpy")

from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
from ros_client import ABORTED, CANCELED, SUCCEEDED, Client, Operator
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory
from waiting import until

from shm.files import command_path, state_path

pytestmark = pytest.mark.process

INITIAL_FACTOR = 0.765
JOINTS = "cba"
"""Neither the alphabet's order nor that of the messages."""


@dataclass
class Ros:
    """Control process and front of an arm with mock drives, and those who talk to it."""

    controller: str
    client: Client
    operator: Operator
    states: list[JointState]
    controller_states: list[JointTrajectoryControllerState]
    first_states: list[JointTrajectoryControllerState]

    def __post_init__(self) -> None:
        self.scaling = self.operator.publisher(SpeedScalingFactor, "~/speed_scaling_input")
        self.topic = self.operator.publisher(JointTrajectory, "~/joint_trajectory")

    def position(self) -> list[float]:
        """Of a, b and c, as a message that is yet to come says."""
        self.states.clear()
        until(lambda: self.states, "a joint state")
        return [self.states[-1].position[JOINTS.index(name)] for name in "abc"]

    def moved(self, distance: float) -> list[float]:
        return [p + distance for p in self.position()]

    def newest(self) -> JointTrajectoryControllerState:
        self.controller_states.clear()
        until(lambda: self.controller_states, "a controller state")
        return self.controller_states[-1]

    def wait(self, passing_s: float) -> None:
        """Until the arm's own clock has moved on so far."""
        begun_s = seconds(self.newest().header.stamp)
        until(lambda: seconds(self.newest().header.stamp) >= begun_s + passing_s, "time to pass")

    def scale(self, factor: float) -> None:
        self.scaling.publish(SpeedScalingFactor(factor=factor))


def write_arm(name, folder):
    """The arm of arm.yaml with mock drives and the limits of a real one, joints in another order."""
    values = yaml.safe_load(ARM_FILE.read_text(encoding="utf-8"))
    values["name"] = name
    values["bus"] = {"interface": "mock"}
    values["front"] = {"controller_name": f"controller_{name}", "feedback_hz": 50.0}
    for joint in values["joints"]:
        joint |= {"drive": {"family": "mock"}, "motor_rpm": 120, "max_acceleration_rad_s2": 10.0}
    values["joints"].sort(key=lambda joint: JOINTS.index(joint["name"]))
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def processes(new_arm_name, tmp_path_factory):
    name = new_arm_name()
    path = write_arm(name, tmp_path_factory.mktemp("upstream"))
    options = ("--ros-args", "-p", f"speed_scaling.initial_scaling_factor:={INITIAL_FACTOR}")
    started = []
    try:
        for process in (("rtloop", str(path)), ("rosfront", str(path), *options)):
            started.append(Process(*process, needs_ros=process[0] == "rosfront"))
            started[-1].line_with("ready")
        client, operator = Client(f"controller_{name}"), Operator(f"controller_{name}")
        controller_states = operator.listen(JointTrajectoryControllerState, "~/controller_state")
        until(lambda: controller_states, "a controller state")
        states = operator.listen(JointState, "/joint_states")
        yield Ros(f"controller_{name}", client, operator, states, controller_states, controller_states[:1])
        operator.close()
        client.close()
    finally:
        for process in reversed(started):
            process.close()
        for left in (state_path(name), command_path(name)):
            left.unlink(missing_ok=True)


@pytest.fixture
def ros(processes):
    """The arm at full speed, with nothing heard yet."""
    processes.scale(1.0)
    until(lambda: processes.newest().speed_scaling_factor == 1.0, "full speed")
    processes.client.feedback.clear()
    return processes


def seconds(moment):
    return moment.sec + moment.nanosec / NS


@pytest.mark.upstream(94, "different")
def test_the_speed_scaling_topic(processes):
    assert processes.first_states[0].speed_scaling_factor == pytest.approx(INITIAL_FACTOR)
    for factor in (0.5, 0.0, 0.25):
        processes.scale(factor)
        until(lambda factor=factor: processes.newest().speed_scaling_factor == factor, "the factor")
    for ignored in (-0.12, 2.0, float("nan")):
        processes.scale(ignored)
    processes.scale(0.125)
    heard = processes.controller_states
    until(lambda: heard[-1].speed_scaling_factor == 0.125, "the last factor")
    assert {state.speed_scaling_factor for state in heard} <= {0.25, 0.125}


@pytest.mark.upstream(78, "same")
def test_the_arrays_of_the_state_topic(processes):
    state = processes.first_states[0]
    assert state.joint_names == list(JOINTS)
    for what in (state.reference, state.feedback, state.error):
        assert len(what.positions) == len(what.velocities) == 3
    assert len(state.reference.accelerations) == 3 and len(state.output.positions) == 3
    assert list(state.error.positions) == [0.0, 0.0, 0.0]
    assert not len(state.feedback.accelerations) and not len(state.output.velocities)
    assert state.reference.positions == state.feedback.positions


@pytest.mark.upstream(
    "A37", "better", why="Joints come in the order of the arm file in every message, not sorted by their names."
)
def test_the_order_of_the_joints(ros):
    ros.position()
    assert ros.states[-1].name == list(JOINTS)
    assert len(ros.states[-1].position) == len(ros.states[-1].velocity) == len(ros.states[-1].effort) == 3


@pytest.mark.upstream([3, 6], "same")
def test_feedback_on_the_way(ros):
    target = ros.moved(0.3)
    status, code, words = ros.client.run(goal(point(0.4, ros.moved(0.2)), point(0.8, target)))
    assert (status, code) == (SUCCEEDED, 0) and words.startswith("Goal reached")
    feedback = ros.client.feedback
    assert len(feedback) >= 10
    clocks = [seconds(entry.desired.time_from_start) for entry in feedback]
    assert clocks == sorted(clocks) and 0.0 <= clocks[0] < 0.2 and 0.6 < clocks[-1] <= 0.85
    for entry in feedback:
        assert entry.joint_names == list(JOINTS)
        assert len(entry.desired.accelerations) == 3
        error = np.subtract(entry.desired.positions, entry.actual.positions)
        assert list(entry.error.positions) == pytest.approx(list(error), abs=1e-12)
    assert ros.position() == pytest.approx(target, abs=1e-9)


@pytest.mark.upstream(10, "same")
def test_two_clients(ros):
    with closing(Client(ros.controller)) as other:
        older = ros.client.send(goal(point(2.0, ros.moved(0.6))))
        until(lambda: ros.client.feedback, "motion")
        newer = other.send(goal(point(2.0, ros.position())))
        still_running = newer.get_result_async()
        status, code, words = ros.client.result(older)
        assert (status, code) == (ABORTED, -1) and "replaced by a newer goal" in words
        assert not still_running.done()
        assert other.result(newer)[:2] == (SUCCEEDED, 0)


@pytest.mark.upstream(14, "better")
def test_a_cancel_is_accepted_and_ends_as_canceled(ros):
    start = ros.position()
    handle = ros.client.send(goal(point(1.5, [p + 1.0 for p in start])))
    until(lambda: any(seconds(entry.desired.time_from_start) > 0.5 for entry in ros.client.feedback), "half of the way")
    answer = handle.cancel_goal_async()
    until(answer.done, "the answer to a cancel")
    assert len(answer.result().goals_canceling) == 1
    status, code, words = ros.client.result(handle)
    assert (status, code) == (CANCELED, 0) and words.startswith(
        "Canceled: the arm is at rest and has not left its path"
    )
    way = np.subtract(ros.position(), start)
    assert way == pytest.approx([way[0]] * 3, abs=1e-9) and 0.1 < way[0] < 1.0


@pytest.mark.upstream(18, "same")
def test_a_refusal_reaches_the_client(ros):
    start = ros.position()
    status, code, words = ros.client.run(goal(point(1.0, ros.moved(0.1), [0.0, 0.0, 0.2])))
    assert (status, code) == (ABORTED, -1) and words.startswith("The last point leaves c moving at 0.2000 rad/s")
    assert ros.position() == start
    assert ros.client.run(goal(point(1.0, ros.moved(0.1), [0.0, 0.0, 0.0])))[:2] == (SUCCEEDED, 0)


@pytest.mark.upstream(20, "better")
@pytest.mark.parametrize("factor", [0.25, 0.87])
def test_scaled_time_in_the_feedback(ros, factor):
    ros.scale(factor)
    until(lambda: ros.newest().speed_scaling_factor == factor, "the factor")
    status, code, words = ros.client.run(goal(point(0.5, ros.moved(0.1))))
    assert (status, code) == (SUCCEEDED, 0), words
    assert len(ros.client.feedback) >= 5
    for entry in ros.client.feedback:
        wall_s = seconds(entry.actual.time_from_start)
        assert min(factor * wall_s, 0.5) == pytest.approx(min(seconds(entry.desired.time_from_start), 0.5), abs=0.012)


@pytest.mark.upstream(79, "different", why="Both times stop with the trajectory: at its end they say how long it took.")
def test_the_times_of_the_state_topic(ros):
    ros.topic.publish(trajectory(point(0.3, ros.moved(0.01))))
    until(lambda: abs(seconds(ros.newest().reference.time_from_start) - 0.3) < 0.03, "the end of the trajectory")
    ros.wait(0.2)
    state = ros.newest()
    assert seconds(state.reference.time_from_start) == pytest.approx(0.3, abs=0.03)
    assert seconds(state.feedback.time_from_start) == pytest.approx(0.3, abs=0.03)


@pytest.mark.upstream("A22", "same")
def test_a_result_that_is_asked_for_late(ros):
    target = ros.moved(0.1)
    handle = ros.client.send(goal(point(0.5, target)))
    until(lambda: ros.position() == pytest.approx(target, abs=1e-9), "the target")
    ros.wait(2.0)
    assert ros.client.result(handle)[:2] == (SUCCEEDED, 0)


@pytest.mark.upstream("A23", "same")
def test_a_client_that_vanishes(ros):
    target = ros.moved(0.3)
    vanishing = Client(ros.controller)
    vanishing.send(goal(point(1.0, target)))
    vanishing.close()
    until(lambda: ros.position() == pytest.approx(target, abs=1e-9), "the target")
    assert ros.client.run(goal(point(0.5, ros.moved(-0.1))))[:2] == (SUCCEEDED, 0)
