"""Waiting for what other threads and processes do."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PATIENCE_S = 10.0


def until(
    condition: Callable[[], Any],
    what: str = "it",
    patience_s: float = PATIENCE_S,
    *,
    of: subprocess.Popen[str] | None = None,
) -> None:
    """Look again and again whether something holds; fails when it does not within `patience_s`, or when `of` ends."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert of is None or of.poll() is None, of.communicate()
        assert time.monotonic() < deadline, f"{what} did not happen within {patience_s} s"
        time.sleep(0.002)


@contextlib.contextmanager
def ready_process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`python ARGUMENTS …`, which finds what we find, once it has said that it is ready; killed in the end."""
    process = subprocess.Popen(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.kill()
        process.wait()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        process.stdout.close()
