# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""rclpy's action client, made to lose no answers when one thread asks and another one serves the node."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from rclpy.action import client

if TYPE_CHECKING:
    from rclpy.task import Future


class ActionClient(client.ActionClient):
    """An action client that handles an answer only after the request's future was stored.

    rclpy's own client sends a request first and stores its future then. It drops an answer that was taken in between
    with a warning, and the caller waits for ever.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._asking = threading.Lock()
        super().__init__(*arguments, **options)

    def send_goal_async(self, *arguments: Any, **options: Any) -> Future:
        """As rclpy's."""
        with self._asking:
            sent: Future = super().send_goal_async(*arguments, **options)
        return sent

    def _get_result_async(self, goal_handle: client.ClientGoalHandle) -> Future:
        with self._asking:
            asked: Future = super()._get_result_async(goal_handle)
        return asked

    def _cancel_goal_async(self, goal_handle: client.ClientGoalHandle) -> Future:
        with self._asking:
            asked: Future = super()._cancel_goal_async(goal_handle)
        return asked

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """As rclpy's."""
        with self._asking:
            pass  # a future that is being stored is stored now
        await super().execute(taken_data)
