"""Commands to a running arm: each makes a request of its control process and says how it went."""

from __future__ import annotations

from typing import Annotated

import typer

from rtarm.cli_frame import RunningArm, sentences

orders = typer.Typer()
"""The commands, for `rtarm.cli` to add."""


@orders.command()
def stop(arm: RunningArm = None) -> None:
    """Stop a running arm on its path and wait until it stands; works without the ROS process.

    Example: [bold]rtarm stop[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.stop(resolve_arm(arm)))


@orders.command("clear-fault")
def clear_fault(arm: RunningArm = None) -> None:
    """Clear a latched fault, once its cause is removed, and bring the drives up again.

    Example: [bold]rtarm clear-fault episode1[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.clear_fault(resolve_arm(arm)))


@orders.command()
def hold(arm: RunningArm = None) -> None:
    """Pause the running goal: the arm stops on its path and holds; `rtarm resume` lets it go on.

    Example: [bold]rtarm hold[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.hold(resolve_arm(arm)))


@orders.command()
def resume(arm: RunningArm = None) -> None:
    """Let a paused goal go on.

    Example: [bold]rtarm resume[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.resume(resolve_arm(arm)))


@orders.command()
def enable(arm: RunningArm = None) -> None:
    """Enable the drives of a limp arm, which then holds where it stands.

    Example: [bold]rtarm enable[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.enable(resolve_arm(arm)))


@orders.command()
def disable(arm: RunningArm = None) -> None:
    """Let the drives of a standing arm go limp and take it out of service: it falls where gravity pulls it.

    Example: [bold]rtarm disable[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm
        from shm.words import Request

        typer.echo(requests.let_go(resolve_arm(arm), Request.DISABLE))


@orders.command()
def free(arm: RunningArm = None) -> None:
    """Let the drives of a standing arm go limp, to lead it by hand: hold it, it falls where gravity pulls it.

    Example: [bold]rtarm free[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm
        from shm.words import Request

        typer.echo(requests.let_go(resolve_arm(arm), Request.FREE))


NamedArm = Annotated[
    str | None, typer.Option("--arm", metavar="ARM", help="Name of the arm or its file; left out: the one that runs.")
]


@orders.command()
def home(
    joints: Annotated[
        list[str] | None, typer.Argument(metavar="[JOINT]…", help="Left out: those of homing.order in the arm file.")
    ] = None,
    arm: NamedArm = None,
) -> None:
    """Let joints find their homing stops, one after the other: [bold]the arm moves[/bold].

    Each drive runs at its own homing speed towards its stop until it meets it, by collision; nothing sees what is in
    its way. Ctrl-C ends the run. The joints that are not homed hold.

    Example: [bold]rtarm home joint2 joint3[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.home(resolve_arm(arm), joints or [], typer.echo))


@orders.command()
def reference(
    joints: Annotated[
        list[str],
        typer.Argument(metavar="JOINT[=DEGREES]…", help="With an angle: it stands there; without: where it reads."),
    ],
    arm: NamedArm = None,
) -> None:
    """Say where joints without a reference stand, if you know better; nothing moves. Look twice: goals believe it.

    Example: [bold]rtarm reference joint2 joint3=-12.5[/bold]
    """
    with sentences():
        from rtarm import requests
        from rtarm.status import resolve_arm

        typer.echo(requests.reference(resolve_arm(arm), requests.angles_said(joints)))
