"""`rtarm view`."""

from __future__ import annotations

from typing import Annotated

import typer

from rtarm.cli.frame import LanguageOption, NamedArm, RunningArm, sentences

view_app = typer.Typer()
"""The command, for `application` to add."""


@view_app.command()
def view(
    arm: RunningArm = None,
    named: NamedArm = None,
    host: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Address of this machine to serve at; other machines may then connect."),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, max=65535, help="Port; left out: 8460, or a free one if it is taken; 0: any."),
    ] = None,
    language: LanguageOption = "en",
) -> None:
    """Show a running arm in a browser, and move it from there, until Ctrl-C.

    Picture, plots, faults with what to do, buttons and sliders. Reads the arm's memory files only; what a button asks
    for goes the way of every other request, and a slider's motion is a goal like any other. The page opens at the
    address that is printed, with its token, and not without it.

    Example: [bold]rtarm view episode1[/bold]
    """
    with sentences(language=language):
        from rtarm.console.language import language_of
        from rtarm.view.start import view_arm

        view_arm(arm, host, port, language_of(language), typer.echo)
