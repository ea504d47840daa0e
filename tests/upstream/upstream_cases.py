"""Which cases there are, read from the marks of the tests beside this file: no test needs to run for it."""

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

NUMBERED = 95
"""Cases of the upstream controller's own tests."""
ADDED = 40
"""Cases A1 … of what upstream does not check, does not test, was measured doing, and is asked for by its users."""
CASES = [str(number) for number in range(1, NUMBERED + 1)] + [f"A{number}" for number in range(1, ADDED + 1)]
VERDICTS = ("same", "better", "different")


class Mark(NamedTuple):
    """One `pytest.mark.upstream`."""

    cases: tuple[str, ...]
    verdict: str
    why: str | None
    file: str
    line: int


def case_numbers(case: object) -> list[str]:
    """The argument of a mark, one number or several, as they stand in the table."""
    return [str(entry) for entry in case] if isinstance(case, (list, tuple)) else [str(case)]


def in_order(cases: Iterable[str]) -> list[str]:
    return [case for case in CASES if case in set(cases)]


def marks() -> Iterator[Mark]:
    """Every mark that stands in the test files of this folder, whether or not its test was selected."""
    for path in sorted(Path(__file__).parent.glob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "upstream":
                cases, verdict = (ast.literal_eval(argument) for argument in node.args)
                named = {keyword.arg: ast.literal_eval(keyword.value) for keyword in node.keywords}
                yield Mark(tuple(case_numbers(cases)), verdict, named.get("why"), path.name, node.lineno)
