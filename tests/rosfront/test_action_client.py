"""Answers that come before rclpy knows what was asked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")

from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer
from rclpy.node import Node

from rosfront.action_client import ActionClient
from rtarm.client.ros import in_executor, served_node, wait

pytestmark = pytest.mark.process

PATIENCE_S = 60.0


class Slow(dict[int, Any]):
    """Requests under way; who looks one up, as rclpy does between sending it and noting it, waits for its answer."""

    def __init__(self, taken: threading.Event) -> None:
        super().__init__()
        self._taken = taken
        self._slow = True

    def __contains__(self, number: object) -> bool:
        if self._slow:
            self._slow = False
            assert self._taken.wait(PATIENCE_S)
        return super().__contains__(number)


class Overtaken(ActionClient):
    """A client that hears every answer before the request is noted."""

    def __init__(self, *arguments: Any) -> None:
        self.taken = {kind: threading.Event() for kind in ("goal", "result", "cancel")}
        super().__init__(*arguments)
        for kind, taken in self.taken.items():
            setattr(self, f"_pending_{kind}_requests", Slow(taken))

    def take_data(self) -> dict[str, Any]:
        taken: dict[str, Any] = super().take_data()
        taken.pop("status", None)  # which comes in no order with the answers
        for kind in taken:
            if kind in self.taken:
                self.taken[kind].set()
        return taken


@pytest.fixture
def node() -> Iterator[Node]:
    with served_node("asking") as node:
        yield node


def test_an_answer_that_overtakes_the_note_of_its_request_is_not_lost(node: Node) -> None:
    def execute(goal: Any) -> FollowJointTrajectory.Result:
        goal.abort()
        return FollowJointTrajectory.Result()

    server = ActionServer(node, FollowJointTrajectory, "follow", execute)
    client = Overtaken(node, FollowJointTrajectory, "follow")
    try:
        assert client.wait_for_server(PATIENCE_S)
        sent = client.send_goal_async(FollowJointTrajectory.Goal())
        assert wait(sent, PATIENCE_S)
        assert wait(sent.result().cancel_goal_async(), PATIENCE_S)
        ended = sent.result().get_result_async()
        assert wait(ended, PATIENCE_S)
        assert ended.result().status == GoalStatus.STATUS_ABORTED
    finally:
        in_executor(node, client.destroy)
        in_executor(node, server.destroy)
