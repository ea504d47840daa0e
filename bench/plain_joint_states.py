"""`python -m bench.plain_joint_states RATE_HZ`: /joint_states as a Python node usually publishes them, on a timer.

Prints `ready`; publishes six joints to /plain_joint_states until SIGTERM.
"""

import contextlib
import math
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

NAMES = [f"joint{i}" for i in range(1, 7)]


class PlainNode(Node):
    """A timer, and a message made anew each time."""

    def __init__(self, rate_hz: float) -> None:
        super().__init__("plain")
        self._publisher = self.create_publisher(JointState, "/plain_joint_states", 10)
        self._timer = self.create_timer(1.0 / rate_hz, self._publish)
        self._turn = 0

    def _publish(self) -> None:
        self._turn += 1
        message = JointState()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "base_link"
        message.name = NAMES
        message.position = [math.sin(0.01 * self._turn + joint) for joint in range(6)]
        message.velocity = [math.cos(0.01 * self._turn + joint) for joint in range(6)]
        message.effort = [math.nan] * 6
        self._publisher.publish(message)


if __name__ == "__main__":
    rclpy.init()
    node = PlainNode(float(sys.argv[1]))
    print("ready", flush=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)
