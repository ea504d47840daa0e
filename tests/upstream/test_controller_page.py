"""docs/explanation/controller.md and the tests beside this file say the same of every case."""

import re
from collections.abc import Iterator
from pathlib import Path

from upstream_cases import CASES, VERDICTS, in_order, marks

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "controller.md"
ROW = re.compile(r"\| (?P<cases>A?\d[^|]*) \|[^|]+\|[^|]+\| \*\*(?P<verdict>\w+)\*\*(: (?P<why>[^|]+))? \|")


def cases_of(cell: str) -> Iterator[str]:
    """`28, 29`, `25–27` and `A1` as single cases."""
    for part in cell.split(", "):
        first, _, last = part.partition("–")
        yield from map(str, range(int(first), int(last) + 1)) if last else [first]


def rows() -> list[tuple[str, str, str | None]]:
    """Case, verdict and why of every row of the page."""
    found = [ROW.fullmatch(line) for line in PAGE.read_text(encoding="utf-8").splitlines()]
    return [(case, row["verdict"], row["why"]) for row in found if row for case in cases_of(row["cases"])]


def test_the_page_has_every_case_once() -> None:
    cases = [case for case, _, _ in rows()]
    assert sorted(cases, key=CASES.index) == CASES


def test_every_case_has_a_test() -> None:
    assert in_order({case for mark in marks() for case in mark.cases}) == CASES


def test_every_mark_is_one_of_the_three_and_says_why() -> None:
    said = {(case, mark.why) for mark in marks() for case in mark.cases if mark.why}
    for mark in marks():
        assert mark.verdict in VERDICTS, mark
        for case in mark.cases:
            assert case in CASES, mark
            assert len([why for other, why in said if other == case]) == (mark.verdict != "same"), mark


def test_page_and_tests_agree() -> None:
    marked = {(case, mark.verdict) for mark in marks() for case in mark.cases}
    said = {(case, mark.why) for mark in marks() for case in mark.cases if mark.why}
    assert {(case, verdict) for case, verdict, _ in rows()} == marked
    assert {(case, why) for case, _, why in rows() if why} == said
