"""Work at the lowest ordinary priority, so that a control process without real-time priority goes first.

Niceness cannot be lowered again without permission, and every thread and process that is started later inherits it. In
Linux it belongs to a thread. So it is given to a thread that ends with the work, and not to the process that runs the
command, which may be somebody's own program.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor, wait
from typing import TypeVar

MOST_NICE = 19
AWAKE_S = 0.1

T = TypeVar("T")


def nice_thread() -> ThreadPoolExecutor:
    """One thread of the lowest priority, as are all threads and processes that its work starts."""
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="nice", initializer=_give_way)


def done_by(thread: Executor, work: Callable[[], T]) -> T:
    """What the work of a thread gives; meanwhile this one, the main thread, wakes up again and again for signals.

    Python's handlers run in the main thread alone, and a signal wakes it from a wait without an end only where the
    kernel gives it to that thread, and not in the moment before it waits.
    """
    done = thread.submit(work)
    while not wait((done,), AWAKE_S).done:
        pass
    return done.result()


def _give_way() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), MOST_NICE)
