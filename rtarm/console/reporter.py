"""What a command says while it works: lines, and on a terminal a moving sign that something is waited for."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console
from rich.text import Text

SOURCE_WIDTH = 7
"""Columns of the names in front of lines: sim, loop, front, demo."""


class LastingConsole(Console):
    """Standard output that may go away (a closed pipe or terminal) without taking the arm with it."""

    def on_broken_pipe(self) -> None:
        """Called by rich, whose own way is to end the process."""
        silence_stdout()


def silence_stdout() -> None:
    """Let everything more that is written to standard output vanish."""
    silence(sys.stdout)


def silence(stream: TextIO) -> None:
    """The same of a stream; what it has not written yet would fail again at the end, and change the exit code."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


class Reporter:
    """Lines on standard output, each led by the name of the process it is about.

    Attributes:
        console: where they go; something else that draws on it (a bar) may do so at the same time.
    """

    def __init__(self, console: Console) -> None:
        self.console = console

    def say(self, text: str, source: str = "rtarm", style: str = "") -> None:
        """One line; on something that is no terminal it is never wrapped or coloured."""
        line = Text(f"{source:<{SOURCE_WIDTH}}", style="dim")
        line.append(text, style=style)
        try:
            self.console.print(line, soft_wrap=True)
        except OSError:  # a terminal that was closed
            silence_stdout()

    @contextmanager
    def waiting(self, text: str, source: str = "rtarm") -> Iterator[None]:
        """Say what is waited for, with a spinner where there is a terminal."""
        if not self.console.is_terminal:
            self.say(f"{text} …", source)
            yield
            return
        with self.console.status(Text(f"{source:<{SOURCE_WIDTH}}{text} …")):
            yield
