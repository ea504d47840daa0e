"""Work that a signal ends in order."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

_NOHUP = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, *(() if _NOHUP else (signal.SIGHUP,)))
"""The last when its terminal is closed; nohup(1) lets it outlive that."""

T = TypeVar("T")


class Interrupted(Exception):
    """A signal asked for the end; the text is its name."""


@contextmanager
def signals_to(handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP (the terminal is gone) go to a handler meanwhile; in the main thread only."""
    before = {number: signal.signal(number, handler) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, handler_before)


@contextmanager
def undisturbed() -> Iterator[None]:
    """What has to be put in order at the end is not cut short by whoever asks for the end once more.

    Signals come to the main thread alone: in another one this changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with signals_to(signal.SIG_IGN):
        yield


@contextmanager
def signals_raise() -> Iterator[None]:
    """A stop signal raises Interrupted wherever the work just is.

    Signals come to the main thread alone: in another one this changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: FrameType | None) -> None:
        raise Interrupted(signal.Signals(number).name)

    with signals_to(end):
        yield


@contextmanager
def signals_noted() -> Iterator[Callable[[float], str]]:
    """A stop signal is noted, and disturbs nothing.

    What is yielded waits for so many seconds, or until one has come, and returns its name, else "".
    """
    noted: list[str] = []
    reader, writer = os.pipe()

    def note(number: int, _: FrameType | None) -> None:
        if not noted:
            os.write(writer, b"\0")
        noted.append(signal.Signals(number).name)

    def wait(seconds: float) -> str:
        select.select((reader,), (), (), max(seconds, 0.0))
        return noted[0] if noted else ""

    try:
        with signals_to(note):
            yield wait
    finally:
        os.close(reader)
        os.close(writer)


async def interruptible(
    work: Coroutine[Any, Any, T],
    heard: Callable[[str], None] = lambda _: None,
    heard_again: Callable[[], None] = lambda: None,
) -> T:
    """Do the work, which ends what it started when it is cancelled.

    The first SIGINT, SIGTERM or SIGHUP cancels it, after `heard` was called with the signal's name; further ones do
    not disturb its end, but for what `heard_again` makes of them.

    Raises:
        Interrupted: a signal came, and the work has ended.
    """
    import asyncio  # here, for the commands that need it not and are to be quick

    loop = asyncio.get_running_loop()
    task = asyncio.ensure_future(work)
    received: list[str] = []

    def on_signal(number: int) -> None:
        received.append(signal.Signals(number).name)
        if len(received) == 1:
            heard(received[0])
            task.cancel()
        else:
            heard_again()

    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, on_signal, number)
    try:
        await asyncio.wait((task,))
    finally:
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)
            if received:  # the end has been asked for and is near: who asks again does not make it a violent one
                signal.signal(number, signal.SIG_IGN)
    if received and (task.cancelled() or task.exception() is None):
        raise Interrupted(received[0])
    return task.result()
