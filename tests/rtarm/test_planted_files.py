"""What every command says of a file, link, pipe or directory that stands in the place of an arm's memory."""

from __future__ import annotations

import json
import os
import pwd
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import Result

from rtarm.top.watch import Watch
from shm import files
from shm.errors import NotPermitted

STRANGER = 1
"""A user of this machine that runs no arms."""
PLANTED: dict[str, Callable[[Path], object]] = {
    "file": Path.touch,
    "link": lambda path: path.symlink_to("/etc/passwd"),
    "directory": Path.mkdir,
    "pipe": os.mkfifo,
}
COMMANDS = (
    *(["status"], ["record"], ["stop"], ["hold"], ["resume"], ["enable"], ["disable"], ["free"], ["clear-fault"]),
    *(["home", "--arm"], ["reference", "joint1", "--arm"], ["teach", "motion", "--arm"]),
)
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")


@pytest.fixture
def planted(arm_name: str) -> Iterator[Callable[[str], Path]]:
    """Puts something of a stranger at the arm's state file, which is taken away afterwards."""
    path = files.state_path(arm_name)

    def put(kind: str) -> Path:
        PLANTED[kind](path)
        os.chown(path, STRANGER, STRANGER, follow_symlinks=False)
        return path

    yield put
    path.rmdir() if path.is_dir() else path.unlink()


def beginning(path: Path, kind: str) -> str:
    return f"{path} is a {kind} of user {pwd.getpwuid(STRANGER).pw_name} with mode "


@as_root
@pytest.mark.parametrize("kind", PLANTED)
@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_says_whose_file_is_in_the_way(
    rtarm: Callable[..., Result], planted: Callable[[str], Path], arm_name: str, command: list[str], kind: str
) -> None:
    path = planted(kind)
    result = rtarm(*command, arm_name)
    assert result.exit_code != 0
    assert result.stderr.startswith(beginning(path, kind)) and "administrator" in result.stderr


@as_root
def test_a_script_is_told_in_json(rtarm: Callable[..., Result], planted: Callable[[str], Path], arm_name: str) -> None:
    path = planted("file")
    (problem,) = json.loads(rtarm("status", arm_name, "--json").stdout)["problems"]
    assert problem.startswith(beginning(path, "file"))


@as_root
@pytest.mark.parametrize("kind", PLANTED)
def test_top_and_view_say_whose_file_is_in_the_way(planted: Callable[[str], Path], arm_name: str, kind: str) -> None:
    path = planted(kind)
    with pytest.raises(NotPermitted, match=f"^{beginning(path, kind)}"):
        Watch(arm_name)  # what both look through


@as_root
@pytest.mark.parametrize("kind", PLANTED)
def test_a_stranger_s_file_is_no_arm_that_runs(
    rtarm: Callable[..., Result], planted: Callable[[str], Path], arm_name: str, kind: str
) -> None:
    planted(kind)
    assert arm_name not in files.running_arms() + files.arms_left_behind()
    assert arm_name not in rtarm("status").output
