"""The pages of the documentation, cut into what tests compare and run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from handbook.links import CODE, FENCE, HEADING, blanked, targets

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TABLE_RULE = re.compile(r"^\|[ \-:|]+\|$")


class Block(NamedTuple):
    """A fenced block."""

    info: str
    lines: list[str]
    line: int
    """Number of its first line in the page, from 1."""


class Section(NamedTuple):
    """What stands between one heading and the next; the first has level 0 and no title."""

    level: int
    title: str
    text: str
    line: int
    """Number of its first line in the page, from 1."""

    @property
    def blocks(self) -> list[Block]:
        """Its fenced blocks."""
        found = []
        for fence in FENCE.finditer(self.text):
            first, *lines, _ = fence.group().split("\n")
            start = self.line + self.text.count("\n", 0, fence.start())
            found.append(Block(first.strip().strip("`~"), lines, start + 1))
        return found

    @property
    def visible(self) -> str:
        """Its text without its fenced blocks."""
        return blanked(self.text, FENCE)

    @property
    def tables(self) -> list[list[list[str]]]:
        """Its tables, each a list of rows of cells; the rule below the heads is left out."""
        tables: list[list[list[str]]] = []
        inside = False
        for line in self.visible.splitlines():
            row = line.strip()
            if not row.startswith("|"):
                inside = False
                continue
            if not inside:
                tables.append([])
            inside = True
            if not TABLE_RULE.match(row):
                tables[-1].append(cells(row))
        return tables

    @property
    def targets(self) -> list[str]:
        """Where its links and pictures lead."""
        return targets(self.text)

    @property
    def code_words(self) -> set[str]:
        """What it has in backticks, in one line."""
        return code_words(self.visible)

    def items(self, mark: str) -> int:
        """How many items of lists begin with a mark, which is a regular expression."""
        return len(re.findall(rf"^ *{mark} ", self.visible, re.MULTILINE))


def cells(row: str) -> list[str]:
    """The cells of a row of a table; a bar inside code, or behind a backslash, is none between cells."""
    hidden = re.sub(r"\\\|", "  ", blanked(row, CODE))
    cuts = [at for at, mark in enumerate(hidden) if mark == "|"]
    return [row[begin + 1 : end].strip() for begin, end in pairwise(cuts)]


def code_words(text: str) -> set[str]:
    """What stands in backticks."""
    return {" ".join(found.group().strip("`").split()) for found in CODE.finditer(text)}


def sections(page: str) -> list[Section]:
    """A page from heading to heading."""
    heads = list(HEADING.finditer(blanked(page, FENCE)))
    starts = [0, *(head.start() for head in heads)]
    ends = [*starts[1:], len(page)]
    levels = [0, *(len(head.group(1)) for head in heads)]
    titles = ["", *(page[head.start(2) : head.end(2)] for head in heads)]
    return [
        Section(level, title, page[start:end], page.count("\n", 0, start) + 1)
        for level, title, start, end in zip(levels, titles, starts, ends, strict=True)
    ]


def all_pages() -> Iterator[Path]:
    """README, its Chinese twin, and every page below docs/."""
    yield from sorted(ROOT.glob("README*.md"))
    yield from (ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md"))
    yield from sorted(DOCS.rglob("*.md"))


def name_of(page: Path) -> str:
    """A page as people name it."""
    return page.relative_to(ROOT).as_posix()
