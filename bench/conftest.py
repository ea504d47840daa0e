"""What the benchmarks share: a place for their figures, printed together at the end of the run, and kept if asked."""

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from rtarm.bench.machine import machine, versions

ROOT = Path(__file__).parents[1]

_FIGURES: dict[str, dict[str, Any]] = {}
_TOLD: dict[str, dict[str, list[tuple[str, str]]]] = {}
"""By module and test: what was measured, and the sentence about it."""


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


_BEFORE = machine()
_COMMIT = _git("rev-parse", "--short=12", "HEAD") + (" and changes" if _git("status", "--porcelain") else "")

Report = Callable[[str, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    """For whom minutes are too long, where a benchmark has a short form; and for the page of all figures."""
    parser.addoption("--quick", action="store_true", help="bench_view: two minutes instead of twenty")
    parser.addoption(
        "--keep", type=Path, metavar="FOLDER", help="write each benchmark's figures there (bench/measured)"
    )


@pytest.fixture
def quick(request: pytest.FixtureRequest) -> bool:
    """Whether the short form was asked for."""
    return bool(request.config.getoption("--quick"))


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Report:
    """Put a figure into the summary: what was measured, and the sentence about it.

    What is indented belongs to the line before it that is not.
    """
    told = _TOLD.setdefault(request.node.module.__name__, {}).setdefault(request.node.name, [])

    def add(what: str, figure: str) -> None:
        told.append((what, figure))

    return add


@pytest.fixture
def figures() -> dict[str, dict[str, Any]]:
    """Figures that a later benchmark of the same run compares itself with, by name."""
    return _FIGURES


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what was measured, beside what is aimed at, and keep it."""
    if not any(lines for tests in _TOLD.values() for lines in tests.values()):
        return
    terminalreporter.section(f"rtarm on {platform.machine()}, Python {platform.python_version()}")
    for tests in _TOLD.values():
        for what, figure in (line for lines in tests.values() for line in lines):
            terminalreporter.write_line(f"{what:<58} {figure}")
    folder = config.getoption("--keep")
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        for module, tests in _TOLD.items():
            written = json.dumps(_kept(module, tests), indent=1, ensure_ascii=False)
            (folder / f"{module}.json").write_text(f"{written}\n", encoding="utf-8")


def _kept(module: str, tests: dict[str, list[tuple[str, str]]]) -> dict[str, Any]:
    """What handbook.figures makes its page of."""
    about = (sys.modules[module].__doc__ or "").strip()
    return {
        "benchmark": module,
        "about": [" ".join(paragraph.split()) for paragraph in re.split(r"\n\n|\n(?=- )", about)],
        "command": f".venv/bin/python -m pytest bench/{module}.py",
        "settings": {name: value for name, value in sorted(os.environ.items()) if name.startswith("RTARM_")},
        "when": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _COMMIT,
        "machine": _BEFORE,
        "versions": versions(),
        "tests": tests,
    }
