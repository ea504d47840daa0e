"""The first use of an installed wheel: what it needs is made on all processors, with a line for each step."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rtarm.launch.steps import CYCLE_S, MESSAGES_S
from rtarm.processes import plain_environment

COMPILER = ("-P", "-m", "rtloop.warm")


@contextmanager
def cycle_compiled_beside() -> Iterator[None]:
    """While the message types are made, compile the control cycle too, unless that was done.

    What goes wrong with it the control process says, which compiles it when it finds none.
    """
    from rtloop.process import compiled

    if compiled.path().exists():
        yield
        return
    _say(f"step 1 of 2: ROS messages, about {MESSAGES_S:.0f} s …")
    _say(f"step 2 of 2: the control cycle, about {CYCLE_S:.0f} s …")
    started = time.monotonic()
    compiler = subprocess.Popen(
        [sys.executable, *COMPILER],
        env=plain_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        process_group=0,
    )
    try:
        yield
        _say(f"step 1 of 2: ROS messages, {time.monotonic() - started:.0f} s")
        if compiler.wait() == 0:
            _say(f"step 2 of 2: the control cycle, {time.monotonic() - started:.0f} s")
    finally:
        compiler.kill()
        compiler.wait()


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
