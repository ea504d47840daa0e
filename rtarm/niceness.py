"""Work at the lowest ordinary priority, so that a control process without real-time priority goes first.

Niceness cannot be lowered again without permission, and every thread and process that is started later inherits it. In
Linux it belongs to a thread. So it is given to a thread that ends with the work, and not to the process that runs the
command, which may be somebody's own program.
"""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor

MOST_NICE = 19


def nice_thread() -> ThreadPoolExecutor:
    """One thread of the lowest priority, as are all threads and processes that its work starts."""
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="nice", initializer=_give_way)


def _give_way() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), MOST_NICE)
