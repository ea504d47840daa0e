"""An arm in shared memory without processes, arm files of one's own, and the command line in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import typer.testing
import yaml
from stack import PATIENT
from typer.main import get_command
from typer.testing import CliRunner, Result
from written_arm import WrittenArm

from config.loader import ARMS_FOLDER
from rtarm.cli.application import app

COMMANDS = get_command(app)
"""Made once: typer's runner would make all of them anew at each call, which takes 28 ms."""


@pytest.fixture
def arm(arm_name: str) -> Iterator[WrittenArm]:
    """A healthy arm but for its front."""
    written = WrittenArm(arm_name)
    yield written
    written.files.remove()


@pytest.fixture
def rtarm(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """`rtarm("status", "--json")`: output, standard error and exit code, without a process."""
    runner = CliRunner()
    monkeypatch.setattr(typer.testing, "_get_command", lambda _: COMMANDS)

    def run(*arguments: str) -> Result:
        result = runner.invoke(app, list(arguments), env={"COLUMNS": "200"})
        # An exception other than SystemExit would be a traceback.
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    return run


@pytest.fixture
def arm_file(arm_name: str, tmp_path: Path) -> Path:
    """episode1 under a name that no other test uses, with limits that no stall of the machine exceeds."""
    path = renamed("episode1", arm_name, tmp_path)
    with path.open("a", encoding="utf-8") as file:
        file.write(yaml.safe_dump({"limits": PATIENT}))
    return path


@pytest.fixture
def mock_file(arm_name: str, tmp_path: Path) -> Path:
    """mock under a name that no other test uses."""
    return renamed("mock", arm_name, tmp_path)


def renamed(arm: str, name: str, folder: Path) -> Path:
    """A known arm's file under another name."""
    text = (ARMS_FOLDER / f"{arm}.yaml").read_text(encoding="utf-8")
    path = folder / f"{name}.yaml"
    path.write_text(text.replace(f"name: {arm}", f"name: {name}", 1), encoding="utf-8")
    return path
