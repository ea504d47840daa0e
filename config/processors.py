"""Where everything but the cycle runs, in both processes."""

import contextlib
import os
from pathlib import Path


def leave_to_cycle(cpu: int | None) -> None:
    """Keep every thread of this process, and those they start, off the cycle's processor, unless there is no other.

    A timer that such a thread armed there would interrupt the cycle about when it wakes up, since what reads the
    cycle's results wakes up in step with it.
    """
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # where that is forbidden the cycle cannot have its processor either
            allowed = os.sched_getaffinity(int(task.name))
            os.sched_setaffinity(int(task.name), allowed - {cpu} or allowed)
