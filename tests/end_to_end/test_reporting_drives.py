"""Drives that report their positions and take fast targets, with real processes: who leaves them how."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from stack import Stack

pytestmark = pytest.mark.process

ENDED = "its drive sent its position by itself, which was ended"
NEWER = {"positions": "reported", "position_command": "FC"}
DEFAULT = {"positions": "polled", "position_command": "FD"}


@pytest.fixture
def stack(tmp_path: Path, arm_name: str) -> Iterator[Stack]:
    stack = Stack(arm_name, tmp_path)
    stack.start_sim()
    yield stack
    stack.close()


@pytest.fixture
def begin(stack: Stack) -> Callable[[dict[str, str]], None]:
    """Start a control process with these options, until it is ready."""

    def begin(options: dict[str, str]) -> None:
        stack.change(bus=options)
        stack.start_loop()

    return begin


def test_a_killed_process_leaves_reports_and_an_orderly_end_does_not(
    stack: Stack, begin: Callable[[dict[str, str]], None]
) -> None:
    begin(NEWER)
    stack.loop.process.kill()
    stack.loop.process.wait()
    begin(DEFAULT)
    assert stack.loop.said().count(ENDED) == 6
    stack.loop.process.terminate()
    assert stack.loop.code() == 0
    begin(NEWER)
    stack.loop.process.terminate()
    assert stack.loop.code() == 0, stack.loop.text
    begin(DEFAULT)
    assert ENDED not in stack.loop.said()
