"""`rtarm up`: an arm's processes until a signal, or until the control process is gone."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from rtarm.console.errors import ExitCode
from rtarm.console.interrupt import Interrupted, interruptible
from rtarm.console.reporter import Reporter
from rtarm.launch import service_manager
from rtarm.launch.launcher import Launcher
from rtarm.launch.plan import Plan
from rtarm.running.referencing import Reading, lacking, lacking_words, next_commands


async def run_launched(launcher: Launcher, work: Callable[[], Awaitable[None]]) -> None:
    """Do the work, which starts the launcher's processes, and end them in order whatever happens.

    Raises:
        Interrupted: a signal came.
        Refusal: what the launcher or the work says.
    """

    async def launched() -> None:
        try:
            await work()
        finally:
            ending = asyncio.ensure_future(launcher.stop())
            try:
                await asyncio.shield(ending)
            except asyncio.CancelledError:  # the first signal, amid an end that nobody has asked for
                launcher.stop_at_once()
                await ending
                raise

    await interruptible(launched(), launcher.say_stopping, launcher.stop_at_once)


def up(plan: Plan, reporter: Reporter) -> ExitCode:
    """Run an arm until a signal asks for the end.

    Raises:
        Refusal: something did not start, or the control process ended by itself.
    """
    launcher = Launcher(plan, reporter)
    left: list[Reading] = []

    async def hold() -> None:
        await launcher.start()
        reporter.say("running; Ctrl-C stops the arm on its path and ends everything", style="bold")
        # a homing run at the start gives references by itself, or tells why not
        if plan.arm.control.init_mode != 0 and (found := lacking(plan.arm.name)):
            reporter.say(f"{lacking_words(found)}, so no goal is taken: {next_commands(found)}", style="yellow")
        service_manager.tell(service_manager.READY)
        try:
            await launcher.watch()
        finally:
            left.extend(lacking(plan.arm.name))
            service_manager.tell(service_manager.STOPPING)

    try:
        asyncio.run(run_launched(launcher, hold))
    except Interrupted:
        launcher.check_orderly_end()
        if left:
            reporter.say(
                f"{lacking_words(left)} at the end: start again with `{plan.again}`, then {next_commands(left)}",
                style="yellow",
            )
        reporter.say("ended in order")
    return ExitCode.DONE
