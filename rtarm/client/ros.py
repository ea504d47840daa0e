# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""What our own ROS clients share: a node with a thread that serves it, waiting for futures, goals as messages."""

from __future__ import annotations

import contextlib
import importlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from rosfront.program import CannotServe, start_ros
from rtarm.console.errors import Refusal

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from rosfront.action_client import ActionClient

INVALID_GOAL = -1
"""FollowJointTrajectory.Result.INVALID_GOAL."""
PATIENCE_S = 10.0
LOOK_S = 0.01
MUTUAL_S = 0.3
"""For the server to find the client too, without which it may not answer: only the other direction can be seen."""


@contextlib.contextmanager
def served_node(name: str, namespace: str = "") -> Iterator[Node]:
    """A node of this name, served by a thread of its own; SIGTERM simply ends the process.

    Raises:
        Refusal: ROS cannot be used as the environment has it.
    """
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.utilities import try_shutdown

    try:
        start_ros([])
    except CannotServe as problem:
        raise Refusal(str(problem)) from None
    node = rclpy.create_node(name, namespace=namespace)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        with spinning(executor):
            yield node
    finally:
        node.destroy_node()
        try_shutdown()


@contextlib.contextmanager
def spinning(executor: Executor) -> Iterator[None]:
    """A thread that serves an executor, and has ended before the executor is shut down.

    rclpy's `spin` may have work in its hands while another thread shuts its executor down, and then fails on a guard
    condition that is destroyed.
    """
    from rclpy.executors import ExternalShutdownException

    ends = threading.Event()

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not ends.is_set():
                executor.spin_once()

    spinner = threading.Thread(target=spin, daemon=True)
    spinner.start()
    try:
        yield
    finally:
        ends.set()
        executor.create_task(lambda: None)  # a turn of `spin_once`, which may wait for ever
        spinner.join()
        executor.shutdown()


def in_executor(node: Node, work: Callable[[], object]) -> None:
    """Do something in the thread that serves a node.

    What another thread destroys while rclpy's executor prepares to wait for it ends that one's thread.
    """
    assert node.executor is not None
    task = node.executor.create_task(work)
    if not wait(task, PATIENCE_S):
        raise TimeoutError(f"the thread that serves {node.get_name()} does nothing")
    task.result()


def has_server(client: ActionClient, patience_s: float) -> bool:
    """Whether an action has a server within some time; both have found each other then."""
    if not client.wait_for_server(timeout_sec=patience_s):
        return False
    time.sleep(MUTUAL_S)
    return True


def has_subscriber(publisher: Publisher, patience_s: float) -> bool:
    """Whether somebody listens to a topic within some time: what is published before is lost."""
    until_s = time.monotonic() + patience_s
    while not publisher.get_subscription_count():
        if time.monotonic() > until_s:
            return False
        time.sleep(LOOK_S)
    return True


def goal_message(document: dict[str, Any]) -> Any:
    """The recorded goal as a FollowJointTrajectory.Goal, field for field."""
    from control_msgs.action import FollowJointTrajectory

    message = FollowJointTrajectory.Goal()
    fill(message, document)
    return message


def fill(message: Any, values: dict[str, Any]) -> None:
    """Set the fields of a ROS message from plain values, whatever its type.

    Raises:
        Refusal: the values have a field that the message has not, or a value of the wrong type.
    """
    types = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in types:
            raise Refusal(f"The goal has a field {name!r}, which {type(message).__name__} has not: remove it.")
        present = getattr(message, name)
        try:
            if isinstance(value, dict):
                fill(present, value)
            elif isinstance(value, list) and value and isinstance(value[0], dict):
                setattr(message, name, [_filled(types[name], item) for item in value])
            else:
                setattr(message, name, value)
        except (AssertionError, AttributeError, TypeError, ValueError):
            raise Refusal(f"The goal's field {name!r} is no {types[name]}: correct it.") from None


def _filled(sequence: str, values: dict[str, Any]) -> Any:
    """A message of the type in `sequence<trajectory_msgs/JointTrajectoryPoint>`."""
    package, name = sequence.partition("<")[2].rstrip(">").split(",")[0].split("/")
    message = getattr(importlib.import_module(f"{package}.msg"), name)()
    fill(message, values)
    return message


def wait(future: Any, patience_s: float) -> bool:
    """Whether an rclpy future, which another thread completes, is done in time."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return done.wait(patience_s)
