"""What every command of the command line shares: the application, how an arm is named, how a refusal ends."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from rtarm.cli import completion
from rtarm.console.errors import ExitCode, exit_code_table, foreseen

if TYPE_CHECKING:
    from rich.console import RenderableType

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""The class of all wrong usages, whose module differs between the versions of typer."""


class Commands(TyperGroup):
    """The commands, with the exit code of our table for wrong usage."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for command in self.commands.values():
            command.help = _flowing(command.help or "")

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        with _usage_is_refused():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        with _usage_is_refused():
            return super().invoke(ctx)


def _flowing(text: str) -> str:
    """A text without the line ends of its docstring, which typer would keep from the second paragraph on."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


@contextmanager
def _usage_is_refused() -> Iterator[None]:
    try:
        yield
    except UsageError as error:
        error.exit_code = int(ExitCode.REFUSED)  # type: ignore[attr-defined]
        raise


app = typer.Typer(
    cls=Commands,
    name="rtarm",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Connects MoveIt 2 to robot arms with CAN servo drives.\n\nExample: [bold]rtarm demo[/bold] plays a "
    "recorded MoveIt goal on a simulated arm; [bold]rtarm up episode1 --sim[/bold] keeps one running.",
    epilog="Exit codes:\n\n" + exit_code_table(),
)
config_app = typer.Typer(
    no_args_is_help=True,
    cls=Commands,
    help="Arm files.\n\nExample: [bold]rtarm config check ./my_arm.yaml[/bold]",
)
app.add_typer(config_app, name="config")

ArmArgument = Annotated[
    str,
    typer.Argument(
        metavar="ARM",
        help="Name of an arm, or path of an arm file (./my_arm.yaml).",
        autocompletion=completion.known_arms,
    ),
]


def one_arm(context: typer.Context, argument: str | None) -> str | None:
    """The arm that a command is about, whose argument and option both name it; refused where they name two."""
    option: str | None = context.params.get("named")
    if argument is not None and option is not None and argument != option:
        raise typer.BadParameter(f"it is {argument}, but --arm is {option}: give one of the two.")
    return argument if option is None else option


RUNNING_ARM_HELP = "Name or file of a running arm; left out: the only one that runs."
RunningArm = Annotated[
    str | None,
    typer.Argument(metavar="ARM", help=RUNNING_ARM_HELP, callback=one_arm, autocompletion=completion.running_arms),
]
"""Of a command that takes nothing else; such a one has a `NamedArm` called `named` besides, with the same meaning."""
NamedArm = Annotated[
    str | None,
    typer.Option(
        "--arm",
        "-a",
        metavar="ARM",
        help=RUNNING_ARM_HELP,
        is_eager=True,  # `one_arm` looks for it
        autocompletion=completion.running_arms,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
LanguageOption = Annotated[
    str, typer.Option("--language", metavar="en|zh", help="Language of what is said; JSON stays English.")
]


def overrides_given(options: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The options that were given, as overrides of the arm file."""
    given = {
        section: {key: value for key, value in fields.items() if value is not None}
        for section, fields in options.items()
    }
    return {section: fields for section, fields in given.items() if fields}


def again() -> str:
    """The command line that was given, for a person to give again."""
    return shlex.join(["rtarm", *sys.argv[1:]])


def draw(what: RenderableType) -> None:
    from rich.console import Console

    Console(highlight=False, emoji=False).print(what)


def draw_json(what: Mapping[str, Any]) -> None:
    """One JSON object; of numbers that are none a script makes nothing, so there must be no such."""
    typer.echo(json.dumps(what, indent=2, allow_nan=False))


@contextmanager
def sentences(as_json: Mapping[str, Any] | None = None, language: str = "en") -> Iterator[None]:
    """Foreseeable errors end as their sentence on standard error and an exit code, never as a traceback.

    With `as_json` they end as that object with the sentences as its `problems`, on standard output, since a script
    that asked for JSON gets JSON, in English. `language` is what was given for it, whether or not there is such a one.
    """
    try:
        yield
    except Exception as error:
        told = foreseen(error, "zh" if language == "zh" and as_json is None else "en")
        if told is None:
            raise
        sentence, code = told
        if as_json is not None:
            draw_json({**as_json, "problems": sentence.splitlines()})
        elif sentence:
            try:
                typer.echo(sentence, err=True)
            except OSError:  # a terminal that was closed: the exit code still tells
                from rtarm.console.reporter import silence

                silence(sys.stderr)
        raise typer.Exit(int(code)) from None
