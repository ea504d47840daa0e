"""What is wrong with a text that is no YAML, in plain words: PyYAML's own are those of its grammar."""

from __future__ import annotations

import re
from typing import NamedTuple

import yaml

from config.errors import ConfigError


class _Mistake(NamedTuple):
    """One that people make: how PyYAML speaks of it, where it is, and what to tell them."""

    words: str
    begins: bool
    """Whether it is where the thing begins that PyYAML read when it was lost, rather than where it was lost."""
    sentence: str
    """With {column}, both counted from 1, and {begun}, the line where that thing begins."""


_TABBED = re.compile(r" *\t")
_BARE = re.compile(r"\s*[^\s:#-][^:#]*")
"""A line that is neither field nor entry nor comment: what follows it goes on with its text, says YAML."""
_OPENS = re.compile(r"[^#]*:\s*(#.*)?")
"""A line behind which a group of fields begins, and no text that goes on."""
_FIELD_WITHIN_TEXT = _Mistake(
    "mapping values are not allowed",
    False,
    "the colon in column {column} stands where no field can begin: give each field a line of its own, indented as "
    "the fields around it, and put a text with a colon in quotes.",
)
_MISTAKES = (
    _FIELD_WITHIN_TEXT,
    _Mistake(r"character '\t'", False, "column {column} is a tab, and YAML takes spaces only: put a space there."),
    _Mistake(
        "that cannot start any token",
        False,
        "no value begins with the character in column {column}: put the value in quotes.",
    ),
    _Mistake(
        "sequence entries are not allowed",
        False,
        "the dash in column {column} stands where no list can begin: put each entry on a line of its own.",
    ),
    _Mistake(
        "could not find expected ':'",
        True,
        "what begins in column {column} is no field: write name: value, with a space behind the colon.",
    ),
    _Mistake(
        "expected <block end>",
        False,
        "what begins in column {column} does not go with the lines above it: indent it as the other entries of the "
        "list or group that begins on line {begun}, and close quotes and brackets.",
    ),
    _Mistake(
        "unknown escape character",
        False,
        "in double quotes the backslash before column {column} has a meaning of its own: use single quotes.",
    ),
    _Mistake("scanning a quoted scalar", True, "the quote in column {column} is not closed: add the other one."),
    _Mistake("expected ',' or ']'", True, "the [ in column {column} is not closed, or a comma is missing behind it."),
    _Mistake("expected ',' or '}'", True, "the {{ in column {column} is not closed, or a comma is missing behind it."),
    _Mistake("found another document", False, "another document begins, but a file is one arm: remove what follows."),
)


def syntax_error(error: yaml.MarkedYAMLError, text: str, file: str) -> ConfigError:
    """The complaint about a text that PyYAML does not read."""
    words = " ".join(f"{error.context or ''}: {error.problem}".split()).removeprefix(": ")
    found = next((mistake for mistake in _MISTAKES if mistake.words in words), None)
    lost, begun = error.problem_mark or error.context_mark, error.context_mark or error.problem_mark
    if lost is None or begun is None:
        return ConfigError(f"this is not valid YAML ({words}); correct the file.", file=file)
    mark = begun if found is not None and found.begins else lost
    bare = _bare_line(text.splitlines()[: mark.line])
    if _TABBED.match("".join(text.splitlines()[mark.line : mark.line + 1])):
        problem = "the line is indented with a tab, and YAML takes spaces only: put spaces in its place."
    elif found is _FIELD_WITHIN_TEXT and bare is not None:
        problem = f"{bare[1]!r} is no field: write name: value, with a space behind the colon."
        return ConfigError(problem, file=file, line=bare[0] + 1)
    elif found is not None:
        problem = found.sentence.format(column=mark.column + 1, begun=begun.line + 1)
    else:
        problem = f"this is not valid YAML ({words}, in column {mark.column + 1}); correct this line or the one above."
    return ConfigError(problem, file=file, line=mark.line + 1)


def _bare_line(above: list[str]) -> tuple[int, str] | None:
    """Number and text of the line before these end that is no field, unless it goes on with the text of one."""
    lines = [(number, line) for number, line in enumerate(above) if line.strip()]
    if not lines or _BARE.fullmatch(lines[-1][1]) is None:
        return None
    if len(lines) > 1 and _OPENS.fullmatch(lines[-2][1]) is None:
        return None
    return lines[-1][0], lines[-1][1].strip()
