"""How far a recording has come, shown on a terminal while one waits; nothing anywhere else."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from rtarm.recording.follow import Progress as Grown
from rtarm.recording.mcap_format import Step

if TYPE_CHECKING:
    from typing_extensions import Buffer


def _console() -> Console:
    """Standard error: what a command prints is the path of a file, or a story, and may go elsewhere."""
    return Console(stderr=True, highlight=False, emoji=False)


@contextmanager
def share(what: str) -> Iterator[Step]:
    """A bar of a work whose share that is done (0…1) is told to what is yielded; it vanishes at the end."""
    console = _console()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda done: progress.update(task, completed=done)


@contextmanager
def growing(span_s: float | None) -> Iterator[Callable[[Grown], None]]:
    """A line that says how long and large a recording is, and what is missing; a bar too if it ends after `span_s`."""
    screen = _Screen.of_standard_error()
    if screen is None:
        yield lambda _: None
        return
    text = TextColumn("recording, Ctrl-C ends it: {task.description}")
    columns = (SpinnerColumn(), text) if span_s is None else (text, BarColumn(), TimeRemainingColumn())
    with io.TextIOWrapper(screen, sys.stderr.encoding, sys.stderr.errors, write_through=True) as file:
        console = Console(file=file, highlight=False, emoji=False)
        # Drawn by the thread that records, which is of the lowest priority, and not by one of the display's own.
        with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
            task = progress.add_task("…", total=span_s)

            def told(grown: Grown) -> None:
                progress.update(task, description=Text(grown.told()).plain, completed=grown.seconds, refresh=True)

            try:
                yield told
            finally:
                screen.make_room()


class _Screen(io.FileIO):
    """A terminal that keeps nobody waiting: what it does not take at once (Ctrl-S, a stuck ssh) is not shown."""

    stuck = False

    @classmethod
    def of_standard_error(cls) -> _Screen | None:
        """None where it is no terminal, or one that may not be opened once more, such as another user's."""
        if not sys.stderr.isatty():
            return None
        try:
            # Opened once more, since other programs share standard error and would be told not to wait either.
            fd = os.open(f"/proc/self/fd/{sys.stderr.fileno()}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError:
            return None
        return cls(fd, "w")

    def write(self, data: Buffer) -> int:
        size = memoryview(data).nbytes
        try:
            self.stuck = super().write(data) != size
        except OSError:  # it is gone
            self.stuck = True
        return size

    def make_room(self) -> None:
        """If it is stuck, drop what nobody has read and let it go on, for there is still to tell how it ended."""
        if not self.stuck:
            return
        # Else a process in the background would be stopped for what it does to its terminal.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTTOU,))
        with contextlib.suppress(termios.error):  # it is gone
            termios.tcflush(self.fileno(), termios.TCOFLUSH)
            termios.tcflow(self.fileno(), termios.TCOOFF)  # without which TCOON would not end a Ctrl-S
            termios.tcflow(self.fileno(), termios.TCOON)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
