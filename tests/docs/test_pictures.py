"""The pictures that are drawn from the code are what the code draws now."""

from __future__ import annotations

import difflib
import re

import numpy as np
import pytest
from pages import DOCS, all_pages

from handbook.links import targets
from handbook.pictures import PICTURES, motion
from handbook.pictures.states import ENDS
from shm.words import Outcome

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
SAME_PX = 0.25
"""Processors and libraries round differently, and coordinates are rounded to a tenth of a pixel."""


def changes(committed: str, drawn: str) -> str:
    """What is different in two pictures, "" for numbers that are nearly the same."""
    if NUMBER.sub("0", committed) == NUMBER.sub("0", drawn):
        numbers = [np.array(NUMBER.findall(text), float) for text in (committed, drawn)]
        if np.abs(numbers[0] - numbers[1]).max(initial=0.0) <= SAME_PX:
            return ""
    lines = difflib.unified_diff(committed.splitlines(), drawn.splitlines(), "committed", "drawn", n=0, lineterm="")
    return "\n".join(line[:200] for line in lines)


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_what_the_code_draws(name: str) -> None:
    found = changes((DOCS / "pictures" / name).read_text(encoding="utf-8"), PICTURES[name]())
    assert not found, f"run `make reference` and commit what it changes:\n{found}"


@pytest.mark.parametrize(
    ("committed", "drawn", "same"),
    [
        ('<text x="1.2">holding</text>', '<text x="1.3">holding</text>', True),
        ('<text x="1.2">holding</text>', '<text x="1.6">holding</text>', False),
        ('<text x="1.2">holding</text>', '<text x="1.2">stopping</text>', False),
        ('points="1,2 3,4"', 'points="1,2 3,4 5,6"', False),
    ],
)
def test_a_stale_picture_is_found(committed: str, drawn: str, same: bool) -> None:
    assert (changes(committed, drawn) == "") == same


@pytest.mark.parametrize("name", PICTURES)
def test_a_page_shows_the_picture(name: str) -> None:
    assert any(f"pictures/{name}" in target for page in all_pages() for target in targets(page.read_text("utf-8")))


def test_every_outcome_stands_in_the_life_of_a_goal() -> None:
    drawn = {outcome for outcomes in ENDS.values() for outcome in outcomes}
    assert drawn == set(Outcome) - {Outcome.NONE}


def test_drawn_setpoints_meet_the_points() -> None:
    points = [motion.point(time_s, 0, *row) for time_s, *row in motion.AHEAD]
    case = motion.played([""], points, 0, motion.ENDS_SHOWN_S)
    for curve, said in zip(case.curves[:2], case.points[:2], strict=True):
        at = np.searchsorted(curve.times_s, said.times_s - 1e-9)
        assert curve.values[at] == pytest.approx(said.values, abs=1e-6)
