"""Commands to a running arm: each makes a request of its control process and says how it went."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from rtarm.cli import completion
from rtarm.cli.frame import AsJson, NamedArm, RunningArm, draw, draw_json, sentences
from rtarm.console.errors import Refusal

orders = typer.Typer()
"""The commands, for `application` to add."""


def _not_done(arm: str | None, as_json: bool) -> dict[str, Any] | None:
    """What a refusal is in JSON, where that is asked for."""
    return {"arm": arm, "done": False} if as_json else None


def _done(arm: str, sentence: str, as_json: bool) -> None:
    if as_json:
        draw_json({"arm": arm, "done": True, "said": sentence})
    else:
        typer.echo(sentence)


@orders.command()
def stop(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Stop a running arm on its path and wait until it stands; works without the ROS process.

    The arm takes no goals and no streams before [bold]rtarm resume[/bold], whoever sends them again.

    Example: [bold]rtarm stop[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.stop(name), as_json)


@orders.command("clear-fault")
def clear_fault(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Clear a latched fault, once its cause is removed, and bring the drives up again.

    Example: [bold]rtarm clear-fault episode1[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.clear_fault(name), as_json)


@orders.command()
def hold(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Stop on the path and keep the goal; none begins before `rtarm resume`, which lets the kept one go on.

    Example: [bold]rtarm hold[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.hold(name), as_json)


@orders.command()
def resume(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Let a held goal go on, and an arm that was held or stopped take goals again.

    Example: [bold]rtarm resume[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.resume(name), as_json)


@orders.command()
def enable(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Enable the drives of a limp arm, which then holds where it stands.

    Example: [bold]rtarm enable[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.enable(name), as_json)


@orders.command()
def disable(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Let the drives of a standing arm go limp and take it out of service: it falls where gravity pulls it.

    Example: [bold]rtarm disable[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm
        from shm.words import Request

        name = resolve_arm(arm)
        _done(name, requests.let_go(name, Request.DISABLE), as_json)


@orders.command()
def free(arm: RunningArm = None, named: NamedArm = None, as_json: AsJson = False) -> None:
    """Let the drives of a standing arm go limp, to lead it by hand: hold it, it falls where gravity pulls it.

    Example: [bold]rtarm free[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm
        from shm.words import Request

        name = resolve_arm(arm)
        _done(name, requests.let_go(name, Request.FREE), as_json)


@orders.command()
def home(
    joints: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[JOINT]…",
            help="Left out: those of homing.order in the arm file.",
            autocompletion=completion.joints,
        ),
    ] = None,
    arm: NamedArm = None,
    as_json: AsJson = False,
) -> None:
    """Let joints find their homing stops, one after the other: [bold]the arm moves[/bold].

    Each drive runs at its own homing speed towards its stop until it meets it, by collision; nothing sees what is in
    its way. Ctrl-C ends the run. The joints that are not homed hold.

    Example: [bold]rtarm home joint2 joint3[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import requests
        from rtarm.running.status import resolve_arm

        name = resolve_arm(arm)
        _done(name, requests.home(name, joints or [], lambda line: typer.echo(line, err=as_json)), as_json)


@orders.command()
def reference(
    joints: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[JOINT[=DEGREES]]…",
            help="With an angle: it stands there; without: where it reads.",
            autocompletion=completion.joints,
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All joints without a reference, where they read: shown, then asked once.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --all: do not ask, somebody has looked.")] = False,
    arm: NamedArm = None,
    as_json: AsJson = False,
) -> None:
    """Say where joints without a reference stand, if you know better; nothing moves. Look twice: goals believe it.

    Example: [bold]rtarm reference joint2 joint3=-12.5[/bold], [bold]rtarm reference --all[/bold]
    """
    with sentences(_not_done(arm, as_json)):
        from rtarm.running import referencing
        from rtarm.running.status import resolve_arm

        _refuse_what_does_not_fit(joints or [], everything=everything, yes=yes, as_json=as_json)
        name = resolve_arm(arm)
        if joints:
            said = referencing.reference(name, referencing.angles_said(joints))
        else:
            said = _take_all(name, yes=yes, as_json=as_json)
        _done(name, said, as_json)


def _refuse_what_does_not_fit(joints: list[str], *, everything: bool, yes: bool, as_json: bool) -> None:
    """Raise Refusal for what means nothing together."""
    if everything == bool(joints):
        raise Refusal("Name the joints (`rtarm reference joint2`), or give --all instead: one of the two.")
    if yes and not everything:
        raise Refusal("--yes answers what --all asks: give --all too, or leave it out.")
    if everything and as_json and not yes:
        raise Refusal("--json asks nobody: look where the arm stands, then give --yes too.")


def _take_all(arm: str, *, yes: bool, as_json: bool) -> str:
    """Show what all joints without a reference read, ask, and take it."""
    from rtarm.console.person import Terminal, require_yes
    from rtarm.running import referencing
    from rtarm.running.status_tables import readings_table

    shown = referencing.readings(arm)
    if shown and not as_json:
        draw(readings_table(shown))
    question = referencing.question(shown)
    if question and not yes:
        require_yes(Terminal(), question)
    return referencing.take(arm, shown)
