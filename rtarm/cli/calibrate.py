"""The command that guides a person through an arm's joints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rtarm.cli.frame import ArmArgument, overrides_given, sentences

calibrate_app = typer.Typer()
"""The command, for `application` to add."""


@calibrate_app.command()
def calibrate(
    arm: ArmArgument,
    joint: Annotated[
        list[str] | None, typer.Option("--joint", metavar="NAME", help="Only this joint; repeatable.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Make this file instead of changing the arm file."),
    ] = None,
    interface: Annotated[
        str | None, typer.Option(help="How the bus is reached (slcan, seeedstudio, ch340-at, socketcan, python-can).")
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Device of the CAN adapter (/dev/ttyACM0) or CAN interface (can0).")
    ] = None,
) -> None:
    """Find direction, ratio and zero of each joint step by step, and write them into the arm file.

    One drive moves at a time, slowly, by small angles, after your y; Ctrl-C stops it and ends. Refused while the arm
    runs. A joint's values are written after you have seen what changes.

    Example: [bold]rtarm calibrate ./my_arm.yaml --joint joint1[/bold]
    """
    with sentences():
        from rtarm.calibrate.run import calibrate as run
        from rtarm.console.person import Terminal

        overrides = overrides_given({"bus": {"interface": interface, "channel": channel}})
        run(arm, joint or [], output, overrides, Terminal())
