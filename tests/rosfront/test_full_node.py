"""The full node's interfaces on real processes: simulated drives, control process, front, a client like the demo's."""

import contextlib
import math
import time
import types

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("robot_arm_interfaces")

from robot_arm_interfaces.action import AngleMode, LinearMove, MoveXyzRotation
from robot_arm_interfaces.msg import MotorAngles
from robot_arm_interfaces.srv import ReadMotorAngles, SetFreeMode
from ros_client import ABORTED, CANCELED, SUCCEEDED, Operator
from stack import PATIENT, Stack
from std_srvs.srv import Trigger
from waiting import until

from config.kinematics import flange_pose
from config.loader import load_arm
from rosfront.action_client import ActionClient
from rosfront.full_node.asked import position_and_rotation

pytestmark = pytest.mark.process
ARM = load_arm("episode1")
ZERO_DEG = [180.0, 90.0, 83.0, 30.0, 110.0, 30.0]
READY_DEG = [180.0, 100.0, 123.0, 30.0, 160.0, 100.0]
"""A bent wrist, with room for lines around it."""


class Client(Operator):
    """A client of the full node, as the public demo is one."""

    def __init__(self, controller):
        super().__init__(controller)
        self.actions = {
            name: ActionClient(self.node, kind, name)
            for name, kind in (
                ("angle_mode", AngleMode),
                ("move_xyz_rotation", MoveXyzRotation),
                ("linear_move", LinearMove),
            )
        }
        for action in self.actions.values():
            assert action.wait_for_server(10.0)

    def send(self, name, **fields):
        self.feedback.clear()
        action = self.actions[name]
        return self.sent(action, action._action_type.Goal(**fields))

    def run(self, name, **fields):
        return self.ended(self.send(name, **fields))


@pytest.fixture
def arm(tmp_path_factory, new_arm_name):
    """Client and processes of an arm that stands at READY_DEG, for one test: a stall's fault is nobody else's."""
    start_deg = np.array(READY_DEG) - ZERO_DEG
    stack = Stack(new_arm_name(), tmp_path_factory.mktemp("full-node"), start_deg=start_deg.tolist())
    stack.change(limits=PATIENT)
    with contextlib.ExitStack() as ends:
        ends.callback(stack.close)
        stack.start_sim()
        stack.start_loop()
        stack.start_front()
        client = Client(f"controller_{stack.name}")
        ends.callback(client.close)
        yield types.SimpleNamespace(client=client, stack=stack)


def ready(arm):
    status, result = arm.client.run("angle_mode", angles=READY_DEG, speed_ratio=1.0)
    assert status == SUCCEEDED, result.message


def flange_of(motor_deg):
    return flange_pose(ARM.kinematics, np.radians(np.array(motor_deg) - ZERO_DEG))


READY_MM, READY_ROTATION_DEG = position_and_rotation(flange_of(READY_DEG), "zyx")
LINE_END_MM = [READY_MM[0], READY_MM[1] + 40.0, READY_MM[2]]


def test_angle_mode_moves_the_motors_there_and_tells_of_it(arm):
    target = [170.0, 105.0, 118.0, 40.0, 150.0, 60.0]
    ready(arm)
    arm.client.feedback.clear()
    status, result = arm.client.run("angle_mode", angles=target, speed_ratio=0.5)
    assert status == SUCCEEDED and result.success, result.message
    assert list(result.final_angles) == pytest.approx(target, abs=0.2)
    told = arm.client.feedback
    elapsed = [feedback.elapsed_time for feedback in told]
    assert 0.5 < result.execution_time < 10.0
    # A busy machine may be late with some of them, and leave one out, but not with half of them.
    assert np.median(np.diff(elapsed)) == pytest.approx(0.1, abs=0.02)
    assert 0.7 <= len(told) / (result.execution_time / 0.1) <= 1.1
    assert np.all(np.diff(elapsed) > 0.0)
    progress = [feedback.progress for feedback in told]
    assert progress == sorted(progress) and 0.0 <= progress[0] < 0.3 and progress[-1] > 0.8
    assert {feedback.status_message for feedback in told} <= {"waiting to begin", "moving", "arriving"}
    way = [feedback.current_angles[0] for feedback in told]
    assert way == sorted(way, reverse=True) and 170.0 <= way[-1] < way[0] <= 180.1


def test_the_pose_of_the_demo_client(arm):
    status, result = arm.client.run(
        "move_xyz_rotation", position=[260.0, 0.0, 200.0], rotation=[180.0, 0.0, 90.0], ik_mode="xyz", speed_ratio=1.0
    )
    assert status == SUCCEEDED and result.success, result.message
    assert list(result.final_position) == pytest.approx([260, 0, 200], abs=1.0)
    assert [abs(result.final_rotation[0]), *result.final_rotation[1:]] == pytest.approx([180, 0, 90], abs=0.5)
    position, _ = position_and_rotation(flange_of(result.solution_angles), "xyz")
    assert position == pytest.approx([260, 0, 200], abs=1e-6)
    read = arm.client.call(ReadMotorAngles, "read_motor_angles")
    assert read.success, read.message
    assert list(read.angles) == pytest.approx(list(result.solution_angles), abs=0.2)


