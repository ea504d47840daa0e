"""The two walks through the code in docs/explanation/architecture.md name files and functions that are there."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest
from pages import DOCS, ROOT

PAGE = DOCS / "explanation" / "architecture.md"
HEADINGS = ("One goal point to the drive's frame", "One encoder reading to `/joint_states` and to the limits")
MOST_STEPS = 12
CODE = re.compile(r"`([^`]+)`")
STEP = re.compile(r"^\d+\. .*(?:\n {2,}.*)*", re.MULTILINE)


def steps(heading: str) -> list[str]:
    """The steps of a walk."""
    section = PAGE.read_text(encoding="utf-8").split(f"\n### {heading}\n")[1]
    return STEP.findall(re.split(r"\n#", section)[0])


def named(step: str) -> list[tuple[str, str]]:
    """File and function of each function that a step names: it belongs to the file that was named last."""
    found, file = [], ""
    for code in CODE.findall(step):
        if code.endswith(".py"):
            file = code
        elif code.endswith("()"):
            found.append((file, code.removesuffix("()")))
    return found


@cache
def functions(file: str) -> set[str]:
    """The functions of a file, methods behind the name of their class."""
    names = set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
    return names


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_walk_is_short(heading: str) -> None:
    assert 0 < len(steps(heading)) <= MOST_STEPS


@pytest.mark.parametrize("step", [step for heading in HEADINGS for step in steps(heading)], ids=lambda step: step[:50])
def test_files_and_functions_of_a_step_are_there(step: str) -> None:
    assert named(step), "a step names a file and a function of it"
    missing = [f"{name}() in {file}" for file, name in named(step) if name not in functions(file)]
    assert missing == []
    assert [code for code in CODE.findall(step) if code.endswith(".py") and not (ROOT / code).is_file()] == []
