# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rtarm.client.program`: an action client for processes that speak no ROS (`sender`, `player`).

Prints `ready` once the action has a server, then obeys every line of JSON on standard input:

- `{"number": …, "goal": …}` sends a goal, `{"action": …}` beside it to another action than that of the arguments.
- `{}` cancels what runs.
- `{"stream": …}` publishes the trajectory of a goal, which nothing answers; with `--streams`.
- `{"states": [FIRST_NS, LAST_NS]}` asks how joint_states arrived between two instants (CLOCK_MONOTONIC), which is known
  with `--listens`.

Each goal is reported, in JSON, when it is accepted and when it has ended. When its standard input ends, so that nobody
waits any more, the process cancels what still runs and waits `--canceled-s` for its end; SIGTERM ends it at once.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rtarm.client.arrivals import Arrivals
from rtarm.client.ros import INVALID_GOAL, goal_message, has_server, has_subscriber, in_executor, served_node
from rtarm.console.errors import Refusal
from rtarm.processes import READY, report

if TYPE_CHECKING:
    from rclpy.action.client import ClientGoalHandle
    from rclpy.node import Node
    from rclpy.task import Future

    from rosfront.action_client import ActionClient

LATER_SERVER_PATIENCE_S = 20.0
"""For the server of an action that is named with a goal."""


@dataclass
class _Goal:
    """One that was sent.

    Attributes:
        accepted_ns: CLOCK_MONOTONIC, as `sent_ns`; 0 until it is accepted.
        unwanted: it is cancelled as soon as it can be.
    """

    number: int
    sent_ns: int
    accepted_ns: int = 0
    feedback: int = 0
    unwanted: bool = False
    handle: ClientGoalHandle | None = None

    def count(self, _: Any) -> None:
        """Feedback came."""
        self.feedback += 1


class Goals:
    """Sends goals and reports what becomes of them; its callbacks run in the thread that serves the node."""

    def __init__(self) -> None:
        self._state = threading.Condition()
        self._open: dict[int, _Goal] = {}

    def send(self, client: ActionClient, number: int, document: dict[str, Any]) -> None:
        """Send one goal under the number by which it is reported; a goal that is none is reported at once."""
        try:
            message = goal_message(document)
        except Refusal as refusal:
            return self.fail(number, refusal.sentence)
        goal = _Goal(number, time.monotonic_ns())
        with self._state:
            self._open[number] = goal
        sent = client.send_goal_async(message, feedback_callback=goal.count)
        sent.add_done_callback(partial(self._answered, goal))

    def fail(self, number: int, sentence: str) -> None:
        """Report a goal that came to nothing."""
        self._end(_Goal(number, time.monotonic_ns()), False, INVALID_GOAL, sentence)

    def cancel(self) -> None:
        """Cancel all that is under way, also what has no answer yet."""
        with self._state:
            for goal in self._open.values():
                goal.unwanted = True
            running = [goal.handle for goal in self._open.values() if goal.handle is not None]
        for handle in running:
            handle.cancel_goal_async()

    def forget(self) -> None:
        """Nothing more is reported of what is under way: its client goes."""
        with self._state:
            self._open.clear()

    def wait_idle(self, patience_s: float) -> bool:
        """Whether everything has its result within some time."""
        with self._state:
            return self._state.wait_for(lambda: not self._open, patience_s)

    def _answered(self, goal: _Goal, future: Future) -> None:
        handle = future.result()
        if not handle.accepted:
            return self._end(goal, False, INVALID_GOAL, "The arm rejected the goal without a reason.")
        goal.accepted_ns = time.monotonic_ns()
        report("accepted", number=goal.number, sent_ns=goal.sent_ns)
        with self._state:
            goal.handle = handle
            unwanted = goal.unwanted
        if unwanted:
            handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(partial(self._finished, goal))

    def _finished(self, goal: _Goal, future: Future) -> None:
        from action_msgs.msg import GoalStatus

        outcome = future.result()
        succeeded = outcome.status == GoalStatus.STATUS_SUCCEEDED and outcome.result.error_code == 0
        self._end(goal, succeeded, outcome.result.error_code, outcome.result.error_string)

    def _end(self, goal: _Goal, succeeded: bool, code: int, sentence: str) -> None:
        report(
            "result",
            number=goal.number,
            succeeded=succeeded,
            code=code,
            sentence=sentence,
            actual_s=(time.monotonic_ns() - goal.accepted_ns) * 1e-9 if goal.accepted_ns else 0.0,
            feedback=goal.feedback,
        )
        with self._state:
            self._open.pop(goal.number, None)
            self._state.notify_all()


