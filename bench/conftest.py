"""What the benchmarks share: a place for their figures, printed together at the end of the run."""

import platform
from collections.abc import Callable
from typing import Any

import pytest

_FIGURES: dict[str, dict[str, Any]] = {}
_LINES: list[str] = []


Report = Callable[[str, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    """For whom minutes are too long, where a benchmark has a short form."""
    parser.addoption("--quick", action="store_true", help="bench_view: two minutes instead of twenty")


@pytest.fixture
def quick(request: pytest.FixtureRequest) -> bool:
    """Whether the short form was asked for."""
    return bool(request.config.getoption("--quick"))


@pytest.fixture
def report() -> Report:
    """Put a figure into the summary: what was measured, and the sentence about it."""

    def add(what: str, figure: str) -> None:
        _LINES.append(f"{what:<58} {figure}")

    return add


@pytest.fixture
def figures() -> dict[str, dict[str, Any]]:
    """Figures that a later benchmark of the same run compares itself with, by name."""
    return _FIGURES


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what was measured, beside what is aimed at."""
    if _LINES:
        terminalreporter.section(f"rtarm on {platform.machine()}, Python {platform.python_version()}")
        for line in _LINES:
            terminalreporter.write_line(line)
