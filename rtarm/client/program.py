# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rtarm.client.program ACTION SECONDS`: sends goals for a process that speaks no ROS (`sender`).

Prints `ready` once the action has a server, then obeys every line on standard input: `{"number": …, "goal": …}` sends
a goal, `{}` cancels the one that runs, `{"stream": …}` publishes the trajectory of a goal, which nothing answers.
Reports what becomes of each goal that was sent: `{"event": "result", "number": …, "succeeded": …, "code": …,
"sentence": …}`. When its standard input ends, so that nobody waits any more, it cancels what still runs and waits so
many seconds for its end.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rtarm.client.ros import INVALID_GOAL, goal_message, has_server, has_subscriber, report, served_node
from rtarm.console.errors import Refusal
from rtarm.processes import READY

if TYPE_CHECKING:
    from rclpy.action.client import ClientGoalHandle
    from rclpy.task import Future

    from rosfront.action_client import ActionClient

SERVER_PATIENCE_S = 10.0


class GoalSender:
    """Sends goals and reports their results; its callbacks run in the thread that serves the node."""

    def __init__(self, client: ActionClient) -> None:
        self._client = client
        self._state = threading.Condition()
        self._open: dict[int, ClientGoalHandle | None] = {}  # by number; None until it is accepted
        self._unwanted: set[int] = set()

    def send(self, number: int, document: dict[str, Any]) -> None:
        """Send one goal under the number by which its result is reported; a goal that is none is reported at once."""
        try:
            message = goal_message(document)
        except Refusal as refusal:
            return self._result(number, False, INVALID_GOAL, refusal.sentence)
        with self._state:
            self._open[number] = None
        self._client.send_goal_async(message).add_done_callback(lambda future: self._answered(number, future))

    def cancel(self) -> None:
        """Cancel all that is under way, also what has no answer yet."""
        with self._state:
            self._unwanted.update(self._open)
            running = [handle for handle in self._open.values() if handle is not None]
        for handle in running:
            handle.cancel_goal_async()

    def wait_idle(self, patience_s: float) -> bool:
        """Whether everything has its result within some time."""
        with self._state:
            return self._state.wait_for(lambda: not self._open, patience_s)

    def _answered(self, number: int, future: Future) -> None:
        handle = future.result()
        if not handle.accepted:
            return self._result(number, False, INVALID_GOAL, "The arm rejected the goal without a reason.")
        with self._state:
            self._open[number] = handle
            unwanted = number in self._unwanted
        if unwanted:
            handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(lambda done: self._finished(number, done))

    def _finished(self, number: int, future: Future) -> None:
        from action_msgs.msg import GoalStatus

        outcome = future.result()
        succeeded = outcome.status == GoalStatus.STATUS_SUCCEEDED and outcome.result.error_code == 0
        self._result(number, succeeded, outcome.result.error_code, outcome.result.error_string)

    def _result(self, number: int, succeeded: bool, code: int, sentence: str) -> None:
        report("result", number=number, succeeded=succeeded, code=code, sentence=sentence)
        with self._state:
            self._open.pop(number, None)
            self._unwanted.discard(number)
            self._state.notify_all()


def run(action: str, canceled_s: float) -> None:
    """Send goals until standard input ends; what still runs then has so long to come to its end.

    Raises:
        Refusal: the action has no server.
    """
    from control_msgs.action import FollowJointTrajectory
    from trajectory_msgs.msg import JointTrajectory

    from rosfront.action_client import ActionClient

    with served_node("rtarm_sender") as node:
        client = ActionClient(node, FollowJointTrajectory, action)
        stream = node.create_publisher(JointTrajectory, f"{action.rpartition('/')[0]}/joint_trajectory", 10)
        if not has_server(client, SERVER_PATIENCE_S):
            raise Refusal(
                f"No ROS process serves {action} in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}: look at "
                "`rtarm status`, and set ROS_DOMAIN_ID as where the arm was started."
            )
        has_subscriber(stream, SERVER_PATIENCE_S)  # of the same node: where it never comes, goals go all the same
        sender = GoalSender(client)
        print(READY, flush=True)
        for line in sys.stdin:
            asked = json.loads(line)
            if "goal" in asked:
                sender.send(asked["number"], asked["goal"])
            elif "stream" in asked:
                stream.publish(goal_message(asked["stream"]).trajectory)
            else:
                sender.cancel()
        sender.cancel()
        sender.wait_idle(canceled_s)


def main(arguments: Sequence[str]) -> int:
    """The process; its exit code is 0 unless there is no server."""
    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # read on import; a goal may come from any file
    try:
        action, canceled_s = arguments
        run(action, float(canceled_s))
    except Refusal as refusal:
        print(refusal.sentence, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
