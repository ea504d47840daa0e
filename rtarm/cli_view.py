"""`rtarm view`."""

from __future__ import annotations

from typing import Annotated

import typer

from rtarm.cli_frame import sentences

view_app = typer.Typer()
"""The command, for `rtarm.cli` to add."""


@view_app.command()
def view(
    arm: Annotated[
        str | None,
        typer.Argument(metavar="ARM", help="Name or file of a running arm; left out: the only one that runs."),
    ] = None,
    port: Annotated[int, typer.Option(metavar="N", help="Port of the page on 127.0.0.1.")] = 8460,
    language: Annotated[str, typer.Option(metavar="en|zh", help="Language of the page.")] = "en",
) -> None:
    """Show a running arm in a browser, and move it from there, until Ctrl-C.

    Picture, plots, faults with what to do, buttons and sliders. Reads the arm's memory files only; what a button asks
    for goes the way of every other request, and a slider's motion is a goal like any other.

    Example: [bold]rtarm view episode1[/bold]
    """
    with sentences():
        from rtarm.view.start import view_arm

        view_arm(arm, port, language, typer.echo)
