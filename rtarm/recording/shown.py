"""How far a recording has come, shown on a terminal while one waits; nothing anywhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from rtarm.recording.follow import Progress as Grown
from rtarm.recording.mcap_format import Step


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
    console = _console()
    text = TextColumn("recording, Ctrl-C ends it: {task.description}")
    columns = (SpinnerColumn(), text) if span_s is None else (text, BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("…", total=span_s)

        def told(grown: Grown) -> None:
            progress.update(task, description=Text(grown.told()).plain, completed=grown.seconds)

        yield told
