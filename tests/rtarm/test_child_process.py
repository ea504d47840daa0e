"""`rtarm.processes.Child` with small programs as children."""

from __future__ import annotations

import asyncio
import os
import select
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from rtarm.processes import Child, plain_environment

pytestmark = pytest.mark.process

Start = Callable[..., Awaitable[Child]]
LONG_S = 20.0


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Start a program as a child that appends its lines to `said`."""

    async def run(program: str, said: list[str] | None = None, *, told: bool = False) -> Child:
        (tmp_path / "a_child.py").write_text(program, encoding="utf-8")
        environment = {**plain_environment(), "PYTHONPATH": str(tmp_path)}
        take = ([] if said is None else said).append
        return await Child.start("it", "a_child", ["an argument"], environment, take, told=told)

    return run


def test_ready_lines_and_end(start: Start) -> None:
    said: list[str] = []

    async def scenario() -> None:
        child = await start(
            "import sys; print('before'); print('ready /dev/x'); print('ready twice')\n"
            "sys.stderr.write('no newline at the end'); print(sys.argv[1]); sys.exit(3)",
            said,
        )
        assert await child.ready() == "/dev/x"
        assert await child.ended() == 3
        assert (child.was_ready, child.has_ended, child.code) == (True, True, 3)
        assert child.last_line == "no newline at the end"

    asyncio.run(scenario())
    assert sorted(said) == ["an argument", "before", "no newline at the end", "ready twice"]


def test_an_end_before_readiness_is_no_readiness(start: Start) -> None:
    async def scenario() -> None:
        child = await start("import sys; sys.exit('It refuses.')")
        assert await child.ready() is None
        assert (await child.ended(), child.was_ready, child.last_line) == (1, False, "It refuses.")

    asyncio.run(scenario())


def test_a_child_can_be_told_something(start: Start) -> None:
    said: list[str] = []

    async def scenario() -> None:
        child = await start("print('ready'); print('told ' + input())", said, told=True)
        await child.ready()
        child.tell("go")
        assert await child.ended() == 0

    asyncio.run(scenario())
    assert said == ["told go"]


def test_stop_asks_first(start: Start) -> None:
    async def scenario() -> None:
        child = await start(
            "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))\n"
            "print('ready', flush=True); signal.pause()"
        )
        await child.ready()
        assert await child.stop(LONG_S)
        assert child.code == 0
        assert await child.stop(LONG_S)  # once more does no harm

    asyncio.run(scenario())


def test_stop_kills_what_does_not_listen(start: Start) -> None:
    async def scenario() -> None:
        child = await start(
            "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('ready', flush=True)\n"
            "while True: signal.pause()"
        )
        await child.ready()
        assert not await child.stop(0.1)
        assert child.code == -signal.SIGKILL

    asyncio.run(scenario())


def test_ctrl_c_in_the_terminal_does_not_reach_it(start: Start) -> None:
    async def scenario() -> None:
        child = await start("print('ready', flush=True); input()", told=True)
        await child.ready()
        assert os.getpgid(child.pid) != os.getpgid(0)
        child.tell("end")
        await child.ended()

    asyncio.run(scenario())


def test_a_child_dies_with_its_parent_even_by_kill_9(tmp_path: Path) -> None:
    (tmp_path / "a_child.py").write_text(
        "import os, signal; print('ready', os.getpid(), flush=True); signal.pause()", encoding="utf-8"
    )
    parent = (
        "import asyncio, os\n"
        "from rtarm.processes import Child, plain_environment\n"
        "async def main():\n"
        f"    environment = {{**plain_environment(), 'PYTHONPATH': {str(tmp_path)!r}}}\n"
        "    child = await Child.start('it', 'a_child', [], environment, print)\n"
        "    print(await child.ready(), flush=True)\n"
        "    await child.ended()\n"
        "asyncio.run(main())\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        grandchild = os.pidfd_open(int(process.stdout.readline()))
        process.kill()
    ended, _, _ = select.select([grandchild], [], [], LONG_S)
    os.close(grandchild)
    assert ended
