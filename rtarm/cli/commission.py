"""The command that tests one drive at the bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rtarm.cli.frame import ArmArgument, overrides_given, sentences
from rtarm.console.errors import ExitCode

commission_app = typer.Typer()
"""The command, for `application` to add."""


@commission_app.command()
def commission(
    arm: ArmArgument,
    joint: Annotated[str, typer.Argument(metavar="JOINT", help="Joint whose drive is tested.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder to make for the report; left out: one here."),
    ] = None,
    interface: Annotated[
        str | None, typer.Option(help="How the bus is reached (slcan, seeedstudio, ch340-at, socketcan, python-can).")
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Device of the CAN adapter (/dev/ttyACM0) or CAN interface (can0).")
    ] = None,
) -> None:
    """Test one drive at the bench beside its maker's manual, and write a report that can be sent back.

    Each check is explained and asked for; some turn the motor, one has you clamp it, one has you switch its power off.
    What was found unlocks what depends on it, or withholds it. Refused while the arm runs. The exit code is 0 when
    nothing differs from the manual.

    Example: [bold]rtarm commission ./my_arm.yaml joint6[/bold]
    """
    with sentences():
        from rtarm.commissioning.run import commission as run
        from rtarm.console.person import Terminal

        overrides = overrides_given({"bus": {"interface": interface, "channel": channel}})
        agrees = run(arm, joint, output, overrides, Terminal())
        raise typer.Exit(int(ExitCode.DONE if agrees else ExitCode.UNHEALTHY))
