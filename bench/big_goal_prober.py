"""`python -m bench.big_goal_prober CONTROLLER`: what others see of a ROS process while it is given a big goal.

A line on standard input ends a window and begins the next; the window's figures are printed as JSON. A process of its
own, because handing a big goal to ROS keeps the sender's interpreter locked for seconds.
"""

import json
import sys
import threading
import time
from itertools import pairwise

import rclpy
from action_msgs.srv import CancelGoal
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

EVERY_S = 0.005
"""From the answer to a cancel to the next one."""
PATIENCE_S = 30.0


def main(controller: str) -> None:
    """Until the end of standard input."""
    rclpy.init()
    node = Node("prober")
    arrivals: list[int] = []  # epoch ns, taken by the middleware

    def hear(_: bytes, info: dict[str, int]) -> None:
        arrivals.append(info["received_timestamp"])

    node.create_subscription(JointState, "joint_states", hear, QoSProfile(depth=2000), raw=True)
    cancels = node.create_client(CancelGoal, f"/{controller}/follow_joint_trajectory/_action/cancel_goal")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    assert cancels.wait_for_service(PATIENCE_S)
    answers: list[float] = []
    unknown = CancelGoal.Request()
    unknown.goal_info.goal_id.uuid[0] = 1

    def ask() -> None:
        while True:
            asked_s, answered = time.monotonic(), threading.Event()
            cancels.call_async(unknown).add_done_callback(lambda _, answered=answered: answered.set())
            assert answered.wait(PATIENCE_S)
            answers.append(time.monotonic() - asked_s)
            time.sleep(EVERY_S)

    threading.Thread(target=ask, daemon=True).start()
    print("ready", flush=True)
    for _ in sys.stdin:
        time.sleep(0.1)  # what was published before is heard
        heard, asked = arrivals[:], answers[:]
        del arrivals[: len(heard)], answers[: len(asked)]
        figures = {
            "gap of /joint_states (ms)": max((b - a for a, b in pairwise(heard)), default=0) / 1e6,
            "answer to a cancel (ms)": max(asked, default=0.0) * 1e3,
        }
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
