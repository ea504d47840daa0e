"""Repeats in a story are folded: nothing else disappears, and the order stays."""

from __future__ import annotations

import re
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from rtarm.recording.folding import FEWEST, WITHIN_S, folded
from rtarm.recording.story import Line

SENTENCES = (
    "joint1 is 0.05 rad away.",
    "joint2 is 0.05 rad away.",
    "1 control cycle was missed after this (woken {} ms late).",
    "Mode: holding.",
    "Goal {} was announced.",
)
TIMES = re.compile(r"(\d+) times until (\d+): ")


def when(instant_ns: int) -> str:
    return str(instant_ns)


def stories() -> st.SearchStrategy[list[Line]]:
    """Lines in their order, often near each other."""
    gaps_ns = st.sampled_from((0, 1, 10_000_000, 300_000_000, 1_900_000_000, 2_100_000_000))
    line = st.tuples(gaps_ns, st.sampled_from(SENTENCES), st.integers(0, 99))

    def lines(drawn: list[tuple[int, str, int]]) -> list[Line]:
        now_ns, found = 1, []
        for later_ns, sentence, value in drawn:
            now_ns += later_ns
            found.append(Line(now_ns, sentence.format(value)))
        return found

    return st.lists(line, max_size=60).map(lines)


def kind_of(sentence: str) -> str:
    """The sentence of `SENTENCES` that a line was made of, folded or not."""
    sentence = TIMES.sub("", sentence)
    fits = [one for one in SENTENCES if re.fullmatch(re.escape(one).replace(r"\{\}", r"\d+(?: to \d+)?"), sentence)]
    (kind,) = fits
    return kind


@given(stories(), st.lists(st.integers(0, 59), max_size=2))
def test_nothing_but_repeats_disappears_and_the_order_is_kept(lines: list[Line], marked: list[int]) -> None:
    apart = [lines[at].monotonic_ns for at in marked if at < len(lines)]
    left = [(line.monotonic_ns, kind_of(line.sentence)) for line in lines]
    shown = folded(lines, apart, when)
    assert [line.monotonic_ns for line in shown] == sorted(line.monotonic_ns for line in shown)
    for line in shown:
        count, until_ns = map(int, found.groups()) if (found := TIMES.match(line.sentence)) else (1, line.monotonic_ns)
        repeats = [one for one in left if one[1] == kind_of(line.sentence) and line.monotonic_ns <= one[0]][:count]
        assert len(repeats) == count == 1 or count >= FEWEST
        assert (repeats[0][0], repeats[-1][0]) == (line.monotonic_ns, until_ns)
        assert all(later[0] - sooner[0] <= WITHIN_S * 1e9 for sooner, later in pairwise(repeats))
        assert not any(line.monotonic_ns < instant <= until_ns for instant in apart)
        for one in repeats:
            left.remove(one)
    assert left == []
    as_they_are = [line for line in lines if line.monotonic_ns in apart]
    assert [line for line in shown if line.monotonic_ns in apart] == as_they_are


@given(stories())
def test_what_does_not_repeat_stays_word_for_word(lines: list[Line]) -> None:
    alone = [line for line in lines if sum(kind_of(line.sentence) == kind_of(one.sentence) for one in lines) < FEWEST]
    shown = folded(lines, [], when)
    assert [line for line in shown if line in alone] == alone


def test_the_values_of_repeats_are_told_from_the_least_to_the_most() -> None:
    lines = [
        Line(at, f"1 control cycle was missed after this (woken {ms} ms late).")
        for at, ms in ((1, 9.1), (2, 83.0), (3, 10.0))
    ]
    (shown,) = folded(lines, [], when)
    assert shown.sentence == "3 times until 3: 1 control cycle was missed after this (woken 9.1 to 83.0 ms late)."


def test_a_name_with_a_number_is_no_value() -> None:
    lines = [Line(at, f"joint{at} is late.", joint=-1) for at in range(1, 7)]
    assert folded(lines, [], when) == lines
