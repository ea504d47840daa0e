"""Stages for the upstream controller's cases, and their count at the end of a test run."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from upstream_cases import CASES, VERDICTS, case_numbers, in_order

UPSTREAM = "upstream"


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "upstream(case, verdict, why=None): plays a case of the upstream controller; case: number or list of numbers; "
        "verdict: same, better or different, the latter two with a sentence why",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        for mark in item.iter_markers("upstream"):
            cases, verdict = mark.args
            item.user_properties += [(UPSTREAM, (case, verdict)) for case in case_numbers(cases)]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """One line: how many cases end as upstream, better or differently, and which did not."""
    verdict_of: dict[str, str] = {}
    broken: set[str] = set()
    for category, reports in terminalreporter.stats.items():
        for report in reports if category in ("passed", "failed", "error", "skipped") else ():
            properties = getattr(report, "user_properties", ())  # a module that was skipped has none
            played = {case: verdict for name, (case, verdict) in properties if name == UPSTREAM}
            verdict_of |= played
            broken |= played.keys() if category != "passed" else set()
    if not verdict_of:
        return
    sound = [verdict for case, verdict in verdict_of.items() if case not in broken]
    parts = [f"{sound.count(verdict)} {verdict}" for verdict in VERDICTS]
    parts.append(f"{len(set(CASES) - verdict_of.keys())} not in this run")
    if broken:
        parts.append(f"not passed: {', '.join(in_order(broken))}")
    terminalreporter.write_line(f"upstream cases: {', '.join(parts)}")


@pytest.fixture
def stage_for(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """Makes stages whose arm is brought up and holds.

    Options are those of `stage.upstream_arm`; `lag_s` is the time constant of the simulated shafts behind their drives.
    """
    from stage import START, Stage, upstream_arm

    stages: list[Stage] = []

    def make(drives: str = "mock", start: Sequence[float] = START, lag_s: float = 0.0, **options: Any) -> Stage:
        stages.append(Stage(upstream_arm(drives, **options), start, monkeypatch, lag_s=lag_s))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()
