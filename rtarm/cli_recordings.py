"""Commands about recordings: made, told, drawn, played back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rtarm.cli_frame import draw, sentences

recordings_app = typer.Typer()
"""The commands, for `rtarm.cli` to add."""

Recorded = Annotated[
    Path | None, typer.Argument(metavar="FILE", help="A recording; left out: the newest one there is.")
]


@recordings_app.command()
def record(
    arm: Annotated[
        str | None, typer.Argument(metavar="ARM", help="Name or file of an arm; left out: the only one there is.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Left out: a new one among the recordings.")
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Go on after the last half minute, until Ctrl-C.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option("--for", metavar="SECONDS", help="From now on for so long; with -f, the half minute before too."),
    ] = None,
) -> None:
    """Write the last half minute of an arm to a file: every cycle, every CAN frame, everything that happened.

    With -f it goes on until Ctrl-C, with --for for a time. Works without the ROS process, and with what a control
    process that died has left behind. `rtarm up` does the same by itself after each latched fault. The file is an
    MCAP, which Foxglove and PlotJuggler open too.

    Example: [bold]rtarm record episode1 -o strange_noise.mcap[/bold], [bold]rtarm record --for 60[/bold]
    """
    with sentences():
        import os

        from rtarm.recording import shown
        from rtarm.recording.make import left_by, record_now

        if not follow and seconds is None:
            with shown.share("writing") as step:
                path = record_now(left_by(arm), output, step)
            typer.echo(str(path))
            return
        from rtarm.recording.follow import follow as go_on
        from rtarm.status import resolve_arm
        from shm import files

        memory = files.open_state(resolve_arm(arm))
        os.nice(MOST_NICE)
        with shown.growing(seconds) as told:
            path, how = go_on(memory, output, past=follow, span_s=seconds, step=told)
        typer.echo(f"recorded: {how}", err=True)
        typer.echo(str(path))


MOST_NICE = 19
"""The arm comes first."""


@recordings_app.command()
def explain(file: Recorded = None) -> None:
    """Tell what a recording shows: what happened first, which limit, which joint, and what the arm did then.

    Example: [bold]rtarm explain[/bold]
    """
    with sentences():
        from rtarm.recording import shown
        from rtarm.recording.explain import explanation
        from rtarm.recording.folder import newest

        with shown.share("reading") as step:
            story = explanation(file or newest(), step)
        draw(story)


@recordings_app.command()
def plot(
    file: Recorded = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=".png, .svg or .pdf; left out: FILE.png beside it."),
    ] = None,
) -> None:
    """Draw a recording: positions commanded and measured, errors, lateness, with modes and faults marked.

    Example: [bold]rtarm plot strange_noise.mcap -o noise.svg[/bold]
    """
    with sentences():
        from rtarm.recording import shown
        from rtarm.recording.folder import newest
        from rtarm.recording.plot import plot as draw_picture

        with shown.share("drawing") as step:
            picture = draw_picture(file or newest(), output, step)
        typer.echo(str(picture))
