"""Pieces of Markdown pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

GENERATED = "<!-- Made by `make reference` from the code, which is where to change it. -->"


def page(title: str, *parts: str) -> str:
    """A whole page from its parts, which are paragraphs, headings, tables or blocks."""
    return "\n\n".join([f"# {title}", GENERATED, *(part for part in parts if part)]) + "\n"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; columns in which no row says anything are left out, and so is a table without rows."""
    kept = [list(row) for row in rows]
    if not kept:
        return ""
    wanted = [at for at in range(len(heads)) if any(row[at] for row in kept)]
    lines = [heads, ["---"] * len(heads), *kept]
    return "\n".join("| " + " | ".join(cell(line[at]) for at in wanted) + " |" for line in lines)


def cell(text: str) -> str:
    """A text as it may stand in a table."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: str) -> str:
    """A text as it stands in code; nothing for an empty one."""
    return f"`{text}`" if text else ""


def block(text: str, language: str = "") -> str:
    """A fenced block."""
    return f"```{language}\n{text.rstrip()}\n```"
