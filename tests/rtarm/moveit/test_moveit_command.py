"""`rtarm moveit-config`: the package where it is wanted, or a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from config.loader import ARMS_FOLDER

Rtarm = Callable[..., Result]


def test_an_own_arm_gets_its_package(arm_name: str, arm_file: Path, tmp_path: Path, rtarm: Rtarm) -> None:
    result = rtarm("moveit-config", str(arm_file), "-o", str(tmp_path))
    folder = tmp_path / f"{arm_name}_moveit_config"
    assert (result.exit_code, result.stderr) == (0, "")
    written, blind = result.stdout.splitlines()
    assert written.startswith(f"{folder}: ") and written.endswith(" files written, 0 as they were.")
    assert blind.startswith("MoveIt will not look whether these collide") and "base_link and link2" in blind
    assert (folder / "config" / f"{arm_name}.srdf").exists()
    again = rtarm("moveit-config", str(arm_file), "--output", str(tmp_path))
    assert again.stdout.startswith(f"{folder}: 0 files written, ")


def test_an_own_arm_is_never_taken_for_one_of_ours(arm_file: Path, arm_name: str, tmp_path: Path, rtarm: Rtarm) -> None:
    rtarm("moveit-config", str(arm_file), "-o", str(tmp_path))
    launch = (tmp_path / f"{arm_name}_moveit_config" / "launch" / "real_arm.launch.py").read_text(encoding="utf-8")
    assert f"`rtarm moveit-config {arm_file.name}`" in launch  # a command that works where the file is
    assert 'DeclareLaunchArgument("arm", description=' in launch  # no default: only its owner knows the path
    copied = tmp_path / "copied.yaml"
    copied.write_text((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    refused = rtarm("moveit-config", str(copied), "-o", str(tmp_path))
    assert (
        refused.exit_code == 1 and "name is episode1, which is that of an arm that comes with rtarm" in refused.stderr
    )
    assert not (tmp_path / "episode1_moveit_config").exists()


def test_force_is_what_the_refusal_says(arm_file: Path, arm_name: str, tmp_path: Path, rtarm: Rtarm) -> None:
    rtarm("moveit-config", str(arm_file), "-o", str(tmp_path))
    (tmp_path / f"{arm_name}_moveit_config" / "package.xml").write_text("mine", encoding="utf-8")
    refused = rtarm("moveit-config", str(arm_file), "-o", str(tmp_path))
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert "changed by hand" in refused.stderr and "--force" in refused.stderr
    forced = rtarm("moveit-config", str(arm_file), "-o", str(tmp_path), "--force")
    assert (forced.exit_code, forced.stdout.split(": ")[1].split(",")[0]) == (0, "1 files written")


@pytest.mark.parametrize(
    ("arm", "folder", "said"),
    [
        ("mock", ".", "mock has no section kinematics, which the robot model is made of; add it"),
        ("episode1", "nowhere", "nowhere does not exist; name an existing folder"),
        ("nobody", ".", "no arm is called 'nobody'"),
        ("episode1", "x" * 300, "cannot be used (file name too long)"),
    ],
)
def test_a_refusal_is_a_sentence(arm: str, folder: str, said: str, rtarm: Rtarm, tmp_path: Path) -> None:
    result = rtarm("moveit-config", arm, "-o", str(tmp_path / folder))
    assert (result.exit_code, result.stdout) == (1, "")
    assert said in result.stderr and len(result.stderr.splitlines()) == 1


def test_an_unset_shell_variable_is_no_folder(rtarm: Rtarm) -> None:
    result = rtarm("moveit-config", "episode1", "-o", "")
    assert (result.exit_code, result.stdout) == (1, "") and result.stderr.startswith("-o names no folder: ")


def test_help_has_an_example(rtarm: Rtarm) -> None:
    assert "Example: rtarm moveit-config ./my_arm.yaml -o" in " ".join(rtarm("moveit-config", "--help").stdout.split())


def test_a_folder_must_be_named(rtarm: Rtarm) -> None:
    result = rtarm("moveit-config", "episode1")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "--output" in result.stderr
