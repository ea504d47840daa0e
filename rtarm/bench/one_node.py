# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rtarm.bench.one_node ARM RATE_HZ STATES_HZ NAME [CHANNEL] [--set …]`: an arm's driver in one process.

The way tutorials build it, with the care of a good engineer: an action server, a timer on the steady clock that
interpolates and sends, python-can, a multi-threaded executor with threads to spare, callback groups that keep the timer
from waiting for the action, joint_states from the same timer, and a garbage collector with nothing old to walk.

NAME is the node's, namespace included. Prints `ready`; `run` starts the timer, `begin` and `end` enclose what is
measured, `rest` ends the timer.
"""

from __future__ import annotations

import argparse
import gc
import sys
import threading
import time
from typing import Any

from config.loader import load_arm, parse_overrides
from config.schema import ArmConfig
from rosfront.program import start_ros
from rtarm.bench.measured import Recording, obey
from rtarm.bench.python_arm import Path, PythonArm
from rtarm.client.ros import spinning
from rtarm.processes import READY

THREADS = 4
GOAL_MARGIN_S = 10.0


class OneNode:
    """Everything in one node, `node`."""

    def __init__(self, arm: ArmConfig, drives: PythonArm, rate_hz: float, states_hz: float, name: str) -> None:
        import rclpy
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action.server import ActionServer
        from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
        from rclpy.clock import Clock
        from rclpy.clock_type import ClockType
        from sensor_msgs.msg import JointState

        namespace, _, own_name = name.rpartition("/")
        self.node = rclpy.create_node(own_name, namespace=namespace)
        self.recording = Recording()
        self._names = [joint.name for joint in arm.joints]
        self._drives = drives
        self._period_ns = round(1e9 / rate_hz)
        self._states_every = max(1, round(rate_hz / states_hz))
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer_group = MutuallyExclusiveCallbackGroup()
        self._timer: Any = None
        self._due_ns = 0
        self._cycle = 0
        self._path: Path | None = None
        self._began_ns = 0
        self._arrived = threading.Event()
        self._held_rad = [0.0] * len(self._names)
        self._joint_state, self._result = JointState, FollowJointTrajectory.Result
        self._publisher = self.node.create_publisher(JointState, "joint_states", 10)
        self._server = ActionServer(
            self.node, FollowJointTrajectory, action_of(name), self._execute, callback_group=ReentrantCallbackGroup()
        )

    def run(self, _: str = "") -> None:
        """Start the timer; its first deadline is a period from now."""
        self._drives.listen()
        self._timer = self.node.create_timer(
            self._period_ns * 1e-9, self._on_timer, self._timer_group, self._clock, autostart=False
        )
        self._timer.reset()
        self._due_ns = time.monotonic_ns() + self._timer.time_until_next_call()
        if self.node.executor is not None:
            self.node.executor.wake()

    def rest(self, _: str = "") -> None:
        """End the timer and the reading."""
        timer, self._timer = self._timer, None
        if timer is not None:
            self.node.destroy_timer(timer)
            self._drives.rest()

    def _on_timer(self) -> None:
        now_ns = time.monotonic_ns()
        timer = self._timer
        if timer is None:
            return
        self.recording.add(now_ns - self._due_ns)
        # The timer keeps its phase and leaves out deadlines that have passed: whichever is next, it is one of them.
        next_ns = now_ns + (timer.time_until_next_call() or 0)
        self._due_ns += max(1, round((next_ns - self._due_ns) / self._period_ns)) * self._period_ns

        path = self._path
        if path is not None:
            elapsed_s = (now_ns - self._began_ns) * 1e-9
            self._held_rad = path.at(elapsed_s)
            if elapsed_s >= path.duration_s:
                self._path = None
                self._arrived.set()
        self._drives.cycle(self._held_rad)
        self._cycle += 1
        if self._cycle % self._states_every == 0:
            message = self._joint_state()
            message.header.stamp = self.node.get_clock().now().to_msg()
            message.header.frame_id = "base_link"
            message.name = self._names
            message.position = list(self._drives.measured_rad)
            self._publisher.publish(message)

    def _execute(self, handle: Any) -> Any:
        path = Path(_as_goal(handle.request.trajectory))
        self._arrived.clear()
        self._began_ns = time.monotonic_ns()
        self._path = path
        result = self._result()
        if self._arrived.wait(path.duration_s + GOAL_MARGIN_S):
            handle.succeed()
        else:
            handle.abort()
            result.error_code = self._result.GOAL_TOLERANCE_VIOLATED
        return result


def action_of(name: str) -> str:
    """The action of a node of this full name, such as /bench/one_node."""
    return f"{name}/follow_joint_trajectory"


def _as_goal(trajectory: Any) -> dict[str, Any]:
    """The message as JSON has it, which is what `Path` reads."""
    points = [
        {
            "positions": list(point.positions),
            "velocities": list(point.velocities),
            "time_from_start": {"sec": point.time_from_start.sec, "nanosec": point.time_from_start.nanosec},
        }
        for point in trajectory.points
    ]
    return {"trajectory": {"points": points}}


def main() -> int:
    """The process, until its standard input is closed."""
    from rclpy.executors import MultiThreadedExecutor
    from rclpy.utilities import try_shutdown

    parser = argparse.ArgumentParser()
    parser.add_argument("arm")
    parser.add_argument("rate_hz", type=float)
    parser.add_argument("states_hz", type=float)
    parser.add_argument("name")
    parser.add_argument("channel", nargs="?")
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    arm = load_arm(options.arm, overrides=parse_overrides(options.set))
    drives = PythonArm(arm, options.channel)
    start_ros([])  # by UDP as ours; SIGTERM simply ends it
    node = OneNode(arm, drives, options.rate_hz, options.states_hz, options.name)
    executor = MultiThreadedExecutor(num_threads=THREADS)
    executor.add_node(node.node)

    with spinning(executor):
        gc.collect()
        gc.freeze()
        print(READY, flush=True)
        recording = node.recording
        obey(
            {
                "run": node.run,
                "begin": lambda _: recording.begin(),
                "end": lambda _: recording.end(),
                "rest": node.rest,
            }
        )
        node.rest()
    drives.close()
    node.node.destroy_node()
    try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
