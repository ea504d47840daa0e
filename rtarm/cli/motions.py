"""Commands that move a running arm: to angles that are named, and along motions that are taught by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from rtarm.cli import completion
from rtarm.cli.frame import AsJson, NamedArm, draw, draw_json, sentences
from rtarm.console.errors import ExitCode, Refusal, needs

motions_app = typer.Typer()
"""The commands, for `application` to add."""

Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="Name of a motion, or path of its file (./wave.yaml).", autocompletion=completion.motions
    ),
]


@motions_app.command()
def move(
    targets: Annotated[
        list[str],
        typer.Argument(metavar="JOINT=DEGREES…", help="Where each joint is to go.", autocompletion=completion.joints),
    ],
    speed: Annotated[float, typer.Option(metavar="SHARE", help="Of the joints' limits, above 0 to 1.")] = 0.3,
    relative: Annotated[
        bool, typer.Option("--relative", help="From where the joints stand: joint1=-5 is 5° back.")
    ] = False,
    arm: NamedArm = None,
    as_json: AsJson = False,
) -> None:
    """Move joints together, from rest to rest, and wait for the end; the joints that are not named stay.

    Nothing sees what is in the arm's way. Ctrl-C stops the arm on its path.

    Example: [bold]rtarm move joint1=15 joint2=-5[/bold]
    """
    with sentences({"arm": arm, "done": False} if as_json else None):
        import math

        from rtarm.arm import connect
        from rtarm.console.interrupt import Interrupted, signals_raise
        from rtarm.running.referencing import angles_said

        angles = angles_said(targets)
        with connect(arm) as running:
            if without := [joint for joint, angle in angles.items() if angle is None]:
                joint = without[0] if without[0] in running.joints else running.joints[0]
                raise Refusal(f"{without[0]!r} gives no joint an angle: write JOINT=DEGREES, such as {joint}=15.")
            try:
                with signals_raise():
                    targets_rad = {joint: math.radians(angle or 0.0) for joint, angle in angles.items()}
                    said = running.move(targets_rad, speed=speed, relative=relative)
            except Interrupted as signalled:
                raise Refusal(f"Ended by {signalled}; arm {running.name} stands.", ExitCode.GOAL_FAILED) from None
            if as_json:
                draw_json({"arm": running.name, "done": True, "said": said})
            else:
                typer.echo(said)


@motions_app.command()
def jog(
    speed: Annotated[float, typer.Option(metavar="SHARE", help="Of the joints' limits, above 0 to 1.")] = 0.3,
    arm: NamedArm = None,
) -> None:
    """Move joints step by step with the keys of this terminal: one key, one step, which ends by itself.

    Nothing sees what is in the arm's way. q ends; Ctrl-C stops a step on its path and ends.

    Example: [bold]rtarm jog --speed 0.1[/bold]
    """
    with sentences():
        from rtarm.jog import jog as run

        run(arm, speed, typer.echo)


@motions_app.command()
def teach(
    name: Name,
    arm: NamedArm = None,
    tolerance: Annotated[
        float, typer.Option(metavar="DEG", help="How far the motion may be beside what you led.")
    ] = 0.5,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Record for so long; left out: until Enter or Ctrl-C.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask: somebody holds the arm.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a motion of that name.")] = False,
) -> None:
    """Record a motion that you lead by hand: the drives go limp, you lead the arm, the drives hold again.

    Hold the arm first: it falls where gravity pulls it. The motion is smoothed, and slower than your hand only where
    the arm's limits ask for it.

    Example: [bold]rtarm teach wave[/bold]
    """
    with sentences():
        needs("scipy")
        needs("toppra")

        from rtarm.console.person import Terminal
        from rtarm.running.status import resolve_arm
        from rtarm.teach.teach import Wish
        from rtarm.teach.teach import teach as run

        run(resolve_arm(arm), Wish(name, tolerance, seconds, yes, force), Terminal())


@motions_app.command()
def play(
    name: Name,
    arm: NamedArm = None,
    speed: Annotated[float, typer.Option(metavar="FACTOR", help="1 is as it was taught, 0.5 half as fast.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Again and again until Ctrl-C, which stops the arm.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the arm moves to where it begins.")] = False,
) -> None:
    """Play a motion that was taught: first slowly to where it begins, then as it was led.

    Nothing sees what is in the arm's way. Ctrl-C stops the arm on its path.

    Example: [bold]rtarm play wave --speed 0.5[/bold]
    """
    with sentences():
        needs("scipy")

        from rtarm.console.person import Terminal
        from rtarm.running.status import resolve_arm
        from rtarm.teach.play import play as run

        run(arm, resolve_arm(arm), name, speed=speed, loop=loop, yes=yes, person=Terminal())


@motions_app.command()
def motions(as_json: AsJson = False) -> None:
    """List the motions that are kept; one is removed by deleting its file.

    Example: [bold]rtarm motions --json[/bold]
    """
    with sentences({} if as_json else None):
        needs("scipy")

        from rtarm.teach.file import folder
        from rtarm.teach.listing import motions as found
        from rtarm.teach.listing import table

        rows = found()
        if as_json:
            draw_json({"folder": str(folder()), "motions": rows})
        else:
            draw(table(rows))
