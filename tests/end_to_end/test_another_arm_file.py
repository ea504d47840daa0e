"""After a crash an arm is started again from the file that ran, never from another one of the same name."""

import os
import shlex
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from arm_files import edited, write_arm
from stack import Process, run_rtarm

from config.loader import ARMS_FOLDER
from shm.files import DIRECTORY, died_with, previous_path, state_path

pytestmark = pytest.mark.process


@pytest.fixture
def file_in(arm_name: str, tmp_path: Path) -> Callable[..., Path]:
    """Writes a mock arm of the test's name into a folder of its own."""

    def write(folder: str, **joint1: Any) -> Path:
        own = tmp_path / folder
        own.mkdir(exist_ok=True)
        path = write_arm("mock", arm_name, own)
        with edited(path) as values:
            values["joints"][0].update(joint1)
        return path

    return write


@pytest.fixture
def started(arm_name: str) -> Iterator[Callable[..., Process]]:
    """Starts control processes, and leaves nothing of them."""
    processes: list[Process] = []

    def start(file: Path, *options: str) -> Process:
        processes.append(Process("rtloop", str(file), *options))
        return processes[-1]

    yield start
    for process in processes:
        process.close()
    for left in DIRECTORY.glob(f"rtarm.{arm_name}.*"):
        left.unlink()


def killed(process: Process) -> None:
    process.line_with("ready")
    process.process.send_signal(signal.SIGKILL)
    assert process.code() == -signal.SIGKILL


def ended(process: Process) -> None:
    process.line_with("ready")
    process.process.send_signal(signal.SIGTERM)
    assert process.code() == 0


def status(arm: str) -> str:
    done = run_rtarm("status", arm)
    assert done.returncode != 0
    return done.stderr


def test_another_file_of_the_name_is_refused_with_what_differs(arm_name, file_in, started) -> None:
    own, other = file_in("my arms", zero_deg=170.0), file_in("shipped", zero_deg=160.0, lower_deg=-90.0)
    killed(started(own))
    assert f"gone without an orderly end: start it again with `rtarm up {shlex.quote(str(own))}`." in status(arm_name)

    refused = started(other)
    assert refused.code() == 2
    sentence = refused.lines[-1]
    assert f"it ran another arm file than {other}: {own}, which differs in " in sentence
    assert "zero_deg of joint1 (170.0 there, 160.0 here)" in sentence
    assert "lower_deg of joint1" in sentence
    assert f"start that one with `rtarm up {shlex.quote(str(own))}`, or, if this one is right" in sentence
    assert str(own) in status(arm_name), "a start that is refused changes nothing"

    ended(started(own))
    ended(started(other))


def test_a_person_who_means_the_other_file_makes_the_dead_one_forgotten(arm_name, file_in, started) -> None:
    own, other = file_in("mine", zero_deg=170.0), file_in("other", zero_deg=160.0)
    killed(started(own, "--set", "control.rate_hz=50"))
    refused = started(other)
    assert refused.code() == 2
    *_, command = refused.lines[-1].removesuffix("`.").rpartition("`")
    assert f"`rtarm up {own}` (with the options it had), or" in refused.lines[-1]
    subprocess.run(shlex.split(command), check=True)
    assert command == f"rm {state_path(arm_name)}"
    ended(started(other))


def test_a_link_that_points_to_another_file_is_that_file(file_in, started, tmp_path) -> None:
    own, other = file_in("mine", zero_deg=170.0), file_in("other", zero_deg=160.0)
    link = tmp_path / "current.yaml"
    link.symlink_to(own)
    killed(started(link))
    link.unlink()
    link.symlink_to(other)
    refused = started(link)
    assert refused.code() == 2
    assert f"it ran another arm file than {other}: {own}, which differs in zero_deg of joint1" in refused.lines[-1]


def test_a_file_that_was_edited_or_moved_is_no_other_one(arm_name, file_in, started) -> None:
    own = file_in("here", zero_deg=170.0)
    killed(started(own))
    file_in("here", zero_deg=150.0)
    killed(started(own))
    moved = own.parent.parent / "moved.yaml"
    os.rename(own, moved)
    killed(started(moved))
    commented = own.parent.parent / "commented.yaml"
    commented.write_text(f"# mine\n{moved.read_text(encoding='utf-8')}", encoding="utf-8")
    killed(started(commented))
    assert died_with(arm_name).arm_file == str(commented)


def test_what_differs_from_a_file_that_is_gone_is_not_known(file_in, started) -> None:
    own, other = file_in("mine", zero_deg=170.0), file_in("other", zero_deg=160.0)
    killed(started(own))
    own.unlink()
    refused = started(other)
    assert refused.code() == 2
    assert f"{own}, which cannot be read any more, so what differs is not known: if this one is" in refused.lines[-1]


def test_a_start_that_fails_forgets_no_death(arm_name, file_in, started) -> None:
    """It makes room for itself and gives that back; or else another file would start after it."""
    own, other = file_in("mine"), file_in("other", zero_deg=160.0)
    killed(started(own))
    text = yaml.safe_load(own.read_text(encoding="utf-8"))
    text["bus"] = {"interface": "slcan", "channel": "/dev/ttyUSB99", "bitrate": 500000}
    text["joints"] = yaml.safe_load((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"))["joints"]
    own.write_text(yaml.safe_dump(text), encoding="utf-8")
    failed = started(own)
    assert failed.code() == 2 and "There is no serial port" in failed.lines[-1]
    assert state_path(arm_name).exists() and not previous_path(arm_name).exists()
    refused = started(other)
    assert refused.code() == 2 and "it ran another arm file" in refused.lines[-1]


def test_an_arm_of_another_name_is_not_asked(file_in, started, arm_name) -> None:
    killed(started(file_in("mine")))
    with closing(Process("rtloop", "mock", "--set", f"name={arm_name}")) as other:
        ended(other)
