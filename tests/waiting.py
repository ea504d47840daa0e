"""Waiting for what other threads and processes do."""

import subprocess
import time
from collections.abc import Callable
from typing import Any

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
