"""What the benchmark's processes share: lines they obey, and the lateness they keep between two of them."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable

from rtarm.bench.lateness import as_pairs, recorded
from rtarm.processes import report

Handler = Callable[[str], None]


class Recording:
    """Keeps the lateness of every cycle; the thread that adds needs no lock against the one that takes."""

    def __init__(self) -> None:
        self._late_ns: list[int] = []

    def add(self, late_ns: int) -> None:
        """Keep one cycle's lateness (ns)."""
        self._late_ns.append(late_ns)

    def begin(self) -> None:
        """Forget what was."""
        self._late_ns = []

    def end(self) -> None:
        """Report what was kept since the beginning."""
        report("lateness", pairs=as_pairs(recorded(self._late_ns)))


class _Terminated(Exception):
    """SIGTERM came."""


def obey(handlers: dict[str, Handler]) -> None:
    """Call the handler that the first word of each line on standard input names, with the rest of the line.

    Returns when standard input is closed and, in the main thread, at SIGTERM, so that a ROS process can take its leave:
    the middleware leaves its files in /dev/shm otherwise.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminate)
    try:
        for line in sys.stdin:
            word, _, rest = line.strip().partition(" ")
            handlers[word](rest)
    except _Terminated:
        pass


def _terminate(_number: int, _frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise _Terminated
