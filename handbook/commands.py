"""The page of the command line, from the commands themselves."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import typer

from handbook.markdown import block, code, page, table
from rtarm.cli.application import app
from rtarm.console.errors import MEANINGS, ExitCode

MARKUP = re.compile(r"\[/?bold\]")
INTRODUCTION = """\
Everything `rtarm` does, as `rtarm COMMAND --help` says it. What it says to people goes to standard output, refusals
and progress to standard error, and [exit codes](#exit-codes) are the same everywhere."""


class Command(NamedTuple):
    """A command and the words that call it."""

    words: tuple[str, ...]
    command: Any

    @property
    def name(self) -> str:
        """As it is typed, without what follows it."""
        return " ".join(self.words)


def build() -> str:
    """The page."""
    shown = [part for command in commands() for part in described(command)]
    codes = table(("code", "meaning"), ((str(code.value), MEANINGS[code]) for code in ExitCode))
    return page("Command line", INTRODUCTION, "## Exit codes", codes, *shown)


def commands() -> Iterator[Command]:
    """`rtarm` itself, then every command that does something, in the order of the help."""
    rtarm = Command(("rtarm",), typer.main.get_command(app))
    yield rtarm
    yield from below(rtarm)


def below(command: Command) -> Iterator[Command]:
    """A command, or those of a group."""
    inner = getattr(command.command, "commands", None)
    if inner is None:
        yield command
        return
    for name in inner:
        if not inner[name].hidden:
            yield from below(Command((*command.words, name), inner[name]))


def described(command: Command) -> list[str]:
    """Heading, usage, help, arguments, options and example of a command."""
    about, example = help_of(command.command)
    context = command.command.make_context(command.words[-1], [], resilient_parsing=True)
    return [
        f"## {command.name}",
        block(" ".join([command.name, *command.command.collect_usage_pieces(context)]), "text"),
        about,
        table(("argument", "meaning"), parameters(command.command, context, "argument")),
        table(("option", "meaning"), parameters(command.command, context, "option")),
        f"Example: {example}" if example else "",
    ]


def parameters(command: Any, context: Any, kind: str) -> Iterator[tuple[str, str]]:
    """How each argument or option is given, and what it means, with its default."""
    for param in command.params:
        if param.param_type_name == kind and (record := param.get_help_record(context)) is not None:
            given, meaning = record
            yield code(given if kind == "option" else param.metavar or param.name), MARKUP.sub("", meaning)


def help_of(command: Any) -> tuple[str, str]:
    """What a command does, and its example."""
    text = MARKUP.sub("`", command.help or "")
    about, _, example = text.partition("Example: ")
    return paragraphs(about), example.strip().split("\n")[0]


def paragraphs(text: str) -> str:
    """A text with a line a paragraph."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.replace("**", "").strip().split("\n\n"))