class Turning:
    """The node's one action client, made anew for each other action."""

    def __init__(self, node: Node, goals: Goals) -> None:
        self._node = node
        self._goals = goals
        self._action: ActionClient | None = None

    def serve(self, action: str, patience_s: float) -> bool:
        """Turn to an action; whether it has a server within some time."""
        from control_msgs.action import FollowJointTrajectory

        from rosfront.action_client import ActionClient

        if self._action is not None:
            self._goals.forget()
            in_executor(self._node, self._action.destroy)
        self._action = ActionClient(self._node, FollowJointTrajectory, action)
        return has_server(self._action, patience_s)

    def play(self, number: int, document: dict[str, Any], action: str | None) -> None:
        """Send a goal, to the action that is named if there is one: its server may just have come up."""
        if action is not None and not self.serve(action, LATER_SERVER_PATIENCE_S):
            return self._goals.fail(number, f"No action server {action} appeared within {LATER_SERVER_PATIENCE_S:g} s.")
        assert self._action is not None
        self._goals.send(self._action, number, document)


def run(asked: argparse.Namespace) -> None:
    """Obey until standard input ends; what still runs then has `canceled_s` to come to its end.

    Raises:
        Refusal: the action has no server.
    """
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory

    goals, arrivals = Goals(), Arrivals()
    with served_node("rtarm_client", asked.namespace) as node:
        client = Turning(node, goals)
        if asked.listens:
            node.create_subscription(JointState, "joint_states", arrivals.take, 10, raw=True)
        if asked.action and not client.serve(asked.action, asked.server_s):
            raise Refusal(
                f"No ROS process serves {asked.action} in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}: look at "
                "`rtarm status`, and set ROS_DOMAIN_ID as where the arm was started."
            )
        if asked.streams:
            topic = f"{asked.action.rpartition('/')[0]}/joint_trajectory"
            stream = node.create_publisher(JointTrajectory, topic, 10)
            has_subscriber(stream, asked.server_s)  # of the same node: where it never comes, goals go all the same
        gc.collect()
        gc.freeze()  # the collector would walk all of rclpy while goals run and intervals are measured
        print(READY, flush=True)
        for line in sys.stdin:
            said = json.loads(line)
            if "goal" in said:
                client.play(said["number"], said["goal"], said.get("action"))
            elif "stream" in said:
                stream.publish(goal_message(said["stream"]).trajectory)
            elif "states" in said:
                report("states", **arrivals.between(*said["states"]))
            else:
                goals.cancel()
        goals.cancel()
        goals.wait_idle(asked.canceled_s)


def main(arguments: Sequence[str]) -> int:
    """The process; its exit code is 0 unless there is no server."""
    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # read on import; a goal may come from any file
    parser = argparse.ArgumentParser(prog="rtarm.client.program")
    parser.add_argument("--action", help="that goals are for; its server is waited for")
    parser.add_argument("--namespace", default="", help="of the node")
    parser.add_argument("--listens", action="store_true", help="to joint_states of the namespace")
    parser.add_argument("--streams", action="store_true", help="to the joint_trajectory beside the action")
    parser.add_argument("--server-s", type=float, default=10.0, help="how long the server is waited for")
    parser.add_argument("--canceled-s", type=float, default=0.0, help="how long the end of a canceled goal takes")
    try:
        run(parser.parse_args(arguments))
    except Refusal as refusal:
        print(refusal.sentence, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
