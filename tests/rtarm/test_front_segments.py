"""A ROS process that is killed before it was ready: what the middleware made for it is removed."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rich.console import Console

from rtarm.launcher import Launcher, load_plan
from rtarm.processes import Child, plain_environment
from rtarm.reporter import Reporter

STAND_IN = """
import fcntl, sys, time

segment = sys.argv[1]
open(segment, "w").close()
lock = open(segment + "_el", "w")
fcntl.flock(lock, fcntl.LOCK_EX)
time.sleep(60.0)
"""
PATIENCE_S = 20.0


@pytest.fixture
def segment() -> Iterator[Path]:
    """The name of a segment of Fast DDS that is nobody's."""
    path = Path(f"/dev/shm/fastrtps_{secrets.token_hex(8)}")
    yield path
    path.unlink(missing_ok=True)
    Path(f"{path}_el").unlink(missing_ok=True)


async def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.01)


@pytest.mark.process
def test_segments_of_a_ros_process_that_never_was_ready_are_removed(
    segment: Path, mock_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stand_in.py").write_text(STAND_IN, encoding="utf-8")
    launcher = Launcher(load_plan(str(mock_file), {}, simulated=False), Reporter(Console(quiet=True)))

    async def spawn(name: str, *_: object) -> Child:
        environment = {**plain_environment(), "PYTHONPATH": str(tmp_path)}
        return await Child.start(name, "stand_in", [str(segment)], environment, lambda line: None)

    async def kill_before_it_is_ready() -> None:
        monkeypatch.setattr(launcher, "_spawn", spawn)
        front = await launcher._start_front()
        launcher._front = front
        try:
            await until(lambda: launcher._segments == [segment])
            os.kill(front.pid, signal.SIGKILL)
            await front.ended()
            assert segment.exists()
        finally:
            await launcher.stop()

    asyncio.run(kill_before_it_is_ready())
    assert not segment.exists()
    assert not Path(f"{segment}_el").exists()
