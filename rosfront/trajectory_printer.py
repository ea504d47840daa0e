# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rosfront.trajectory_printer [--language zh|en] [--ros-args …]`: print what MoveIt sends, move nothing.

The tutorial's second mode: it offers the same action and checks messages like the arm's front, but prints goals instead
of moving an arm. /joint_states jump to the last point of each goal, so MoveIt plans on from there. What is printed is
the contract (facts: episode1-arm, section 4); the Chinese lines are those of the tutorial.

Exit codes: 0 after an orderly end, 1 when it cannot run (one sentence on standard error says why), 2 for a wrong
command line.
"""

import argparse
import math
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from config.errors import ConfigError
from config.loader import load_arm
from config.schema import ArmConfig
from rosfront import verdict as verdicts
from rosfront.plan import NS
from rosfront.points import Columns, Points, columns_of, read_points, refuse_unsupported
from rosfront.program import CannotServe, EndSignal, needs_ros, serve, split_arguments
from rosfront.refusals import SUCCESSFUL, GoalRefused
from rosfront.start_parameters import DEFAULT_ARM
from rosfront.verdict import Status, Verdict

if TYPE_CHECKING:
    from rclpy.action.server import ServerGoalHandle
    from rclpy.executors import SingleThreadedExecutor

NODE_NAME = "trajectory_printer"
JOINT_STATES_HZ = 120
BAR = "=" * 80
INDENT = "  "
CANCELED = "Canceled before everything was printed; /joint_states stay where they were."
STOPPED = "The printer was stopped before everything was printed."


@dataclass(frozen=True)
class Words:
    """What is printed, in one language."""

    started: str
    waiting: str
    received: str
    count: str
    order: str
    point: str
    time: str
    position_rad: str
    position_deg: str
    velocity_deg_s: str
    duration: str
    shown: str
    done: str


LANGUAGES = {
    "zh": Words(
        started="轨迹打印节点已启动",
        waiting="等待 MoveIt 发送轨迹...",
        received="收到 MoveIt 轨迹!",
        count="轨迹包含 {} 个点",
        order="关节顺序: {}",
        point="点 {}/{}:",
        time="时间: {:.3f} 秒",
        position_rad="位置(弧度): [{}]",
        position_deg="位置(度): [{}]°",
        velocity_deg_s="速度(度/s): [{}]°/s",
        duration="轨迹总时长: {:.3f} 秒",
        shown="已更新关节位置到目标点",
        done="轨迹接收并打印完成",
    ),
    "en": Words(
        started="The trajectory printer has started",
        waiting="Waiting for MoveIt to send a trajectory...",
        received="Received a MoveIt trajectory!",
        count="The trajectory has {} points",
        order="Joint order: {}",
        point="Point {}/{}:",
        time="Time: {:.3f} s",
        position_rad="Position (rad): [{}]",
        position_deg="Position (deg): [{}]°",
        velocity_deg_s="Velocity (deg/s): [{}]°/s",
        duration="Duration of the trajectory: {:.3f} s",
        shown="The joint positions now show the last point",
        done="The trajectory was received and printed",
    ),
}


def greeting(words: Words) -> list[str]:
    """The messages at the start."""
    return [words.started, words.waiting]


def report(joint_names: Sequence[str], points: Points, words: Words) -> Iterator[str]:
    """The messages about a trajectory, up to its duration; columns in the order of the message."""
    yield from (BAR, words.received, BAR)
    count = len(points.times_ns)
    yield words.count.format(count)
    yield words.order.format(list(joint_names))
    velocities = points.velocities.copy()
    velocities[~points.has_velocities] = 0.0
    rows = zip(points.times_ns.tolist(), points.positions.tolist(), velocities.tolist(), strict=True)
    for number, (time_ns, position, velocity) in enumerate(rows, start=1):
        yield "\n" + words.point.format(number, count)
        yield INDENT + words.time.format(time_ns / NS)
        yield INDENT + words.position_rad.format(", ".join(f"{angle:.4f}" for angle in position))
        yield INDENT + words.position_deg.format(_degrees(position))
        yield INDENT + words.velocity_deg_s.format(_degrees(velocity))
    yield "\n" + words.duration.format(points.times_ns[-1] / NS)


def ending(words: Words) -> list[str]:
    """The messages after the joint positions have jumped."""
    return [words.shown, words.done, BAR + "\n"]


def _degrees(row_rad: Sequence[float]) -> str:
    return ", ".join(f"{math.degrees(value):7.2f}" for value in row_rad)


class JointStates(threading.Thread):
    """Publishes `position_rad` at an even rate, whatever else this process does."""

    def __init__(self, arm: ArmConfig, publisher: Any) -> None:
        from rosfront.state_topics import position_bytes

        super().__init__(name="joint-states", daemon=True)
        self.position_rad = [0.0] * len(arm.joints)
        """One per joint, in the arm's order; replaced as a whole."""
        self._message = position_bytes(arm)
        self._publisher = publisher
        self._leave = threading.Event()

    def run(self) -> None:
        """Publish until `stop`; a late message is skipped, not caught up with."""
        begun_ns, tick = time.monotonic_ns(), 0
        while True:
            now_ns = time.monotonic_ns()
            tick = max(tick + 1, (now_ns - begun_ns) * JOINT_STATES_HZ // NS)
            due_ns = begun_ns + tick * NS // JOINT_STATES_HZ
            if self._leave.wait(max(0, due_ns - now_ns) / NS):
                return
            self._publisher.publish(self._message.fill((time.time_ns(),), (self.position_rad,)))

    def stop(self) -> None:
        """End the thread."""
        self._leave.set()
        self.join()


class PrinterNode:
    """The node, its action and the publisher's thread; `spin` serves until `close`.

    Goals are printed one after the other in a thread of their own, because a long one takes seconds, in which cancels
    must be answered.
    """

    def __init__(self, arm: ArmConfig, executor: "SingleThreadedExecutor", words: Words) -> None:
        """Raises CannotServe where ROS is missing."""
        with needs_ros():
            from rclpy.node import Node
            from sensor_msgs.msg import JointState

            from rosfront.action import GoalServer
            from rosfront.state_topics import STATE_QOS
        self.node = Node(NODE_NAME)
        self._names = [joint.name for joint in arm.joints]
        self._words = words
        self._executor = executor
        self._say = self.node.get_logger().info
        self._states = JointStates(arm, self.node.create_publisher(JointState, "joint_states", STATE_QOS))
        self._printing = ThreadPoolExecutor(1, "printing")
        self._stopped = threading.Event()
        self._goals = GoalServer(
            self.node, executor, f"{arm.front.controller_name}/follow_joint_trajectory", run=self._run
        )
        executor.add_node(self.node)
        self._states.start()

    def spin(self) -> None:
        """Serve; returns after `close`, when every client has its result."""
        self._goals.spin()

    def announce(self) -> None:
        """Log that trajectories can be sent."""
        for message in greeting(self._words):
            self._say(message)

    async def _run(self, handle: "ServerGoalHandle") -> Verdict:
        from rclpy.task import Future

        trajectory = handle.request.trajectory
        try:
            refuse_unsupported(handle.request)
            columns = columns_of(trajectory.joint_names, self._names, allow_partial=True)
            points = read_points(Columns.of(trajectory.points), trajectory.joint_names)
        except GoalRefused as reason:
            return verdicts.refused(reason)
        printed: Future = Future()

        def work() -> None:
            try:
                printed.set_result(self._print(handle, points, columns.tolist()))
            except BaseException as failure:  # raised in the executor's thread, which ends the program
                printed.set_exception(failure)
            self._executor.wake()

        self._printing.submit(work)
        verdict: Verdict = await printed
        return verdict

    def _print(self, handle: "ServerGoalHandle", points: Points, columns: list[int]) -> Verdict:
        for message in report(handle.request.trajectory.joint_names, points, self._words):
            if handle.is_cancel_requested:
                return Verdict(Status.CANCELED, SUCCESSFUL, CANCELED)
            if self._stopped.is_set():
                return verdicts.aborted(STOPPED)
            self._say(message)
        shown = list(self._states.position_rad)
        for column, angle_rad in zip(columns, points.positions[-1].tolist(), strict=True):
            shown[column] = angle_rad
        self._states.position_rad = shown
        for message in ending(self._words):
            self._say(message)
        return Verdict(Status.SUCCEEDED, SUCCESSFUL, "")

    def finish(self, end: EndSignal) -> None:
        """Nothing to do, since nothing moves."""

    def close(self, patience_s: float) -> None:
        """Stop printing, send the client its result, and end; call from neither of the node's threads."""
        self._stopped.set()
        self._goals.leave(patience_s, lambda: None)
        self._printing.shutdown()
        self._states.stop()


def main(arguments: list[str] | None = None) -> int:
    """Run the printer; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m rosfront.trajectory_printer",
        description="Print the trajectories that MoveIt sends; nothing moves but /joint_states.",
        epilog="What is meant for ROS follows --ros-args.",
    )
    parser.add_argument(
        "--arm", default=DEFAULT_ARM, metavar="ARM", help="name of an arm, or path of an arm file (default %(default)s)"
    )
    parser.add_argument(
        "--language", choices=LANGUAGES, default="zh", help="language of what is printed (default %(default)s)"
    )
    own, ros_arguments = split_arguments(sys.argv[1:] if arguments is None else arguments)
    options = parser.parse_args(own)
    end = EndSignal()
    try:
        arm = load_arm(options.arm)
        serve(
            lambda executor: PrinterNode(arm, executor, LANGUAGES[options.language]),
            ros_arguments,
            arm,
            end,
        )
    except (ConfigError, CannotServe) as problem:
        print(problem, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
