"""`rtarm top` in a terminal: drawn five times a second until q, Ctrl-C or a signal, which give the terminal back."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from enum import Enum
from typing import Protocol

from rich.console import Console
from rich.live import Live

from rtarm.console.errors import Refusal
from rtarm.console.language import said
from rtarm.console.niceness import nice_thread
from rtarm.console.reporter import silence_stdout
from rtarm.top.picture import Picture
from rtarm.top.watch import Look, Watch, Why
from sentences.meaning import Language

REFRESH_S = 0.2
ENDING_KEYS = b"qQ\x03\x04"
"""q, and Ctrl-C and Ctrl-D where the terminal passes them on as characters."""
ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Wish(Enum):
    """What the person or the system asks for."""

    END = "end"
    SUSPEND = "suspend"


class TerminalGone(Exception):
    """There is nothing to draw on any more."""


class Watched(Protocol):
    """What can be looked at again and again."""

    def look(self) -> Look:
        """What there is to be seen now."""

    def close(self) -> None:
        """Nobody will look any more."""


def run(arm: str, language: Language = "en", why: Callable[[], Why] | None = None) -> None:
    """Show the arm until somebody ends it, with what `why` says of its late cycles.

    Raises:
        Refusal: there is no terminal.
        SharedMemoryError: the arm is not running, or its files are not what they should be.
    """
    no_terminal = said(
        language, "`rtarm top` draws on a terminal, and this is not one: use `rtarm status --json` for scripts."
    )
    show(lambda: Watch(arm, language, why), no_terminal)


def show(watched: Callable[[], Watched], no_terminal: str) -> None:
    """Show what `watched` makes until somebody ends it.

    Raises:
        Refusal: there is no terminal, with the sentence `no_terminal`.
    """
    console = Console(highlight=False, emoji=False)
    drawable = console.is_terminal and not console.is_dumb_terminal
    if not (drawable and sys.stdin.isatty() and sys.stdout.isatty()):
        raise Refusal(no_terminal)
    watch = watched()
    try:
        with nice_thread() as painter:
            asyncio.run(_show(watch, console, painter))
    finally:
        watch.close()


async def _show(watch: Watched, console: Console, painter: Executor) -> None:
    loop = asyncio.get_running_loop()
    wishes: asyncio.Queue[Wish] = asyncio.Queue()
    for number in ENDING_SIGNALS:
        loop.add_signal_handler(number, wishes.put_nowait, Wish.END)
    loop.add_signal_handler(signal.SIGTSTP, wishes.put_nowait, Wish.SUSPEND)
    try:
        while True:
            with _screen(console) as live:
                loop.add_reader(sys.stdin.fileno(), _take_keys, wishes)
                wish = await _draw(watch, live, wishes, painter)
                loop.remove_reader(sys.stdin.fileno())
            if wish is Wish.END:
                return
            os.kill(os.getpid(), signal.SIGSTOP)  # Ctrl-Z: the shell takes over until `fg`
    except TerminalGone:
        pass
    finally:
        for number in (*ENDING_SIGNALS, signal.SIGTSTP):
            loop.remove_signal_handler(number)


async def _draw(watch: Watched, live: Live, wishes: asyncio.Queue[Wish], painter: Executor) -> Wish:
    while True:
        await asyncio.get_running_loop().run_in_executor(painter, _paint, watch, live)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(REFRESH_S):
                return await wishes.get()


def _paint(watch: Watched, live: Live) -> None:
    picture = Picture(watch.look())
    try:
        live.update(picture, refresh=True)
    except OSError:
        raise TerminalGone from None


def _take_keys(wishes: asyncio.Queue[Wish]) -> None:
    try:
        keys = os.read(sys.stdin.fileno(), 64)
    except OSError:
        keys = b""
    if not keys or any(key in ENDING_KEYS for key in keys):  # nothing to read: the terminal was closed
        wishes.put_nowait(Wish.END)


@contextmanager
def _screen(console: Console) -> Iterator[Live]:
    """The terminal's other screen, with keys that come at once and unseen; everything is undone at the end."""
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    live = Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
    try:
        tty.setcbreak(keyboard, termios.TCSANOW)
        live.start()
        yield live
    finally:
        try:
            live.stop()
        except OSError:  # a terminal that was closed
            silence_stdout()
        with contextlib.suppress(termios.error):
            termios.tcsetattr(keyboard, termios.TCSANOW, before)