def true_distance_mm(arm, begin, end, since_ns):
    """How far the true flange was from a line at most, and how far along it (mm) it came."""
    truth = arm.stack.truth()
    times_ns = np.arange(since_ns, max(int(joint.times_ns[-1]) for joint in truth.values()), 2_000_000)
    angles = np.stack([truth[joint.name].position_at(times_ns) for joint in ARM.joints], axis=1)
    points = flange_pose(ARM.kinematics, angles)[:, :3, 3] * 1e3
    way = np.array(end) - begin
    along = (points - begin) @ way / np.linalg.norm(way)
    aside = np.linalg.norm(points - begin - np.outer(along, way / np.linalg.norm(way)), axis=1)
    return float(aside.max()), along


def test_a_linear_move_is_straight_and_counts_its_steps(arm):
    ready(arm)
    begin, rotation = position_and_rotation(flange_of(READY_DEG), "zyx")
    end = [begin[0], begin[1] + 60.0, begin[2] + 30.0]
    since_ns = time.monotonic_ns()
    status, result = arm.client.run("linear_move", position=end, rotation=rotation, rotation_mode="", step_size=0.0)
    assert status == SUCCEEDED and result.success, result.message
    assert result.total_steps == math.ceil(math.hypot(60, 30) / 8.0) == 9
    steps = [feedback.current_step for feedback in arm.client.feedback]
    assert steps == sorted(steps) and 0 < max(steps) <= 9
    assert {feedback.total_steps for feedback in arm.client.feedback} == {9}
    aside, along = true_distance_mm(arm, begin, end, since_ns)
    assert aside < 0.1
    assert along[-1] == pytest.approx(math.hypot(60, 30), abs=0.1)


def test_a_canceled_linear_move_stops_on_its_line(arm):
    ready(arm)
    begin, rotation = position_and_rotation(flange_of(READY_DEG), "zyx")
    end = [begin[0], begin[1] - 150.0, begin[2]]
    since_ns = time.monotonic_ns()
    handle = arm.client.send("linear_move", position=end, rotation=rotation, rotation_mode="zyx", step_size=2.0)
    until(lambda: arm.client.feedback and arm.client.feedback[-1].current_step > 15, "a part of the way")
    handle.cancel_goal_async()
    status, result = arm.client.ended(handle)
    assert status == CANCELED and not result.success
    assert result.message.startswith("Canceled: the arm is at rest"), result.message
    aside, along = true_distance_mm(arm, begin, end, since_ns)
    assert aside < 0.1
    assert 30.0 < along[-1] < 140.0
    rest = arm.client.call(ReadMotorAngles, "read_motor_angles").angles
    standing, _ = position_and_rotation(flange_of(rest), "zyx")
    assert begin[1] - standing[1] == pytest.approx(along[-1], abs=0.1)


def test_what_cannot_be_done_is_aborted_with_a_sentence_and_moves_nothing(arm):
    ready(arm)
    before = list(arm.client.call(ReadMotorAngles, "read_motor_angles").angles)
    pose = {"position": [260.0, 0.0, 200.0], "rotation": [180.0, 0.0, 90.0]}
    far = {"position": [900.0, 0.0, 200.0], "rotation": [180.0, 0.0, 90.0]}
    for name, fields, says in (
        ("angle_mode", {"angles": [400.0, *READY_DEG[1:]], "speed_ratio": 1.0}, "angles[0] is 400°"),
        ("angle_mode", {"angles": READY_DEG, "speed_ratio": 0.0}, "speed_ratio is 0"),
        ("move_xyz_rotation", {**far, "ik_mode": "xyz", "speed_ratio": 1.0}, "out of reach"),
        ("move_xyz_rotation", {**pose, "ik_mode": "abc", "speed_ratio": 1.0}, "ik_mode is 'abc'"),
        ("linear_move", {**far, "rotation_mode": "xyz", "step_size": 8.0}, "out of reach"),
        ("linear_move", {**pose, "rotation_mode": "xyz", "step_size": 1e-9}, "step_size is 1e-09 mm"),
    ):
        status, result = arm.client.run(name, **fields)
        assert status == ABORTED and not result.success
        assert says in result.message, result.message
    assert list(arm.client.call(ReadMotorAngles, "read_motor_angles").angles) == pytest.approx(before, abs=0.1)


def test_motor_angles_come_thirty_times_a_second(arm):
    ready(arm)
    heard = arm.client.listen(MotorAngles, "motor_angles")
    until(lambda: len(heard) > 65, "two seconds of motor angles")
    arm.client.forget()
    stamps = [message.timestamp.sec + message.timestamp.nanosec * 1e-9 for message in heard]
    assert (len(stamps) - 1) / (stamps[-1] - stamps[0]) == pytest.approx(30.0, abs=1.0)
    assert all(message.success and not message.message for message in heard)
    assert list(heard[-1].angles) == pytest.approx(READY_DEG, abs=0.2)


