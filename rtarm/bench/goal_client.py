# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""`python -m rtarm.bench.goal_client NAMESPACE`: sends goals and listens to joint_states, like any MoveIt.

Prints `ready`, then obeys every line on standard input: `play {"action": …, "goal": …}` sends a goal and reports
`{"event": "accepted", "sent_ns": …}` (CLOCK_MONOTONIC) and in the end `{"event": "result", "succeeded": …,
"sentence": …}`; `states FIRST_NS LAST_NS` reports the arrival of joint_states between two such instants.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from typing import Any

from rtarm.bench.measured import obey
from rtarm.client.ros import goal_message, has_server, in_executor, report, wait
from rtarm.demo.client import listening
from rtarm.processes import READY

SERVER_PATIENCE_S = 20.0
ANSWER_PATIENCE_S = 5.0
RESULT_PATIENCE_S = 30.0


def play(node: Any, action: str, goal: dict[str, Any]) -> None:
    """Send one goal to an action server that may just have come up, and report what becomes of it."""
    from control_msgs.action import FollowJointTrajectory

    from rosfront.action_client import ActionClient

    gc.collect()
    gc.freeze()  # before a slice rather than in it
    client = ActionClient(node, FollowJointTrajectory, action)
    try:
        if not has_server(client, SERVER_PATIENCE_S):
            return _failed(f"No action server {action} appeared within {SERVER_PATIENCE_S:g} s.")
        message = goal_message(goal)
        sent_ns = time.monotonic_ns()
        sent = client.send_goal_async(message)
        if not wait(sent, ANSWER_PATIENCE_S) or not sent.result().accepted:
            return _failed(f"{action} did not accept the goal within {ANSWER_PATIENCE_S:g} s.")
        report("accepted", sent_ns=sent_ns)
        ended = sent.result().get_result_async()
        if not wait(ended, RESULT_PATIENCE_S):
            return _failed(f"{action} gave no result within {RESULT_PATIENCE_S:g} s.")
        result = ended.result().result
        report("result", succeeded=result.error_code == 0, sentence=result.error_string)
    finally:
        in_executor(node, client.destroy)


def _failed(sentence: str) -> None:
    report("result", succeeded=False, sentence=sentence)


def main() -> int:
    """The process, until its standard input is closed."""
    with listening("rtarm_bench", sys.argv[1]) as (node, arrivals):
        print(READY, flush=True)

        def on_play(rest: str) -> None:
            play(node, **json.loads(rest))

        def on_states(rest: str) -> None:
            first_ns, last_ns = map(int, rest.split())
            report("states", **arrivals.between(first_ns, last_ns))

        obey({"play": on_play, "states": on_states})
    return 0


if __name__ == "__main__":
    sys.exit(main())
