"""Signals amid the end of what was launched."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rtarm.console.interrupt import STOP_SIGNALS, Interrupted, signals_raise
from rtarm.launch.up import run_launched

ROOT = Path(__file__).resolve().parents[3]


class Ending:
    """In place of a launcher: ends in two steps, and sends itself a signal between them."""

    def __init__(self) -> None:
        self.done: list[str] = []

    async def stop(self) -> None:
        self.done.append("first step")
        os.kill(os.getpid(), signal.SIGINT)
        while "heard" not in self.done:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.01)
        self.done.append("last step")

    def say_stopping(self, why: str) -> None:
        self.done.append("heard")

    def stop_at_once(self) -> None:
        self.done.append("at once")


@pytest.mark.parametrize("fails", [False, True])
def test_a_first_signal_amid_the_end_does_not_leave_it_half_done(fails: bool) -> None:
    async def work() -> None:
        if fails:
            raise RuntimeError

    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    launcher = Ending()
    try:
        with pytest.raises(Interrupted):
            asyncio.run(run_launched(launcher, work))  # type: ignore[arg-type]
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert launcher.done == ["first step", "heard", "at once", "last step"]


@pytest.mark.parametrize(("hangup", "ends_by"), [(signal.SIG_DFL, "SIGHUP"), (signal.SIG_IGN, "SIGTERM")])
def test_what_nohup_began_outlives_its_terminal(hangup: signal.Handlers, ends_by: str) -> None:
    program = """
import asyncio, os, signal
from rtarm.console.interrupt import Interrupted, interruptible

async def work():
    os.kill(os.getpid(), signal.SIGHUP)
    await asyncio.sleep(0.05)
    os.kill(os.getpid(), signal.SIGTERM)
    await asyncio.sleep(60)

try:
    asyncio.run(interruptible(work()))
except Interrupted as by:
    print(by)
"""
    before = signal.signal(signal.SIGHUP, hangup)  # what is ignored stays so in a child
    try:
        ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert ended.stdout.split() == [ends_by]


def test_work_of_another_thread_is_done_though_no_signal_reaches_it() -> None:
    """As of the page's threads, from which goals are sent."""
    done: list[str] = []

    def work() -> None:
        with signals_raise():
            done.append("done")

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["done"] and signal.getsignal(signal.SIGTERM) is before
