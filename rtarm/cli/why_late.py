"""`rtarm why-late`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rtarm.cli.frame import AsJson, LanguageOption, NamedArm, RunningArm, draw, draw_json, sentences

why_late_app = typer.Typer()
"""The command, for `application` to add."""


@why_late_app.command("why-late")
def why_late(
    arm: RunningArm = None,
    named: NamedArm = None,
    seconds: Annotated[float, typer.Option("--seconds", metavar="SECONDS", help="How long to watch.")] = 60.0,
    bound_us: Annotated[
        float, typer.Option("--bound-us", metavar="US", help="What is late: by more than so many µs.")
    ] = 100.0,
    as_json: AsJson = False,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw the causes (.png, .svg or .pdf).")
    ] = None,
    language: LanguageOption = "en",
) -> None:
    """Watch a running arm, and tell why its cycles woke up late or took long.

    The time of each late cycle is divided by the kernel's own trace events: interrupts, other tasks, a late timer, a
    machine that stood still. That needs root; without, it says which counters rose. Ctrl-C ends it early.

    Example: [bold]rtarm why-late episode1 --seconds 60 --bound-us 200[/bold]
    """
    with sentences({} if as_json else None, language):
        from rtarm.console.language import language_of
        from rtarm.why_late.report import render
        from rtarm.why_late.run import why_late as run

        spoken = "en" if as_json else language_of(language)
        report = run(arm, seconds, bound_us, plot_file, spoken)
        if as_json:
            draw_json(report)
        else:
            draw(render(report, spoken))
