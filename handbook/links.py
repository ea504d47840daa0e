"""Links of Markdown pages: where they stand, where they lead, and the anchors that headings have."""

from __future__ import annotations

import re
from collections.abc import Callable

FENCE = re.compile(r"^( {0,3})(`{3,}|~{3,})[^\n]*\n.*?^\1\2[ \t]*$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
LINK = re.compile(r"(\]\()([^()\s]+(?:\([^()\s]*\)[^()\s]*)*)(\s+\"[^\"]*\")?(\))")
HEADING = re.compile(r"^(#{1,6}) +(.+?) *#*$", re.MULTILINE)
ANCHOR = re.compile(r"<a (?:id|name)=\"([^\"]+)\">")
IMAGE_OR_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
ELSEWHERE = re.compile(r"^[a-z][a-z0-9+.-]*:")


def blanked(page: str, pattern: re.Pattern[str]) -> str:
    """The page with blanks for what a pattern finds, so that offsets and lines stay."""
    return pattern.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), page)


def prose(page: str) -> str:
    """The page without its code, which has no links and no headings; offsets stay."""
    return blanked(blanked(page, FENCE), CODE)


def targets(page: str) -> list[str]:
    """Where its links and pictures lead, in order."""
    return [found.group(2) for found in LINK.finditer(prose(page))]


def leads_elsewhere(target: str) -> bool:
    """Whether a target is an address of its own (https://…)."""
    return ELSEWHERE.match(target) is not None


def with_targets(page: str, change: Callable[[str], str]) -> str:
    """The page with each link's target replaced by what `change` makes of it."""
    parts, end = [], 0
    for found in LINK.finditer(prose(page)):
        parts += [page[end : found.start(2)], change(found.group(2))]
        end = found.end(2)
    return "".join([*parts, page[end:]])


def slug(heading: str) -> str:
    """The anchor that GitHub gives to a heading; the site does the same (`mkdocs.yml`, toc)."""
    text = IMAGE_OR_LINK.sub(r"\1", heading).replace("`", "").replace("*", "")
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")


def headings(page: str) -> list[tuple[int, str]]:
    """Level and text of each heading, in order."""
    visible = blanked(page, FENCE)
    return [(len(found.group(1)), found.group(2)) for found in HEADING.finditer(visible)]


def anchors(page: str) -> set[str]:
    """Everything on the page that a link can lead to."""
    names: set[str] = set()
    for _, text in headings(page):
        name, number = slug(text), 0
        while (numbered := f"{name}-{number}" if number else name) in names:
            number += 1
        names.add(numbered)
    return names | set(ANCHOR.findall(prose(page)))
