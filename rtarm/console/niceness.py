"""Work at the lowest ordinary priority, so that a control process without real-time priority goes first.

Niceness cannot be lowered again without permission, and every thread and process that is started later inherits it. In
Linux it belongs to a thread. So it is given to a thread that ends with the work, and not to the process that runs the
command, which may be somebody's own program.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import TypeVar

MOST_NICE = 19

T = TypeVar("T")


def nice_thread() -> ThreadPoolExecutor:
    """One thread of the lowest priority, as are all threads and processes that its work starts."""
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="nice", initializer=_give_way)


def done_by(thread: Executor, work: Callable[[], T]) -> T:
    """What the work of a thread gives; meanwhile this one, the main thread, wakes up for signals alone.

    Python's handlers run in the main thread, and a signal wakes it from waiting for another one only where the kernel
    gives it to that thread, and not in the moment before it waits. The byte that the interpreter writes comes always.
    """
    awake, wake = socket.socketpair()
    with awake, wake:
        wake.setblocking(False)

        def end(_: object) -> None:
            with contextlib.suppress(OSError):  # full, so there is a byte to be read; or closed: nobody waits any more
                wake.send(b"\0")

        others = signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
        try:
            done = thread.submit(work)
            done.add_done_callback(end)
            while not done.done():
                awake.recv(4096)
            return done.result()
        finally:
            signal.set_wakeup_fd(others)


def _give_way() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), MOST_NICE)
