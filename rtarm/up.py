"""`rtarm up`: an arm's processes until a signal, or until the control process is gone."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Awaitable, Callable

from rtarm.errors import ExitCode
from rtarm.launcher import Launcher, Plan
from rtarm.reporter import Reporter

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(Exception):
    """A signal asked for the end; `number` says which."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


async def run_launched(launcher: Launcher, work: Callable[[], Awaitable[None]]) -> None:
    """Do the work, which starts the launcher's processes, and end them in order whatever happens.

    The first SIGINT, SIGTERM or SIGHUP cancels the work; further ones do not disturb the end.

    Raises:
        Interrupted: a signal came.
        Refusal: what the launcher or the work says; also when the control process does not end in order.
    """
    loop = asyncio.get_running_loop()

    task = asyncio.ensure_future(work())
    received: list[int] = []

    def on_signal(number: int) -> None:
        received.append(number)
        if len(received) == 1:
            task.cancel()

    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, on_signal, number)
    try:
        await asyncio.wait((task,))
        if received:
            launcher.say_stopping(signal.Signals(received[0]).name)
    finally:
        await launcher.stop()
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)
            if received:  # the end has been asked for and is near: who asks again does not make it a violent one
                signal.signal(number, signal.SIG_IGN)
    if not task.cancelled():
        task.result()
    if received:
        raise Interrupted(received[0])


def up(plan: Plan, reporter: Reporter) -> ExitCode:
    """Run an arm until a signal asks for the end.

    Raises:
        Refusal: something did not start, or the control process ended by itself.
    """
    launcher = Launcher(plan, reporter)

    async def hold() -> None:
        await launcher.start()
        reporter.say("running; Ctrl-C stops the arm on its path and ends everything", style="bold")
        await launcher.watch()

    try:
        asyncio.run(run_launched(launcher, hold))
    except Interrupted:
        launcher.check_orderly_end()
        reporter.say("ended in order")
    return ExitCode.DONE
