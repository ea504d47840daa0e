"""Sentences broken into the lines of a terminal; Chinese has few blanks, so it breaks between characters."""

from __future__ import annotations

import re
from textwrap import wrap

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.text import Text

_PIECES = re.compile(r"\s+|[（“]*(?:[^\s\u2e80-\uffef]+|[\u2e80-\uffef])[，。：；、）”]*")
"""What is not broken within: a word of Latin letters, or a character of Chinese, each with its punctuation."""


def wrapped(words: str, width: int) -> list[str]:
    """Lines of at most so many columns, of which a Chinese character takes two."""
    if not is_wide(words):
        return wrap(words, width)
    return [line.plain for line in _broken(Text(words), width)]


def is_wide(words: str) -> bool:
    """Whether there are characters that take two columns."""
    return cell_len(words) > len(words)


class Sentence:
    """A sentence as rich prints it, in however many lines it needs; rich alone cuts Chinese off in a table."""

    def __init__(self, text: Text) -> None:
        self._text = text

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if is_wide(self._text.plain):
            yield from _broken(self._text, options.max_width)
        else:
            yield self._text

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        if is_wide(self._text.plain):
            return Measurement(1, cell_len(self._text.plain))
        return Measurement.get(console, options, self._text)


def _broken(text: Text, width: int) -> list[Text]:
    breaks, at, used = [], 0, 0
    for piece in _PIECES.findall(text.plain):
        if used and used + cell_len(piece.rstrip()) > width and not piece.isspace():
            breaks.append(at)
            used = 0
        at, used = at + len(piece), used + cell_len(piece)
    lines = list(text.divide(breaks))
    for line in lines:
        line.rstrip()
        line.overflow = "fold"
    return lines
