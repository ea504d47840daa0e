"""Stages for the upstream controller's cases, and their count at the end of a test run."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from upstream_cases import CASES, VERDICTS, case_numbers, in_order, marks

_MARKED = pytest.StashKey[dict[str, list[tuple[str, str]]]]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "upstream(case, verdict, why=None): plays a case of the upstream controller; case: number or list of numbers; "
        "verdict: same, better or different, the latter two with a sentence why",
    )


def pytest_collection_finish(session: pytest.Session) -> None:
    marked = session.config.stash.setdefault(_MARKED, {})
    for item in session.items:
        for mark in item.iter_markers("upstream"):
            cases, verdict = mark.args
            marked.setdefault(item.nodeid, []).extend((case, verdict) for case in case_numbers(cases))


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """One line: how many cases end as upstream, better or differently, and which did not."""
    marked = config.stash.get(_MARKED, {})
    if not marked or config.option.collectonly:
        return
    passed = {report.nodeid for report in terminalreporter.stats.get("passed", [])}
    verdict_of = {case: verdict for rows in marked.values() for case, verdict in rows}
    broken = {case for nodeid, rows in marked.items() if nodeid not in passed for case, _ in rows}
    sound = [verdict for case, verdict in verdict_of.items() if case not in broken]
    parts = [f"{sound.count(verdict)} {verdict}" for verdict in VERDICTS]
    missing = in_order(set(CASES) - set(verdict_of))
    collected = {nodeid.partition("::")[0].rpartition("/")[2] for nodeid in marked}
    if collected < {mark.file for mark in marks()} or "deselected" in terminalreporter.stats:
        parts.append(f"{len(missing)} not in this run")
    else:
        parts.append(f"{', '.join(missing) or 'none'} missing")
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
