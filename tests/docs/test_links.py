"""What a page leads to is there, on GitHub: files by their path, headings by their anchor."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pages import ROOT, all_pages, name_of

from handbook.links import anchors, leads_elsewhere, targets


def broken(page: Path, root: Path = ROOT) -> list[str]:
    """The links of a page that lead nowhere."""
    found = []
    for target in targets(page.read_text(encoding="utf-8")):
        if leads_elsewhere(target):
            continue
        path, _, anchor = target.partition("#")
        there = Path(os.path.normpath(page.parent / path)) if path else page
        if not there.is_relative_to(root) or not there.exists():
            found.append(f"{target}: no such file")
        elif anchor and anchor not in anchors(there.read_text(encoding="utf-8")):
            found.append(f"{target}: no such heading")
    return found


@pytest.mark.parametrize("page", list(all_pages()), ids=name_of)
def test_every_link_leads_somewhere(page: Path) -> None:
    assert broken(page) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("# One thing\n[a](#one-thing) [b](docs/b.md#b) [c](https://example.org/x) `[d](nowhere.md)`\n", []),
        ("[a](nowhere.md)", ["nowhere.md: no such file"]),
        ("[a](docs/b.md#nowhere)", ["docs/b.md#nowhere: no such heading"]),
        ("[a](../outside.md)", ["../outside.md: no such file"]),
    ],
)
def test_a_link_that_leads_nowhere_is_found(text: str, found: list[str], tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "b.md").write_text("# B\n", encoding="utf-8")
    page = tmp_path / "a.md"
    page.write_text(text, encoding="utf-8")
    assert broken(page, tmp_path) == found
