"""The reference pages are what the code says."""

from __future__ import annotations

import difflib
import subprocess
import sys
from pathlib import Path

import pytest
from pages import DOCS, ROOT

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from handbook.reference import PAGES

pytestmark = pytest.mark.process  # one page asks a real node


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages as the code makes them now."""
    folder = tmp_path_factory.mktemp("reference")
    result = subprocess.run(
        [sys.executable, "-m", "handbook", str(folder)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return folder


@pytest.mark.parametrize("name", PAGES)
def test_a_reference_page_is_current(name: str, made: Path) -> None:
    now = (made / name).read_text(encoding="utf-8").splitlines()
    committed = (DOCS / "reference" / name).read_text(encoding="utf-8").splitlines()
    changes = "\n".join(difflib.unified_diff(committed, now, f"docs/reference/{name}", "the code", n=0, lineterm=""))
    assert not changes, f"run `make reference` and commit what it changes:\n{changes}"


def test_the_folder_holds_nothing_else() -> None:
    assert {path.name for path in (DOCS / "reference").iterdir()} == set(PAGES)
