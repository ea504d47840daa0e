"""The commands that the documentation shows."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import NamedTuple

from pages import ROOT, Block, all_pages, name_of, sections

PROGRAMS = frozenset(
    """apt-get candump cansend cat cd chrt colcon cp docker export git ip journalctl ln ls make mkdir pip python python3
    pytest ros2 rtarm sed source sudo systemctl udevadm unzip""".split()  # noqa: SIM905 (a list of so many is no list)
)
"""A line of a block whose first word is one of these is a command."""
HERE = re.compile(r"^(\./)?\.venv/bin/")
SHELL = {"", "bash", "console", "sh", "shell"}
"""Info strings of blocks in which commands stand without a prompt."""
COMMENT = re.compile(r"(?:^|\s+)#\s.*$")
NAMED = re.compile(r"^rtarm (--)?[a-z][a-z-]*( |$)")
SETTING = re.compile(r"^[A-Z_]+=\S*$")


class Shown(NamedTuple):
    """A command on a page."""

    text: str
    """As it is typed; without prompt, comment, and where .venv/bin is not on the path."""
    place: str

    @property
    def words(self) -> list[str]:
        """As a shell splits it; settings of variables in front are left out."""
        words = shlex.split(self.text)
        while words and SETTING.match(words[0]):
            words.pop(0)
        return words


def commands_of(block: Block) -> Iterator[tuple[int, str]]:
    """Number of the line and text of each command in a block.

    Where a block has prompts, only what stands behind one is typed; the rest is what was answered. A line that ends
    in a backslash goes on.
    """
    prompts = any(line.startswith("$ ") for line in block.lines)
    if not prompts and block.info not in SHELL:
        return
    numbered = iter(enumerate(block.lines, block.line))
    for number, first in numbered:
        line = first
        while line.endswith("\\"):
            line = line[:-1] + next(numbered)[1].strip()
        typed = line.removeprefix("$ ") if prompts else line.strip()
        if prompts and not line.startswith("$ "):
            continue
        for part in COMMENT.sub("", typed).split(" && "):
            text = " ".join(HERE.sub("", word) for word in part.strip().split(" "))
            if prompts or is_command(text):
                yield number, text


def is_command(text: str) -> bool:
    """Whether a line without a prompt is one; the launcher's own lines have two blanks behind the first word."""
    words = [word for word in text.split(" ") if not SETTING.match(word)]
    return len(words) > 0 and words[0] in PROGRAMS and (len(words) == 1 or words[1] != "")


def shown_commands() -> dict[str, Shown]:
    """Every command of the documentation by its text, where it stands first."""
    shown: dict[str, Shown] = {}
    for page in all_pages():
        for section in sections(page.read_text(encoding="utf-8")):
            for block in section.blocks:
                for number, text in commands_of(block):
                    shown.setdefault(text, Shown(text, f"{name_of(page)}:{number}"))
    return shown


def named_commands() -> dict[str, Shown]:
    """Every `rtarm …` that stands in a sentence or a table, by its text."""
    named: dict[str, Shown] = {}
    for page in all_pages():
        for section in sections(page.read_text(encoding="utf-8")):
            for word in sorted(section.code_words):
                if NAMED.match(HERE.sub("", word)):
                    named.setdefault(word, Shown(HERE.sub("", word), f"{name_of(page)}:{section.line}"))
    return named


def shown_file(page: str, word: str) -> str:
    """The text of the block of a page that has a word, for files that the reader is to write."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (found,) = ["\n".join(b.lines) for part in sections(text) for b in part.blocks if word in "\n".join(b.lines)]
    return found + "\n"
