"""At which priority a process works: threads that only wait do not count."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

PATIENCE_S = 60.0


def niceness_at_work(pid: int, work_ns: int = 50_000_000) -> set[int]:
    """Niceness of the threads that work while a process uses so much processor time from now on."""
    before = _used_ns(pid)
    deadline = time.monotonic() + PATIENCE_S
    while True:
        worked = {
            thread: used_ns - before.get(thread, 0)
            for thread, used_ns in _used_ns(pid).items()
            if used_ns > before.get(thread, 0)
        }
        if sum(worked.values()) >= work_ns:
            break
        assert time.monotonic() < deadline, f"process {pid} does nothing"
        time.sleep(0.02)
    found = set()
    for thread in worked:
        with contextlib.suppress(ProcessLookupError):
            found.add(os.getpriority(os.PRIO_PROCESS, thread))
    return found


def _used_ns(pid: int) -> dict[int, int]:
    """Processor time of each thread, as the scheduler counts it."""
    used = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended just now
            used[int(thread.name)] = int((thread / "schedstat").read_text().split()[0])
    return used
