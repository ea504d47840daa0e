"""The evening with Nemo in docs/hardware/add-a-drive.md, followed word for word in a copy of the tree."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import DOCS, ROOT, Block, sections

PAGE = DOCS / "hardware" / "add-a-drive.md"
NEMO = ROOT / "examples" / "nemo"
TITLES = ("An evening with Nemo", "A family in full")
CHANGED = ("config/joint.py", "sim/drives/families.py", "tests/rtloop/drives/test_drive_conformance.py")
PATIENCE_S = 600.0
LEFT_BEHIND = shutil.ignore_patterns(".git", ".venv", "build", "dist", "__pycache__", ".*_cache", "*.egg-info")


def evening() -> list[Block]:
    """The blocks of the page's first part."""
    parts = sections(PAGE.read_text(encoding="utf-8"))
    begin, end = (next(i for i, part in enumerate(parts) if part.title == title) for title in TITLES)
    return [block for part in parts[begin:end] for block in part.blocks]


def changed(tree: Path, block: Block) -> None:
    """Make the change that a block shows: its lines with `-` stand once in the tree, at the begin of the file's."""
    before, after = ("\n".join(line[1:] for line in block.lines if line.startswith((mark, " "))) for mark in ("-", "+"))
    files = [tree / name for name in CHANGED]
    (found,) = [file for file in files if file.read_text(encoding="utf-8").count(before) == 1]
    found.write_text(found.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")


def typed(tree: Path, line: str) -> None:
    """Type a line of the page in the tree, with the programs of this environment; it must end well."""
    paths = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = {**os.environ, "PATH": paths, "PYTHONPATH": os.pathsep.join((str(tree), str(tree / "tests")))}
    line = line.replace("rtarm ", "python -m rtarm ", 1) if line.startswith("rtarm ") else line
    ended = subprocess.run(
        ["bash", "-c", line], cwd=tree, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert ended.returncode == 0, f"{line}\n{ended.stdout[-3000:]}\n{ended.stderr[-3000:]}"


def test_what_the_page_shows_of_the_files_stands_in_them() -> None:
    files = [file.read_text(encoding="utf-8") for file in NEMO.rglob("*.py")]
    shown = ["\n".join(block.lines) for block in evening() if block.info == "python"]
    assert shown
    for part in shown:
        assert sum(part in text for text in files) == 1, part
    text = PAGE.read_text(encoding="utf-8")
    for file in NEMO.rglob("*.py"):
        lines = len(file.read_text(encoding="utf-8").splitlines())
        assert f"**`{file.relative_to(NEMO).as_posix()}`** ({lines}" in text


@pytest.mark.process
def test_the_evening_ends_with_an_arm_that_moves(tmp_path: Path) -> None:
    tree = tmp_path / "rtarm"
    shutil.copytree(ROOT, tree, ignore=LEFT_BEHIND)
    for block in evening():
        if block.info == "diff":
            changed(tree, block)
        if block.info == "bash":
            for line in block.lines:
                typed(tree, line)
