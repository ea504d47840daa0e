"""The person before the arm: what they are told and asked, on a terminal."""

from __future__ import annotations

import math
import shutil
import sys
import termios
import textwrap
from typing import Protocol

from rtarm.console.errors import Refusal
from rtarm.console.reporter import silence_stdout

WIDEST = 110
"""Columns of running text."""


class Quit(Exception):
    """The person wants no more, or nobody is there any more; the text says which."""


class Person(Protocol):
    """Somebody who can be told something and asked for a line."""

    def tell(self, text: str) -> None:
        """Say something that needs no answer."""

    def answer(self, question: str) -> str:
        """The line that is given for an answer; raises Quit."""


class Terminal:
    """The person at standard input and output."""

    def tell(self, text: str) -> None:
        try:
            print(_wrapped(text), flush=True)
        except OSError:  # of a terminal that is gone: the next question ends it
            silence_stdout()

    def answer(self, question: str) -> str:
        if sys.stdin is None or not sys.stdin.isatty():  # what comes through a pipe was not said in sight of the arm
            raise Quit("answers are taken from a terminal alone, and the standard input is none")
        try:
            termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before a question is no answer to it
            print(f"{_wrapped(question)} ", end="", flush=True)
            typed = sys.stdin.buffer.readline()
        except (OSError, termios.error):  # of a terminal that is gone
            typed = b""
        if not typed.endswith(b"\n"):  # a line that was not ended is no answer either
            self.tell("")
            raise Quit("the input ended")
        line = typed.decode(errors="replace").strip()
        if line.lower() in ("q", "quit"):
            raise Quit("you ended it")
        return line


def _wrapped(text: str) -> str:
    width = min(shutil.get_terminal_size().columns, WIDEST)
    return "\n".join(
        textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False) if len(line) > width else line
        for line in text.split("\n")
    )


def agrees(person: Person, question: str) -> bool:
    """Whether the answer is y; anything else is no."""
    return person.answer(f"{question} [y/N, q ends]").lower() in ("y", "yes")


def require_yes(person: Person, question: str) -> None:
    """Let a person agree who sees the arm; raises Refusal where nobody does."""
    try:
        agreed = agrees(person, question)
    except Quit as ended:
        raise Refusal(f"Nothing was done ({ended}): say y, or give --yes in a script.") from None
    if not agreed:
        raise Refusal("Nothing was done; the arm stands where it stood.")


def chosen(person: Person, question: str, options: dict[str, str]) -> str:
    """One of the options by its letter, or an empty answer for none; asked again until it is one."""
    shown = ", ".join(f"{letter}: {meaning}" for letter, meaning in options.items())
    while True:
        answer = person.answer(f"{question} [{shown}; Enter: neither, q ends]").lower()
        if answer == "" or answer in options:
            return answer
        person.tell(f"{answer!r} is none of {', '.join(options)}.")


def number(person: Person, question: str) -> float | None:
    """A finite number, None for an empty answer; asked again until it is one."""
    while True:
        answer = person.answer(f"{question} [a number; Enter: none, q ends]")
        if not answer:
            return None
        value = as_number(answer)
        if math.isfinite(value):
            return value
        person.tell(f"{answer!r} is no number.")


def as_number(answer: str) -> float:
    """What a person typed for a number, with a point or a comma; NaN if it is none."""
    try:
        return math.nan if "_" in answer else float(answer.removesuffix("°").replace(",", "."))
    except ValueError:
        return math.nan
