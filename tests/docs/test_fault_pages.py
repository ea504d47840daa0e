"""docs/faults says of every fault, outcome and lost reference what the arm itself says of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sentences.english import FAULTS, OUTCOMES, UNREFERENCED
from sentences.meaning import Meaning
from shm.words import Fault, Outcome, Unreferenced

PAGES = Path(__file__).resolve().parents[2] / "docs" / "faults"
SECTIONS = (
    "## Why there is this fault",
    "## What the arm does",
    "## How to see it",
    "## Ways out",
    "## So that it does not come again",
    "## Related",
)
LATCHED = [fault for fault in Fault if fault != Fault.NONE]
ROWS: list[tuple[str, Outcome | Unreferenced, Meaning]] = [
    *(("goals.md", outcome, OUTCOMES[outcome]) for outcome in Outcome),
    *(("unreferenced.md", reason, UNREFERENCED[reason]) for reason in Unreferenced if reason),
]


def without_values(meaning: Meaning) -> str:
    """A sentence as the pages have it: its values left out."""
    return re.sub(r"\{[^}]*\}", "…", meaning.sentence)


def lines_of(page: str) -> list[str]:
    return (PAGES / page).read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("fault", LATCHED, ids=lambda fault: fault.name.lower())
def test_a_fault_has_its_page(fault: Fault) -> None:
    """With the sentence, the reason and the remedy word for word, in the order in which people look for them."""
    name, meaning = fault.name.lower(), FAULTS[fault]
    lines = lines_of(f"{name}.md")
    assert f"> {without_values(meaning)}" in lines
    assert lines[2].startswith(f"`{name}` is what `rtarm status --json` calls it.")
    assert [line for line in lines if line.startswith("## ")] == list(SECTIONS)
    why, out = (lines[lines.index(SECTIONS[at]) + 2] for at in (0, 3))
    assert why.startswith(meaning.reason)
    assert out == meaning.remedy


def test_the_table_has_every_fault_once() -> None:
    lines = lines_of("index.md")
    rows = [
        f"| [`{fault.name.lower()}`]({fault.name.lower()}.md) | {without_values(FAULTS[fault])} |" for fault in LATCHED
    ]
    assert sorted(line for line in lines if line.startswith("| [`")) == sorted(rows)


@pytest.mark.parametrize(("page", "word", "meaning"), ROWS, ids=lambda value: getattr(value, "name", ""))
def test_a_goals_end_and_a_lost_reference_have_their_row(
    page: str, word: Outcome | Unreferenced, meaning: Meaning
) -> None:
    row = f"| `{word.name}` | {without_values(meaning)} | {meaning.reason} | {meaning.remedy} |"
    assert len([line for line in lines_of(page) if line.startswith(row)]) == 1


def test_no_page_is_of_a_fault_that_is_none() -> None:
    pages = {page.stem for page in PAGES.glob("*.md") if not page.name.endswith(".zh.md")}
    assert pages == {"index", "goals", "unreferenced", "start", *(fault.name.lower() for fault in LATCHED)}
