# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""A subscription with a thread of its own.

For each message rclpy's executor makes a new wait set of everything the node has, which costs several times what a
stream's message costs here. Besides, a stream with its own thread does not wait for the executor's other work.
"""

import threading
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile


class Apart(CallbackGroup):
    """A callback group that the executor skips.

    It holds the events of a subscription, too: if the executor had only these, every message would wake it.
    """

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return True

    def ending_execution(self, entity: Any) -> None:
        pass


class SubscriptionApart(threading.Thread):
    """Calls `take` with every serialised message until `stop`; its exceptions are raised in the executor's thread."""

    def __init__(
        self, node: Node, executor: Executor, kind: type, topic: str, qos: QoSProfile, take: Callable[[bytes], None]
    ) -> None:
        super().__init__(name=topic, daemon=True)
        self._executor = executor
        self._take = take
        self._leaving = False
        group = Apart()
        self._subscription = node.create_subscription(kind, topic, take, qos, callback_group=group, raw=True)
        self._leave = node.create_guard_condition(lambda: None, callback_group=group)
        assert node.context.handle is not None
        self._context = node.context.handle

    def stop(self, patience_s: float) -> None:
        """Take no further message; returns when none is being taken, after `patience_s` at the latest."""
        self._leaving = True
        self._leave.trigger()
        if self.is_alive():
            self.join(patience_s)

    def run(self) -> None:
        try:
            self._serve()
        except BaseException as problem:
            failure = problem

            def fail() -> None:
                raise failure

            self._executor.create_task(fail)

    def _serve(self) -> None:
        messages, leave, kind = self._subscription.handle, self._leave.handle, self._subscription.msg_type
        events: Any = self._subscription.event_handlers  # a list, whatever rclpy's annotation says
        with messages, leave, self._context:
            wait_set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, len(events), self._context)
            while not self._leaving:
                wait_set.clear_entities()
                wait_set.add_subscription(messages)
                wait_set.add_guard_condition(leave)
                for event in events:
                    event.add_to_wait_set(wait_set)
                wait_set.wait(-1)
                for event in events:
                    if event.is_ready(wait_set):
                        self._executor.create_task(event.execute, event.take_data())
                while not self._leaving and (taken := messages.take_message(kind, True)):
                    self._take(taken[0])
