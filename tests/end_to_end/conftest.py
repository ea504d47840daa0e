"""Arms of real processes, closed after each test."""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from stack import PATIENT, Stack


@pytest.fixture
def stack_at(arm_name: str, tmp_path: Path) -> Iterator[Callable[..., Stack]]:
    """Makes the arm of a test with simulated drives running: where they are [degrees], options of the simulation."""
    ends = contextlib.ExitStack()

    def make(start_deg: Sequence[float], *options: str) -> Stack:
        stack = Stack(arm_name, tmp_path, start_deg=start_deg)
        stack.change(limits=PATIENT)
        ends.callback(stack.close)
        stack.start_sim(*options)
        return stack

    with ends:
        yield make


@pytest.fixture
def served_at(stack_at: Callable[..., Stack]) -> Iterator[Callable[[Sequence[float]], Stack]]:
    """Makes the arm of a test with all its processes: where its joints are [rad]; `client` is a ROS client of it."""
    from ros_client import Client

    ends = contextlib.ExitStack()

    def make(start_rad: Sequence[float]) -> Stack:
        stack = stack_at([math.degrees(angle) for angle in start_rad])
        stack.start_loop()
        stack.start_front()
        stack.client = Client(f"controller_{stack.name}")

        def end_client() -> None:
            stack.client.close()  # a test may have put another in its place

        ends.callback(end_client)
        return stack

    with ends:
        yield make
