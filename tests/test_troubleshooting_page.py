"""docs/guides/troubleshooting.md has every sentence with which the control process ends a goal or latches a fault."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from sentences.english import (
    BUS_STATES,
    FAULTS,
    GRIP_TROUBLES,
    NOBODY_ACKNOWLEDGES,
    OUTCOMES,
    SILENCES,
    STILL_QUEUED,
    UNREFERENCED,
)
from sentences.meaning import Meaning
from shm.words import BusState, Fault, GripTrouble, Outcome, Unreferenced

PAGE = Path(__file__).resolve().parents[1] / "docs" / "guides" / "troubleshooting.md"
TABLES = (
    (OUTCOMES, {Outcome.NONE, Outcome.SUCCEEDED}),
    (FAULTS, {Fault.NONE}),
    (SILENCES, set()),
    (BUS_STATES, {BusState.ACTIVE}),
    (UNREFERENCED, {Unreferenced.REFERENCED}),
    (GRIP_TROUBLES, {GripTrouble.NONE}),
)
"""The tables, and in each what is no trouble."""


def row(meaning: Meaning) -> str:
    """A sentence with its values left out, why it exists, and the ways out."""
    sentence = re.sub(r"\{[^}]*\}", "…", meaning.sentence)
    return f"| {sentence} | {meaning.reason} | {meaning.remedy} |"


def rows() -> Iterator[str]:
    yield from map(row, (NOBODY_ACKNOWLEDGES, STILL_QUEUED))
    for table, untroubled in TABLES:
        for key, meaning in table.items():
            if key not in untroubled:
                yield row(meaning)


def test_every_sentence_stands_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8").splitlines()
    missing = [wanted for wanted in rows() if wanted not in page]
    assert not missing, "\n".join(["These rows belong into docs/guides/troubleshooting.md:", *missing])
