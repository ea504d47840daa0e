"""A name that users build on does not go, nor change, unless a person has decided so (docs/reference/stability.md)."""

from __future__ import annotations

from pathlib import Path

import pytest
import stable_names
from json_reports import REPORTS
from stable_names import KINDS, now

from handbook import stability
from handbook.commands import commands
from handbook.stability import listed, path_of

HOW = {name: pytest.param(name, marks=pytest.mark.process if name == "ros" else ()) for name in KINDS}
"""The node that is asked for ROS names is a process."""


@pytest.mark.parametrize("kind", HOW.values())
def test_the_code_has_the_names_of_the_list(kind: str) -> None:
    if kind == "ros":
        pytest.importorskip("rclpy")
        pytest.importorskip("control_msgs")
    of_list, of_code = listed(kind).keys(), now(kind)
    file = path_of(kind).name
    assert not of_list - of_code, (
        f"gone from the code: {sorted(of_list - of_code)}. Users build on these: bring each back, as a deprecated name "
        "if another takes its place (docs/reference/stability.md). One that was deprecated long enough, or was in no "
        f"release yet, loses its line in handbook/stable_names/{file}, and CHANGELOG.md says so."
    )
    assert not of_code - of_list, (
        f"new: {sorted(of_code - of_list)}. They are there to stay once they are released: if each is well named, add "
        f"it to handbook/stable_names/{file} by `make names`."
    )


def test_each_command_that_prints_json_is_in_the_list() -> None:
    switches = {
        command.name
        for command in commands()
        for given in command.command.params
        if "--json" in given.opts and given.is_flag
    }
    assert switches == REPORTS.keys()


def test_a_deprecated_name_keeps_its_remark_and_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "exit-codes.txt"
    path.write_text("0 done  # deprecated since 0.2.0: use 7\n9 gone\n", encoding="utf-8")
    monkeypatch.setattr(stability, "path_of", lambda kind: tmp_path / f"{kind}.txt")
    monkeypatch.setattr(stable_names, "KINDS", {"exit-codes": stable_names.of_exit_codes})
    stable_names.add_new_names()
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["0 done  # deprecated since 0.2.0: use 7", "1 refused"]
    assert lines[-1] == "9 gone", "which a person must see"
    assert "| `0 done` | deprecated since 0.2.0: use 7 |" in stability.build()


def test_a_list_is_in_order_and_names_nothing_twice() -> None:
    for kind in KINDS:
        lines = path_of(kind).read_text(encoding="utf-8").splitlines()
        assert lines == sorted(set(lines)) and len(lines) == len(listed(kind)), kind


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("configuration", "joints[].drive(zdt).address"),
        ("commands", "rtarm up --sim"),
        ("json", "rtarm status: joints[].position_rad"),
        ("json", "rtarm explain: first.joint"),
        ("json", "rtarm move: said"),
        ("numbers", "Fault following_error 5"),
        ("python", "rtarm.Arm: move(*, speed=0.3)"),
        ("python", "rtarm.GoalFailed: is Refusal"),
        ("python", "rosfront.gripper.hook.Gripper: move(max_effort)"),
        ("ros", "/dynamic_joint_states: effort"),
        ("recordings", "/rtarm/joints/JOINT: measured_position_rad (number or null)"),
        ("recordings", "metadata rtarm.limits: joints"),
        ("ros", "action ~/follow_joint_trajectory control_msgs/action/FollowJointTrajectory"),
    ],
)
def test_what_users_know_is_found(kind: str, name: str) -> None:
    """The way from the code to a list is not itself short of names."""
    assert name in listed(kind)
