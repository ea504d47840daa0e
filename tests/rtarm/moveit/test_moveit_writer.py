"""Writing the package: nothing of anybody's is lost, and what is ours is brought up to date."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from config.errors import ConfigError
from config.geometry import KinematicsConfig
from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.moveit import package_files, write_package, writer

Edit = Callable[[Path], None]


@pytest.fixture
def arm() -> ArmConfig:
    return load_arm("episode1")


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refusal(arm: ArmConfig, into: Path, *, force: bool = False) -> str:
    """The sentence, after which everything is as it was."""
    before = tree(into) if into.is_dir() else {}
    with pytest.raises(ConfigError) as refused:
        write_package(arm, into, force=force)
    assert (tree(into) if into.is_dir() else {}) == before
    return str(refused.value)


def test_it_writes_what_is_generated_and_a_list_of_it(arm: ArmConfig, tmp_path: Path) -> None:
    written = write_package(arm, tmp_path)
    folder = tmp_path / "episode1_moveit_config"
    assert arm.kinematics is not None
    files = package_files(arm, arm.kinematics)
    assert {path: text.encode() for path, text in files.items()} == {
        path: data for path, data in tree(folder).items() if path != ".rtarm"
    }
    assert (written.folder, set(written.written), written.removed, written.unchanged) == (folder, set(files), (), 0)
    subprocess.run(["sha256sum", "--check", "--quiet", "--strict", ".rtarm"], cwd=folder, check=True)


def test_a_second_call_changes_nothing(arm: ArmConfig, tmp_path: Path) -> None:
    write_package(arm, tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.name != ".rtarm" and path.is_file()}
    written = write_package(arm, tmp_path)
    assert (written.written, written.removed, written.unchanged) == ((), (), len(times))
    assert all(path.stat().st_mtime_ns == before for path, before in times.items())


def test_a_changed_arm_file_brings_it_up_to_date(arm: ArmConfig, tmp_path: Path) -> None:
    write_package(arm, tmp_path)
    slower = load_arm("episode1", overrides={"trajectory": {"goal_time_s": 2.0}})
    assert write_package(slower, tmp_path).written == ("config/moveit_controllers.yaml",)


def test_files_of_ones_own_stay(arm: ArmConfig, tmp_path: Path) -> None:
    write_package(arm, tmp_path)
    mesh = tmp_path / "episode1_moveit_config" / "meshes" / "link1.stl"
    mesh.parent.mkdir()
    mesh.write_text("solid", encoding="utf-8")
    for force in (False, True):
        assert write_package(arm, tmp_path, force=force).removed == ()
        assert mesh.read_text(encoding="utf-8") == "solid"


def test_a_file_that_is_not_generated_any_more_is_removed(
    arm: ArmConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def more(arm: ArmConfig, kinematics: KinematicsConfig) -> dict[str, str]:
        return {**package_files(arm, kinematics), "config/old.yaml": "old\n"}

    with monkeypatch.context() as patch:
        patch.setattr(writer, "package_files", more)
        write_package(arm, tmp_path)
    old = tmp_path / "episode1_moveit_config" / "config" / "old.yaml"
    assert old.exists()
    assert write_package(arm, tmp_path).removed == ("config/old.yaml",)
    assert not old.exists()


def test_a_file_changed_by_hand_is_not_lost(arm: ArmConfig, tmp_path: Path) -> None:
    write_package(arm, tmp_path)
    edited = tmp_path / "episode1_moveit_config" / "config" / "kinematics.yaml"
    generated = edited.read_bytes()
    edited.write_text("my_group: {}\n", encoding="utf-8")
    sentence = refusal(arm, tmp_path)
    assert "changed by hand and would be overwritten: config/kinematics.yaml; move your changes" in sentence
    assert write_package(arm, tmp_path, force=True).written == ("config/kinematics.yaml",)
    assert edited.read_bytes() == generated


def test_a_removed_file_comes_back(arm: ArmConfig, tmp_path: Path) -> None:
    write_package(arm, tmp_path)
    (tmp_path / "episode1_moveit_config" / "package.xml").unlink()
    assert write_package(arm, tmp_path).written == ("package.xml",)


@pytest.mark.parametrize("there_before", [False, True])
def test_a_call_that_was_cut_short_can_be_repeated(
    there_before: bool, arm: ArmConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if there_before:
        write_package(load_arm("episode1", overrides={"front": {"controller_name": "c"}}), tmp_path)
    writes = iter(range(2))
    write_text = Path.write_text

    def until_the_disk_is_full(path: Path, *arguments: Any, **options: Any) -> int:
        if next(writes, None) is None:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write_text(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", until_the_disk_is_full)
        with pytest.raises(ConfigError, match=r"cannot be used \(no space left on device\); choose another folder"):
            write_package(arm, tmp_path)
    write_package(arm, tmp_path)
    assert arm.kinematics is not None
    for path, text in package_files(arm, arm.kinematics).items():
        assert (tmp_path / "episode1_moveit_config" / path).read_text(encoding="utf-8") == text


def somebody_elses(folder: Path) -> None:
    folder.mkdir()
    (folder / "package.xml").write_text("<package/>", encoding="utf-8")


def with_a_list_that_leads_out(folder: Path) -> None:
    folder.mkdir()
    (folder / ".rtarm").write_text(f"{'0' * 64}  ../precious\n", encoding="utf-8")


def a_file(folder: Path) -> None:
    folder.touch()


def with_a_damaged_list(folder: Path) -> None:
    folder.mkdir()
    (folder / ".rtarm").write_text("what?\n", encoding="utf-8")


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("make", [somebody_elses, a_file, with_a_list_that_leads_out, with_a_damaged_list])
def test_a_folder_that_is_not_ours_is_left_alone(make: Edit, force: bool, arm: ArmConfig, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("mine", encoding="utf-8")
    make(tmp_path / "episode1_moveit_config")
    assert "was not generated by rtarm; choose another folder" in refusal(arm, tmp_path, force=force)


def test_an_empty_folder_is_filled(arm: ArmConfig, tmp_path: Path) -> None:
    (tmp_path / "episode1_moveit_config").mkdir()
    assert write_package(arm, tmp_path).unchanged == 0


def test_places_that_cannot_be_used_are_said(arm: ArmConfig, tmp_path: Path) -> None:
    assert "nowhere does not exist; name an existing folder" in refusal(arm, tmp_path / "nowhere")
    file = tmp_path / "file"
    file.touch()
    assert "file is no folder; name an existing folder" in refusal(arm, file)
    write_package(arm, tmp_path)
    in_the_way = tmp_path / "episode1_moveit_config" / "package.xml"
    in_the_way.unlink()
    in_the_way.mkdir()
    assert f"{in_the_way} cannot be used (is a directory); choose another folder" in refusal(arm, tmp_path)


def test_an_arm_without_geometry_has_no_package(tmp_path: Path) -> None:
    sentence = refusal(load_arm("mock"), tmp_path)
    assert sentence.startswith("mock.yaml: mock has no section kinematics")
