"""The page of faults, and of every other sentence that says why the arm does not do as it is told."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

from handbook.markdown import code, page, table
from sentences import english
from sentences.meaning import Meaning
from shm.words import Fault

INTRODUCTION = """\
What `rtarm status`, the results of goals and `/diagnostics` say, and what to do. A latched fault stops the arm until
`rtarm clear-fault`, once its cause is removed; each has [a page of its own](#latched-faults). `…` stands for a value,
`JOINT` for a joint's name."""
TABLES: tuple[tuple[str, str, Mapping[Any, Meaning]], ...] = (
    (
        "Whose silence",
        "[STALE_READING](../faults/stale_reading.md), where not one drive alone is silent.",
        english.SILENCES,
    ),
    (
        "Outcomes of goals",
        "[How a goal ended](../faults/goals.md), the word `outcome` of a result.",
        english.OUTCOMES,
    ),
    (
        "Joints without a reference",
        "[Why a joint's count means no angle](../faults/unreferenced.md); goals are refused.",
        english.UNREFERENCED,
    ),
    ("Answers to requests", "What `rtarm hold`, `home`, `reference` … are answered.", english.ANSWERS),
    ("The gripper on the bus", "Why a gripper's drive does not do as it is told.", english.GRIP_TROUBLES),
    ("The bus", "What the CAN controller thinks of its bus (SocketCAN).", english.BUS_STATES),
)
HEADS = ("code", "name", "sentence", "reason", "remedy")


def build() -> str:
    """The page."""
    faults = [
        (number, linked(fault, name), *rest)
        for fault in Fault
        if fault is not Fault.NONE
        for number, name, *rest in [row(fault, english.FAULTS[fault])]
    ]
    parts = ["## Latched faults", table(HEADS, faults)]
    for title, about, meanings in TABLES:
        parts += [f"## {title}", about, table(HEADS, (row(key, meaning) for key, meaning in meanings.items()))]
    return page("Faults", INTRODUCTION, *parts)


def linked(fault: Fault, name: str) -> str:
    """A fault's name, leading to its page."""
    return f"[{name}](../faults/{fault.name.lower()}.md)"


def row(key: IntEnum, meaning: Meaning) -> tuple[str, ...]:
    """One row: its number, its name, what is said, why it exists, the ways out."""
    return (str(key.value), code(key.name), with_blanks(meaning.sentence), meaning.reason, meaning.remedy)


def with_blanks(sentence: str) -> str:
    """A sentence without its values."""
    return re.sub(r"\{[^}]*\}", "…", sentence.replace("{joint}", "JOINT"))
