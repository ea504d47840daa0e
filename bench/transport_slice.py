"""`python -m bench.transport_slice FOLDER`: what ROS costs an arm with the transports of this process' environment.

Prints its figures as JSON. A process of its own, since Fast DDS reads its profiles once in a process' life.
"""

import json
import sys
import time
from pathlib import Path

from bench_joint_states import STAMP, STAMP_AT, shares
from bench_long import long_goal
from live import commanded_rad, goal_to, live, percentiles
from rclpy.qos import QoSProfile
from ros_client import CANCELED, until
from sensor_msgs.msg import JointState

from shm.words import Mode

WINDOW_S = 10.0
POINTS = 200_000
ACCEPTED_S = 60.0


def measure(folder: Path) -> dict[str, float]:
    """The figures of one arm, by name."""
    with live(folder, mock_hz=120.0) as stack:
        client = stack.client
        late_ms: list[float] = []

        def hear(data: bytes) -> None:
            sec, nanosec = STAMP.unpack_from(data, STAMP_AT)
            late_ms.append((time.time_ns() - sec * 1_000_000_000 - nanosec) / 1e6)

        # raw: building the message would cost this process more than everything else
        client.node.create_subscription(JointState, "joint_states", hear, QoSProfile(depth=2000), raw=True)
        until(lambda: late_ms, "a joint state")
        handle = client.send(goal_to(commanded_rad(stack) + 0.3, WINDOW_S + 4.0))
        until(lambda: stack.reader.snapshot()["mode"] == Mode.EXECUTING, "motion")
        first = len(late_ms)
        (share,) = shares([stack.front], WINDOW_S)
        figures = percentiles(late_ms[first:], 50, 99)
        client.stop_listening()
        cancel(client, handle)
        goal = long_goal(commanded_rad(stack), POINTS)
        sent_s, answered_s = time.monotonic(), []
        future = client.action.send_goal_async(goal)
        future.add_done_callback(lambda _: answered_s.append(time.monotonic()))
        handed_s = time.monotonic()
        until(lambda: answered_s, "the answer to a long goal", ACCEPTED_S)
        cancel(client, future.result())
        return {
            "stamp → callback p50 (ms)": figures["p50"],
            "stamp → callback p99 (ms)": figures["p99"],
            "share of a core (%)": share,
            f"{POINTS:,} points: handed to ROS (s)": handed_s - sent_s,
            f"{POINTS:,} points: accepted (s)": answered_s[0] - sent_s,
        }


def cancel(client, handle) -> None:
    """End a goal that runs."""
    result = handle.get_result_async()
    handle.cancel_goal_async()
    until(result.done, "the result")
    assert result.result().status == CANCELED, result.result().result.error_string


if __name__ == "__main__":
    print(json.dumps(measure(Path(sys.argv[1]))))