def test_free_mode_lets_the_drives_go_and_takes_hold_of_them_again(arm):
    free = arm.client.call(SetFreeMode, "set_free_mode", SetFreeMode.Request(enable=True))
    assert free.success and "led by hand" in free.message
    status, result = arm.client.run("angle_mode", angles=ZERO_DEG, speed_ratio=1.0)
    assert status == ABORTED and not result.success and result.message
    back = arm.client.call(SetFreeMode, "set_free_mode", SetFreeMode.Request(enable=False))
    assert back.success and "holds where it stands" in back.message
    ready(arm)


def test_a_move_waits_for_nobody_and_a_hold_keeps_it(arm):
    """An arm in motion takes no other move; ~/hold and ~/resume are for these goals too."""
    ready(arm)
    running = arm.client.send("angle_mode", angles=[150.0, *READY_DEG[1:]], speed_ratio=0.7)
    until(lambda: arm.client.feedback, "motion")
    told = arm.client.feedback
    other = arm.client.actions["move_xyz_rotation"]
    goal = MoveXyzRotation.Goal(
        position=[260.0, 0.0, 200.0], rotation=[180.0, 0.0, 90.0], ik_mode="xyz", speed_ratio=1.0
    )
    sent = other.send_goal_async(goal)
    until(sent.done, "the answer to a goal")
    status, result = arm.client.ended(sent.result())
    assert status == ABORTED and result.message.startswith("The arm is executing another goal")
    assert arm.client.call(Trigger, "~/hold").success
    until(lambda: told[-1].status_message.startswith("held"), "a held goal")
    assert arm.client.call(Trigger, "~/resume").success
    status, result = arm.client.ended(running)
    assert status == SUCCEEDED and result.final_angles[0] == pytest.approx(150.0, abs=0.2), result.message


def test_of_two_moves_at_once_the_first_is_carried_out(arm):
    ready(arm)
    turned = [[READY_DEG[0] + turn, *READY_DEG[1:]] for turn in (8.0, -8.0)]
    action = arm.client.actions["angle_mode"]
    sent = [action.send_goal_async(AngleMode.Goal(angles=angles, speed_ratio=1.0)) for angles in turned]
    for future in sent:
        until(future.done, "the answer to a goal")
    (first, result), (second, other) = (arm.client.ended(future.result()) for future in sent)
    assert first == SUCCEEDED, result.message
    assert second == ABORTED and other.message.startswith("The arm is executing another goal"), other.message
    assert list(result.final_angles) == pytest.approx(turned[0], abs=0.2)


def test_a_held_move_is_not_replaced_by_another_one(arm):
    ready(arm)
    running = arm.client.send("angle_mode", angles=[150.0, *READY_DEG[1:]], speed_ratio=0.7)
    until(lambda: arm.client.feedback, "motion")
    told = arm.client.feedback
    assert arm.client.call(Trigger, "~/hold").success
    until(lambda: told[-1].status_message.startswith("held"), "a held goal")
    sent = arm.client.actions["linear_move"].send_goal_async(
        LinearMove.Goal(position=LINE_END_MM, rotation=READY_ROTATION_DEG)
    )
    until(sent.done, "the answer to a goal")
    status, result = arm.client.ended(sent.result())
    assert status == ABORTED and "holds the arm" in result.message, result.message
    running.cancel_goal_async()
    assert arm.client.ended(running)[0] == CANCELED
    assert arm.client.call(Trigger, "~/resume").success


def test_without_a_control_process_the_last_angles_stay_and_are_no_success(arm):
    ready(arm)
    heard = arm.client.listen(MotorAngles, "motor_angles")
    until(lambda: heard, "motor angles")  # the arm's side may find the listener later than it finds the arm
    running = arm.client.send("angle_mode", angles=[150.0, *READY_DEG[1:]], speed_ratio=0.2)
    until(lambda: arm.client.feedback, "motion")
    arm.stack.loop.process.kill()
    try:
        status, result = arm.client.ended(running)
        assert status == ABORTED and "has ended and the drives stop by themselves" in result.message
        until(lambda: not heard[-1].success, "a message that says so")
        assert "has ended and the drives stop by themselves" in heard[-1].message
        assert 150.0 < heard[-1].angles[0] < 180.5
        read = arm.client.call(ReadMotorAngles, "read_motor_angles")
        assert not read.success and list(read.angles) == list(heard[-1].angles)
        free = arm.client.call(SetFreeMode, "set_free_mode", SetFreeMode.Request(enable=True))
        assert not free.success and free.message
    finally:
        arm.client.forget()
        arm.stack.start_loop()
        until(lambda: arm.client.call(ReadMotorAngles, "read_motor_angles").success, "angles read again")
    ready(arm)
