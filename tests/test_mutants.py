"""The run over mutants itself, on a tree of three files: what is tested is killed, what is not survives."""

import ast
from pathlib import Path

import pytest
from mutants import judging, making
from mutants.__main__ import ROOT, candidates, run
from mutants.table import EQUIVALENT, LEAVES, Leaf

pytestmark = pytest.mark.process  # each is several runs of pytest


@pytest.mark.parametrize("leaf", [leaf for leaf in LEAVES if leaf.functions], ids=lambda leaf: leaf.file)
def test_functions_of_a_leaf_are_in_its_file(leaf: Leaf) -> None:
    tree = ast.parse((ROOT / leaf.file).read_text(encoding="utf-8"))
    assert set(leaf.functions) <= {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


TOY = '''"""A leaf."""


def clipped(x: float, most: float) -> float:
    """Not more than `most`: 1 + 1 is no code."""
    return min(x, most)


def emptied(words):
    while words:
        words.pop()
    return words


def unseen(x):
    return -x
'''
CALLER = """import importlib

from compilation.jit import jit

toy = importlib.import_module("".join("toy"))
clipped = jit(toy.clipped)


@jit
def doubled(x: float) -> float:
    return 2.0 * clipped(x, 5.0)
"""
TESTS = """import caller
import toy


def test_doubled() -> None:
    assert caller.doubled(3.0) == 6.0


def test_emptied() -> None:
    assert toy.emptied([1, 2]) == []
"""
LEAF = Leaf("tests/toy.py", ("tests/test_toy.py",))


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    (tmp_path / "tests").mkdir()
    for name, text in (("toy.py", TOY), ("caller.py", CALLER), ("test_toy.py", TESTS)):
        (tmp_path / "tests" / name).write_text(text)
    return tmp_path


def test_what_a_test_sees_is_killed_and_what_none_sees_survives(toy: Path) -> None:
    """A compiled caller is made anew, though it imports the leaf by a name that no one can read in its text."""
    leaf = Leaf(LEAF.file, LEAF.tests, ("clipped", "unseen"))
    verdicts = {verdict.mutant.now: verdict for verdict in run(toy, [leaf], {}, seed=1, count=80)}
    assert {now: verdict.word for now, verdict in verdicts.items()} == {
        "return max(x, most)": judging.KILLED,
        "return 0.0": judging.KILLED,
        "return (x)": judging.SURVIVED,
    }
    assert "test_toy.py::test_doubled" in verdicts["return 0.0"].by
    survivor = verdicts["return (x)"].mutant
    assert (survivor.file, survivor.function, survivor.line) == ("tests/toy.py", "unseen", 16)
    assert survivor not in dict(candidates(toy, [LEAF], {survivor.key: "a reason"}, ""))


def test_one_that_hangs_is_killed_and_said_to_hang(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judging, "HANG_S", 0.0)
    monkeypatch.setattr(judging, "HANG_TIMES", 1.0)  # a slow machine changes nothing: it hangs in any case
    (verdict,) = run(toy, [Leaf(LEAF.file, LEAF.tests, ("emptied",))], {}, seed=1, count=80)
    assert (verdict.mutant.now, verdict.word) == ("pass", judging.HANGS)


def test_a_reason_for_a_mutant_that_is_not_there_any_more_is_told(toy: Path) -> None:
    with pytest.raises(AssertionError, match=r"no such mutant any more: tests/toy.py clipped: a → b"):
        candidates(toy, [LEAF], {"tests/toy.py clipped: a → b": "it was"}, "")


def test_tests_that_fail_anyway_judge_nothing(toy: Path) -> None:
    (toy / "tests" / "test_toy.py").write_text("def test_nothing() -> None:\n    assert False\n")
    with pytest.raises(judging.NotGreen, match=r"fails tests/test_toy.py, so it can judge no mutant"):
        run(toy, [LEAF], {}, seed=1, count=1)


def test_a_seed_chooses_and_files_take_turns() -> None:
    known = [mutant for mutant, _ in candidates(ROOT, LEAVES, EQUIVALENT, "")]
    chosen = making.in_turn(known, 1)
    assert chosen == making.in_turn(known, 1) != making.in_turn(known, 2)
    assert len({mutant.key for mutant in known}) == len(known)
    files = {leaf.file for leaf in LEAVES}
    assert {mutant.file for mutant in chosen[: len(files)]} == files


def test_an_edit_changes_one_place_and_no_docstring() -> None:
    source = 'def f(a: int) -> bool:\n    """1 ä"""\n    a |= 1  # ö\n    return (\n        a\n        | 2) > 3\n'
    now = {mutant.applied(source.encode()).decode() for mutant in making.mutants("f.py", source.encode())}
    edits = [
        ("a |= 1", "a |= 2"),
        ("a |= 1", "a |= (0)"),
        ("a |= 1", "pass"),
        ("> 3", ">= 3"),
        ("        | 2", "        & 2"),
    ]
    assert all(source.replace(was, becomes) in now for was, becomes in edits)
    assert all("1 ä" in text for text in now)
