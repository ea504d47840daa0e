"""`python -m ros_crowd ROLE CONTROLLER`: an ordinary ROS node beside an arm, until its standard input is closed.

Prints `ready` when ROS has answered it for the first time, and `answered` at the next answer after each line it reads.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable

import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.srv import QueryTrajectoryState
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState

from rosfront.action_client import ActionClient

PAUSE_S = 0.02
PATIENCE_S = 1.0
"""For one answer: a request to a server that was killed, or was only just found, has none."""


class Asking:
    """Asks by a function that returns a future, again and again, in the node's thread."""

    def __init__(self, node: Node, ask: Callable[[], Future], answered: threading.Semaphore) -> None:
        self._ask, self._answered = ask, answered
        self._asked_s = -math.inf
        self._open: Future | None = None
        node.create_timer(PAUSE_S, self._turn)

    def _turn(self) -> None:
        if self._open is not None and self._open.done():
            self._open = None
            self._answered.release()
        if self._open is None or time.monotonic() - self._asked_s > PATIENCE_S:
            self._open, self._asked_s = self._ask(), time.monotonic()


def main(role: str, controller: str) -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(role)
    answered = threading.Semaphore(0)
    if role == "listener":
        node.create_subscription(JointState, "joint_states", lambda _: answered.release(), 10)
    elif role == "caller":
        client = node.create_client(QueryTrajectoryState, f"/{controller}/query_state")
        Asking(node, lambda: client.call_async(QueryTrajectoryState.Request()), answered)
    else:
        action = ActionClient(node, FollowJointTrajectory, f"/{controller}/follow_joint_trajectory")
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = ["of_another_arm"]  # refused, so that no motion is disturbed
        Asking(node, lambda: action.send_goal_async(goal), answered)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    answered.acquire()
    print("ready", flush=True)
    for _ in sys.stdin:
        while answered.acquire(blocking=False):
            pass
        answered.acquire()
        print("answered", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
