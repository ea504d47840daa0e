"""`make test-arm64`: what it says where it cannot run, and what it reads of the page; it runs itself by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from programs import ROOT, program

arm64 = program("arm64")
WHOLE = "enabled\ninterpreter /usr/libexec/qemu-binfmt/aarch64-binfmt-P\nflags: PF\noffset 0\n"


@pytest.fixture(autouse=True)
def whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A machine that lacks nothing; the file that says what the kernel does with ARM64 programs."""
    found = tmp_path / "qemu-aarch64"
    found.write_text(WHOLE, encoding="ascii")
    monkeypatch.setattr(arm64, "BINFMT", found)
    monkeypatch.setattr(arm64.os, "geteuid", lambda: 0)
    monkeypatch.setattr(arm64.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(arm64, "USERLAND", tmp_path / "userland")
    return found


def test_what_is_missing_is_one_sentence(monkeypatch: pytest.MonkeyPatch, whole: Path) -> None:
    assert arm64.refusal() is None
    whole.write_text(WHOLE.replace("PF", "P"), encoding="ascii")
    assert "lacks the flag F" in arm64.refusal()
    whole.write_text(WHOLE.replace("enabled", "disabled"), encoding="ascii")
    assert "update-binfmts --enable qemu-aarch64" in arm64.refusal()
    whole.unlink()
    assert "apt-get install qemu-user-static binfmt-support" in arm64.refusal()
    monkeypatch.setattr(arm64.shutil, "which", lambda _: None)
    assert "apt-get install debootstrap" in arm64.refusal()
    monkeypatch.setattr(arm64.os, "geteuid", lambda: 1000)
    assert "as root" in arm64.refusal()


def test_a_folder_with_something_else_in_it_stays_as_it_is() -> None:
    arm64.USERLAND.mkdir()
    (arm64.USERLAND / "letter.txt").touch()
    with pytest.raises(arm64.Failed, match="holds something else"):
        arm64.make_userland()
    assert (arm64.USERLAND / "letter.txt").exists()


def test_a_command_that_fails_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm64, "APART", ())  # which root alone may do
    with pytest.raises(arm64.Failed, match="ended with code 3"):
        arm64.run(["sh", "-c", "exit 3"])


def test_the_tree_goes_in_with_its_times() -> None:
    arm64.copy_tree()
    copied = arm64.USERLAND / "opt" / "rtarm" / "rtloop" / "warm.py"
    assert copied.stat().st_mtime == (ROOT / "rtloop" / "warm.py").stat().st_mtime


def test_the_page_is_typed_as_it_stands() -> None:
    typed = arm64.commands_of_page()
    assert "pip install --constraint dist/constraints.txt dist/rtarm-*.whl" in typed
    assert [line for line in typed if arm64.SERVES.match(line)] == ["python -m rtloop mock"]
    assert not any("ros-jazzy" in line for line in typed)


def test_the_page_names_every_package_of_ros_that_the_front_imports() -> None:
    imports = re.compile(r"^\s*(?:from|import) (\w+)", re.MULTILINE)
    names = {name for path in (ROOT / "rosfront").rglob("*.py") for name in imports.findall(path.read_text("utf-8"))}
    of_ros = {name for name in names if name.endswith(("_msgs", "_srvs", "_interfaces"))} - {"rtarm_interfaces"}
    section = arm64.INSTALL.read_text(encoding="utf-8").partition("### What a ROS installation must bring")[2]
    assert {name for name in of_ros if name not in section.partition("\n### ")[0]} == set()


def test_every_test_that_is_left_out_is_there() -> None:
    for test in arm64.LEFT_OUT:
        path, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8"), test
