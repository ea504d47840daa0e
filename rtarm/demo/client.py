# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rtarm.demo.client NAMESPACE ACTION GOAL…`: the demo's own action client, a process like any MoveIt.

Prints `ready` when the action server is there, waits for a line on standard input, then sends the goals one
after the other and reports in JSON, one object a line: `accepted`, `result` for each goal, and at the end
`joint_states`, the arrival of that topic of the namespace while the goals ran.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtarm.client.ros import INVALID_GOAL, goal_message, report, served_node, wait
from rtarm.console.errors import Refusal
from rtarm.demo.goals import Goal, load_goal
from rtarm.processes import READY

if TYPE_CHECKING:
    from rclpy.node import Node

SERVER_PATIENCE_S = 60.0
ACCEPT_PATIENCE_S = 5.0
RESULT_PATIENCE_S = 10.0
"""Beyond the planned duration."""

NO_RESULT = -1000
"""Ours: the server gave no result in time. ROS knows no such code."""

STAMP_AT = 4
"""Offset of header.stamp in a serialised message: after the CDR encapsulation header."""


class Arrivals:
    """When messages arrived, and how old their stamps were."""

    def __init__(self) -> None:
        self._monotonic_ns: list[int] = []
        self._age_ns: list[int] = []

    def take(self, message: bytes) -> None:
        """Called with each serialised message; decodes nothing but the stamp."""
        self._monotonic_ns.append(time.monotonic_ns())
        sec = int.from_bytes(message[STAMP_AT : STAMP_AT + 4], "little", signed=True)
        nanosec = int.from_bytes(message[STAMP_AT + 4 : STAMP_AT + 8], "little")
        self._age_ns.append(time.time_ns() - sec * 1_000_000_000 - nanosec)

    def between(self, first_ns: int, last_ns: int) -> dict[str, Any]:
        """Rate, interval and age percentiles of what arrived between two instants (CLOCK_MONOTONIC)."""
        arrived = np.asarray(self._monotonic_ns, np.int64)
        ages = np.asarray(self._age_ns[: len(arrived)], np.int64)
        inside = (arrived >= first_ns) & (arrived <= last_ns)
        arrived, ages = arrived[inside], ages[inside]
        if len(arrived) < 2:
            return {"count": len(arrived), "rate_hz": 0.0, "interval_ms": None, "age_ms": None}
        return {
            "count": len(arrived),
            "rate_hz": (len(arrived) - 1) / (int(arrived[-1] - arrived[0]) * 1e-9),
            "interval_ms": percentiles(np.diff(arrived) * 1e-6),
            "age_ms": percentiles(ages * 1e-6),
        }


def percentiles(values: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and maximum."""
    return {
        "p50": float(np.percentile(values, 50)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }


def play(client: Any, goal: Goal) -> bool:
    """Send one goal, report how it went, and say whether it succeeded."""
    from action_msgs.msg import GoalStatus

    feedback = 0

    def count(_: Any) -> None:
        nonlocal feedback
        feedback += 1

    sent = client.send_goal_async(goal_message(goal.document), feedback_callback=count)
    if not wait(sent, ACCEPT_PATIENCE_S):
        return _failed(goal, NO_RESULT, f"The server did not answer the goal within {ACCEPT_PATIENCE_S:g} s.")
    handle = sent.result()
    if not handle.accepted:
        return _failed(goal, INVALID_GOAL, "The server rejected the goal.")
    accepted_ns = time.monotonic_ns()
    report("accepted", goal=goal.name)
    finished = handle.get_result_async()
    patience_s = 1.5 * goal.planned_s + RESULT_PATIENCE_S
    if not wait(finished, patience_s):
        handle.cancel_goal_async()
        return _failed(goal, NO_RESULT, f"The server gave no result within {patience_s:.1f} s.")
    outcome = finished.result()
    succeeded = bool(outcome.status == GoalStatus.STATUS_SUCCEEDED and outcome.result.error_code == 0)
    report(
        "result",
        goal=goal.name,
        succeeded=succeeded,
        error_code=outcome.result.error_code,
        error_string=outcome.result.error_string,
        planned_s=goal.planned_s,
        actual_s=(time.monotonic_ns() - accepted_ns) * 1e-9,
        feedback=feedback,
    )
    return succeeded


def _failed(goal: Goal, code: int, sentence: str) -> bool:
    report(
        "result",
        goal=goal.name,
        succeeded=False,
        error_code=code,
        error_string=sentence,
        planned_s=goal.planned_s,
        actual_s=0.0,
        feedback=0,
    )
    return False


@contextlib.contextmanager
def listening(name: str, namespace: str) -> Iterator[tuple[Node, Arrivals]]:
    """A node, served by a thread of its own, and how the joint_states of its namespace arrive at it."""
    from sensor_msgs.msg import JointState

    arrivals = Arrivals()
    with served_node(name, namespace) as node:
        node.create_subscription(JointState, "joint_states", arrivals.take, 10, raw=True)
        yield node, arrivals


def run(namespace: str, action: str, goals: Sequence[Goal]) -> int:
    """Connect, wait for the word, play the goals until one fails; exit code 0 only if all succeeded."""
    from control_msgs.action import FollowJointTrajectory

    from rosfront.action_client import ActionClient

    with listening("rtarm_demo", namespace) as (node, arrivals):
        client = ActionClient(node, FollowJointTrajectory, action)
        if not client.wait_for_server(timeout_sec=SERVER_PATIENCE_S):
            raise Refusal(f"No action server {action} appeared within {SERVER_PATIENCE_S:g} s.")
        print(READY, flush=True)
        if not sys.stdin.readline():
            return 1  # the parent is gone
        gc.collect()
        gc.freeze()  # the collector would walk all of rclpy while intervals are measured
        started_ns = time.monotonic_ns()
        succeeded = all(play(client, goal) for goal in goals)
        report("joint_states", **arrivals.between(started_ns, time.monotonic_ns()))
    return 0 if succeeded else 1


def main(arguments: Sequence[str]) -> int:
    """The process; its exit code is 0 only if every goal succeeded."""
    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # read on import; a goal file may hold anything
    try:
        namespace, action, *paths = arguments
        return run(namespace, action, [load_goal(Path(path)) for path in paths])
    except Refusal as refusal:
        print(refusal.sentence, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
