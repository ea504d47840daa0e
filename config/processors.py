"""Where everything but the cycle runs, in both processes."""

import contextlib
import os
from pathlib import Path


def leave_to_cycle(cpu: int | None) -> None:
    """Keep every thread of this process, and those they start, off the cycle's processor, unless there is no other.

    What reads the cycle's results wakes up in step with it, and a timer that is armed on its processor interrupts it.
    """
    if cpu is None:
        return
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # where that is forbidden the cycle cannot have its processor either
            others = os.sched_getaffinity(int(task.name)) - {cpu}
            if others:
                os.sched_setaffinity(int(task.name), others)
