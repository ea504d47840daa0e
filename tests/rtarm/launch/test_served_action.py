"""Two arms of one machine are never served under one action in one ROS domain, and nothing hinders a restart."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from arm_files import edited, write_arm
from stack import Process, run_rtarm
from waiting import ready_process

from rtarm.console.errors import ExitCode, Refusal
from rtarm.launch.served_action import claim_action, namespace_of
from rtarm.running.status import read_status
from shm.files import DIRECTORY, state_path

HOLDS = """
import sys
from rtarm.launch.served_action import claim_action
held = claim_action(*sys.argv[1:])
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def action(arm_name: str) -> str:
    """An action that no other test serves."""
    return f"/of_{arm_name}/follow_joint_trajectory"


def test_the_second_arm_of_an_action_is_refused_until_the_first_has_ended(action: str) -> None:
    with closing(claim_action(action, "7", "left")):
        with pytest.raises(Refusal) as refused:
            claim_action(action, "7", "right")
        assert refused.value.sentence.startswith(
            f"Arm 'left' (`rtarm up`, pid {os.getpid()}) serves {action} in ROS domain 7 already"
        )
        assert refused.value.code == ExitCode.REFUSED
    claim_action(action, "7", "right").close()


@pytest.mark.parametrize("domain", ["7", "007"])
def test_a_domain_is_a_number(action: str, domain: str) -> None:
    with closing(claim_action(action, "7", "left")), pytest.raises(Refusal, match="in ROS domain 7 already"):
        claim_action(action, domain, "right")


@pytest.mark.parametrize("domain", ["", "0", "00"])
def test_without_a_domain_it_is_0(action: str, domain: str) -> None:
    with closing(claim_action(action, "", "left")), pytest.raises(Refusal, match="in ROS domain 0 already"):
        claim_action(action, domain, "right")


def test_other_domains_and_namespaces_are_apart(action: str) -> None:
    with closing(claim_action(action, "7", "left")):
        claim_action(action, "70", "right").close()
        claim_action(f"/right{action}", "7", "right").close()


def test_a_claim_falls_with_its_process_at_once(action: str) -> None:
    with ready_process("-c", HOLDS, action, "7", "left") as holder:
        with pytest.raises(Refusal, match=f"^Arm 'left' .`rtarm up`, pid {holder.pid}. serves"):
            claim_action(action, "7", "right")
        holder.kill()
        holder.wait()
        claim_action(action, "7", "right").close()


def test_the_longest_name_of_an_arm_fits(action: str) -> None:
    claim_action(f"/{'n' * 200}{action}", "232", "a" * 32).close()


@pytest.mark.parametrize(
    ("arguments", "namespace"),
    [
        ([], ""),
        (["--ros-args", "-r", "__ns:=/left"], "/left"),
        (["--ros-args", "--remap", "robot_interface:__ns:=/a/b"], "/a/b"),
        (["--ros-args", "-r", "__ns:=/"], ""),
        (["--ros-args", "-p", "sim:=true", "-r", "a:=b", "-r", "__ns:=/first", "-r", "__ns:=/second"], "/first"),
    ],
)
def test_the_namespace_is_the_one_that_ros_takes(arguments: list[str], namespace: str) -> None:
    assert namespace_of(arguments) == namespace


@pytest.mark.process
def test_up_starts_nothing_beside_another_arm_of_its_action_and_at_once_after_it_was_killed(
    new_arm_name: Callable[[], str], tmp_path: Path
) -> None:
    left, right = new_arm_name(), new_arm_name()
    files = {name: renamed(name, f"of_{left}", tmp_path) for name in (left, right)}
    try:
        with closing(Process("rtarm", "up", str(files[left]), needs_ros=True)) as first:
            first.line_with("running; Ctrl-C")
            second = run_rtarm("up", str(files[right]))
            assert (second.returncode, second.stdout) == (ExitCode.REFUSED, "")
            assert second.stderr.startswith(
                f"Arm '{left}' (`rtarm up`, pid {first.process.pid}) serves /of_{left}/follow"
            )
            assert second.stderr.count("\n") == 1 and not state_path(right).exists()
            report = read_status(left)
            assert (report["healthy"], report["problems"]) == (True, [])
            first.process.kill()
            first.process.wait()
            with closing(Process("rtarm", "up", str(files[right]), needs_ros=True)) as third:
                third.line_with("running; Ctrl-C")
    finally:
        for path in DIRECTORY.glob(f"rtarm.{left}.*"):  # what a killed arm leaves
            path.unlink()


@pytest.mark.process
def test_one_of_two_alike_goes_into_a_namespace(new_arm_name: Callable[[], str], tmp_path: Path) -> None:
    left, right = new_arm_name(), new_arm_name()
    for name in (left, right):
        renamed(name, f"of_{left}", tmp_path)
    with (
        closing(Process("rtarm", "up", str(tmp_path / f"{left}.yaml"), needs_ros=True)) as first,
        closing(
            Process(
                "rtarm.launch.robot_interface",
                "--ros-args",
                "-r",
                "__ns:=/right",
                "-p",
                f"arm:={tmp_path / right}.yaml",
                needs_ros=True,
            )
        ) as second,
    ):
        first.line_with("running; Ctrl-C")
        second.line_with(f"action /right/of_{left}/follow_joint_trajectory")
        second.line_with("running; Ctrl-C")


def renamed(name: str, controller: str, folder: Path) -> Path:
    """The file of a mock arm of this name, with this controller."""
    file = write_arm("mock", name, folder)
    with edited(file) as values:
        values["front"]["controller_name"] = controller
    return file
