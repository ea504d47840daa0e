"""Commands about recordings: made, told, drawn, played back."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rtarm.cli import completion
from rtarm.cli.frame import AsJson, LanguageOption, NamedArm, RunningArm, draw, draw_json, sentences
from rtarm.console.errors import Refusal

if TYPE_CHECKING:
    from sentences.meaning import Language

recordings_app = typer.Typer()
"""The commands, for `application` to add."""

Recorded = Annotated[
    str | None,
    typer.Argument(
        metavar="FILE",
        help="A recording, or an arm's name for its newest; left out: the newest one there is.",
        autocompletion=completion.recordings,
    ),
]


@recordings_app.command()
def record(
    arm: RunningArm = None,
    named: NamedArm = None,
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
        from rtarm.recording import shown
        from rtarm.recording.make import left_by, record_now

        if not follow and seconds is None:
            with shown.share("writing") as step:
                path = record_now(left_by(arm), output, step)
            typer.echo(str(path))
            return
        from rtarm.recording.follow import follow as go_on
        from rtarm.running.status import open_running, resolve_arm

        memory = open_running(resolve_arm(arm))
        with shown.growing(seconds) as told:
            path, how = go_on(memory, output, past=follow, span_s=seconds, step=told)
        typer.echo(f"recorded: {how}", err=True)
        typer.echo(str(path))


@recordings_app.command()
def explain(file: Recorded = None, as_json: AsJson = False, language: LanguageOption = "en") -> None:
    """Tell what a recording shows: what happened first, which limit, which joint, and what the arm did then.

    Example: [bold]rtarm explain[/bold]
    """
    with sentences({} if as_json else None):
        from rtarm.console.language import language_of
        from rtarm.recording import shown
        from rtarm.recording.explain import explanation, plain

        spoken = "en" if as_json else language_of(language)
        path = _chosen(file, spoken)
        with shown.share("reading") as step:
            told = explanation(path, step, spoken)
        if as_json:
            draw_json({"file": str(path), **plain(told)})
        else:
            draw(told)


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
        from rtarm.recording.plot import plot as draw_picture

        path = _chosen(file)
        with shown.share("drawing") as step:
            picture = draw_picture(path, output, step)
        typer.echo(str(picture))


@recordings_app.command()
def replay(
    file: Recorded = None,
    speed: Annotated[float, typer.Option(metavar="FACTOR", help="1 is as it happened, 0.1 ten times slower.")] = 1.0,
    on_arm: Annotated[bool, typer.Option("--on-arm", help="Move the running arm as it was moved then.")] = False,
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm",
            "-a",
            metavar="ARM",
            help="With --on-arm the running arm, with --view the one to draw: name or file; left out: as recorded.",
            autocompletion=completion.running_arms,
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="With --on-arm: do not ask before the arm moves.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Play it in a page in the browser.")] = False,
    language: LanguageOption = "en",
) -> None:
    """Play a recording in the terminal as `rtarm top` would have shown it, until q or Ctrl-C.

    With --view it plays in a page in the browser. With --on-arm the running arm moves instead: slowly to where the
    recorded motion began, then along the path that was commanded then, up to a fault at most, as a goal of its ordinary
    action. Nothing sees what is in the arm's way; Ctrl-C stops it on its path.

    Example: [bold]rtarm replay --speed 0.2[/bold], [bold]rtarm replay FILE --on-arm --speed 0.5[/bold]
    """
    with sentences():
        from rtarm.console.language import language_of
        from rtarm.recording import shown
        from rtarm.recording.mcap_reader import read

        spoken = language_of(language)
        _refuse_what_does_not_fit(on_arm=on_arm, view=view, arm=arm, yes=yes)
        path = _chosen(file, spoken)
        with shown.share("reading") as step:
            recording = read(path, step).recording
        if on_arm:
            from rtarm.console.person import Terminal
            from rtarm.replay.on_arm import replay_on_arm

            replay_on_arm(recording, arm, speed=speed, yes=yes, person=Terminal())
        elif view:
            from rtarm.replay.on_page import show_on_page

            show_on_page(recording, arm, speed, spoken, typer.echo)
        else:
            from rtarm.recording.playback import play

            play(recording, speed, spoken)


def _chosen(given: str | None, language: Language = "en") -> Path:
    """The recording that is meant; standard error says which it is where its file was not named."""
    from rtarm.console.language import said
    from rtarm.recording import folder
    from rtarm.running.status_tables import duration_words

    path = folder.chosen(given)
    if path != Path(given or ""):
        age = duration_words(max(0.0, time.time() - path.stat().st_mtime))
        typer.echo(said(language, "{path}, written {age} ago", path=path, age=age), err=True)
        if folder.is_another_being_written():
            typer.echo(said(language, "Another recording is being written just now: ask again for it."), err=True)
    return path


def _refuse_what_does_not_fit(*, on_arm: bool, view: bool, arm: str | None, yes: bool) -> None:
    """Raise Refusal for options that would mean nothing together."""
    if on_arm and view:
        raise Refusal("--on-arm moves an arm and --view shows a recording: give one of them.")
    if arm is not None and not (on_arm or view):
        raise Refusal("--arm says which arm is moved or drawn: give --on-arm or --view too, or leave it out.")
    if yes and not on_arm:
        raise Refusal("--yes answers before an arm moves: give --on-arm too, or leave it out.")
