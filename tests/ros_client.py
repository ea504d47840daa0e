"""What MoveIt is to the arm: an action client and a listener to /joint_states, in a thread of its own."""

import contextlib
import json
import threading
import time
from pathlib import Path

import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

GOALS = Path(__file__).parent / "data" / "moveit"
SUCCEEDED, CANCELED, ABORTED = (
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_CANCELED,
    GoalStatus.STATUS_ABORTED,
)
PATIENCE_S = 10.0
LONGEST_GOAL_S = 30.0


def until(condition, what, patience_s=PATIENCE_S):
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not happen within {patience_s} s"
        time.sleep(0.002)


class Spinner:
    """A context with an executor in a thread of its own."""

    def __init__(self):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.thread = threading.Thread(target=self._spin, daemon=True)

    def _spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self.executor.spin()

    def close(self):
        self.executor.shutdown()
        if self.thread.is_alive():
            self.thread.join(5.0)
        self.context.try_shutdown()


class Client(Spinner):
    """What MoveIt is to the arm: an action client and a listener to /joint_states."""

    def __init__(self, controller="episode_arm_controller"):
        super().__init__()
        self.node = Node("client", context=self.context)
        self.executor.add_node(self.node)
        self.action = ActionClient(self.node, FollowJointTrajectory, f"/{controller}/follow_joint_trajectory")
        self.states, self.feedback = [], []
        for qos in (10, qos_profile_sensor_data):
            self.node.create_subscription(JointState, "joint_states", self._heard(qos), qos)
        self.sensor_data = 0
        self.thread.start()
        assert self.action.wait_for_server(PATIENCE_S)

    def _heard(self, qos):
        def heard(message):
            if qos == 10:
                self.states.append((time.monotonic(), message))
            else:
                self.sensor_data += 1

        return heard

    def send(self, goal):
        future = self.action.send_goal_async(goal, feedback_callback=lambda m: self.feedback.append(m.feedback))
        until(future.done, "the answer to a goal")
        return future.result()

    def result(self, handle):
        future = handle.get_result_async()
        until(future.done, "a result", LONGEST_GOAL_S)
        return future.result().status, future.result().result.error_code, future.result().result.error_string

    def run(self, goal):
        return self.result(self.send(goal))


def recorded(name):
    """A goal of tests/data/moveit as a message."""
    values = json.loads((GOALS / f"{name}.json").read_text())["trajectory"]
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = values["joint_names"]
    for point in values["points"]:
        goal.trajectory.points.append(
            JointTrajectoryPoint(
                positions=point["positions"],
                velocities=point["velocities"],
                accelerations=point["accelerations"],
                time_from_start=Duration(**point["time_from_start"]),
            )
        )
    return goal
