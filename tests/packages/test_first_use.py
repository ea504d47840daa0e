"""Message types that are made at first use: once, whole, for any number of users, and never beside a sourced ROS."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtarm import processes
from rtarm.console.errors import Refusal
from rtarm.launch import first_use, plan
from rtarm.processes import WHEELS_GUARD, ros_environment
from rtarm_interfaces import build

ROOT = Path(__file__).resolve().parents[2]
USERS = 4

MAKER = """
import sys
from pathlib import Path
from rtarm_interfaces import build

def made(package, place):
    with open(sys.argv[1], "a") as log:
        log.write(f"{package.name}\\n")
    folder = place.python / package.name
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()

build.lacking = lambda: list(build.PACKAGES)
build.check_wheels = build.check_tools = lambda *_: None
build.compile_into = made
assert build.ensure()
assert all((build.cache().python / package.name / "__init__.py").exists() for package in build.PACKAGES)
print(build.cache().prefix)
"""
"""A first use, but for the compiler; what it compiles is written down."""


@pytest.fixture(autouse=True)
def fresh_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(first_use, "COMPILER", ("-c", ""))
    build.cache.cache_clear()
    yield tmp_path / "cache" / "rtarm"
    build.cache.cache_clear()


def user(log: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), WHEELS_GUARD: "1"}
    return subprocess.Popen(
        [sys.executable, "-c", MAKER, log], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_first_uses_at_the_same_time_make_everything_once(fresh_cache: Path, tmp_path: Path) -> None:
    left = fresh_cache / "interfaces-killed.new"
    left.mkdir(parents=True)
    users = [user(tmp_path / "log") for _ in range(USERS)]
    said = [each.communicate() for each in users]
    assert [each.returncode for each in users] == [0] * USERS, said
    assert (tmp_path / "log").read_text().split() == [package.name for package in build.PACKAGES]
    assert len({out for out, _ in said}) == 1
    assert sum("generating them into" in err for _, err in said) == 1
    assert [path.name for path in fresh_cache.iterdir()] == [build.cache().prefix.name]


def test_nothing_is_made_where_the_environment_has_everything(fresh_cache: Path) -> None:
    pytest.importorskip("control_msgs")
    assert build.ensure() is False
    assert not fresh_cache.exists()


def test_nothing_is_made_beside_a_sourced_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "from_wheels", lambda: False)
    monkeypatch.setattr(build, "installed_elsewhere", lambda _: None)
    monkeypatch.setattr(build, "is_current", lambda _: False)
    assert build.lacking() == []


def lacking_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "lacking", lambda: list(build.PACKAGES))
    monkeypatch.setattr(build, "check_wheels", lambda _: None)
    monkeypatch.setattr(build, "check_tools", lambda *_: "Ninja")


def test_the_cycle_is_compiled_while_messages_are_generated(
    monkeypatch: pytest.MonkeyPatch, fresh_cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each of both waits for the other to have begun."""
    lacking_everything(monkeypatch)
    there, here = tmp_path / "there", tmp_path / "here"
    os.mkfifo(there)
    os.mkfifo(here)
    monkeypatch.setattr(
        first_use, "COMPILER", ("-c", f"open({str(there)!r}, 'w').close(); open({str(here)!r}).close()")
    )

    def meet(package: build.Package, place: build.Place) -> None:
        if package == build.CONTROL_MSGS:
            there.open().close()
            here.open("w").close()
        (place.python / package.name).mkdir(parents=True)

    monkeypatch.setattr(build, "compile_into", meet)
    plan.check_ros()
    said = re.sub(r"\d+ s", "N s", capsys.readouterr().err)
    for step in ("step 1 of 2: ROS messages", "step 2 of 2: the control cycle"):
        assert f"{step}, about N s …\n" in said and f"{step}, N s\n" in said


@pytest.mark.parametrize(("machine", "remedy"), [("x86_64", "make env"), ("aarch64", "no wheels for aarch64")])
def test_where_rclpy_is_missing_what_can_be_done_there_is_said(
    monkeypatch: pytest.MonkeyPatch, machine: str, remedy: str
) -> None:
    monkeypatch.setattr(plan, "has_module", lambda _: False)
    monkeypatch.setattr(plan.platform, "machine", lambda: machine)
    with pytest.raises(Refusal) as refused:
        plan.check_ros()
    assert remedy in str(refused.value)


def test_what_fails_ends_the_compiler_beside_it(monkeypatch: pytest.MonkeyPatch, fresh_cache: Path) -> None:
    lacking_everything(monkeypatch)
    monkeypatch.setattr(first_use, "COMPILER", ("-c", "import time; time.sleep(1000)"))

    def fail(package: build.Package, place: build.Place) -> None:
        raise build.BuildError("no")

    monkeypatch.setattr(build, "compile_into", fail)
    with pytest.raises(Refusal):
        plan.check_ros()


def test_a_cache_that_cannot_be_written_is_one_sentence(monkeypatch: pytest.MonkeyPatch, fresh_cache: Path) -> None:
    lacking_everything(monkeypatch)
    fresh_cache.parent.write_text("a file", encoding="utf-8")
    with pytest.raises(Refusal) as refused:
        plan.check_ros()
    assert str(refused.value).startswith(f"{fresh_cache} cannot be written (Not a directory)")
    assert "XDG_CACHE_HOME" in str(refused.value)


def test_a_missing_compiler_is_said_before_anything_is_made(monkeypatch: pytest.MonkeyPatch, fresh_cache: Path) -> None:
    checked = build.check_tools
    lacking_everything(monkeypatch)
    monkeypatch.setattr(build, "check_tools", checked)
    monkeypatch.setattr(build, "find_program", lambda *_: None)
    with pytest.raises(Refusal) as refused:
        plan.check_ros()
    assert "apt-get install gcc g++" in str(refused.value)
    assert not fresh_cache.exists()


def test_what_fails_leaves_nothing_behind(
    monkeypatch: pytest.MonkeyPatch, fresh_cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lacking_everything(monkeypatch)

    def fail(package: build.Package, place: build.Place) -> None:
        place.python.mkdir(parents=True)
        raise build.CommandFailed(package, "the compilation", "out of memory")

    monkeypatch.setattr(build, "compile_into", fail)
    with pytest.raises(Refusal) as refused:
        plan.check_ros()
    assert str(refused.value).splitlines()[0] == "out of memory"
    assert "the compilation failed" in str(refused.value)
    assert list(fresh_cache.iterdir()) == []
    assert "generating them into" in capsys.readouterr().err


NO_SPACE = "[Errno 28] No space left on device: '/made'"


def full(*_: object, **__: object) -> None:
    """What `copytree` says where the disk is full: an OSError without a number, around those of the files."""
    raise shutil.Error([("share/a", "/made/a", NO_SPACE), ("share/b", "/made/b", NO_SPACE)])


def test_a_full_disk_at_first_use_is_one_sentence(monkeypatch: pytest.MonkeyPatch, fresh_cache: Path) -> None:
    lacking_everything(monkeypatch)
    monkeypatch.setattr(build.shutil, "copytree", full)
    with pytest.raises(Refusal) as refused:
        plan.check_ros()
    assert str(refused.value).startswith(f"{fresh_cache} cannot be written ({NO_SPACE})")
    assert list(fresh_cache.iterdir()) == []


def test_a_full_disk_of_the_environment_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build, "make", full)
    assert build.main() == 1
    said = capsys.readouterr().err
    assert said.startswith("control_msgs cannot be generated because a file in ") and said.count("\n") == 1
    assert NO_SPACE in said and "TMPDIR" in said


def test_everything_that_is_missing_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(build.sysconfig, "get_path", lambda _: str(tmp_path))
    with pytest.raises(build.BuildError) as error:
        build.check_tools(build.CONTROL_MSGS, str(tmp_path))
    assert "`apt-get install gcc g++ python3-dev`" in str(error.value)


def test_an_interrupted_command_is_ended_with_all_it_started(tmp_path: Path) -> None:
    """What it started holds a lock, which is to be had once that is gone."""

    class Enough(Exception):
        pass

    def enough(_: float) -> None:
        raise Enough

    script = "exec 9>$0; flock 9; sleep 1000 & echo '[ 1/20] compiling'; wait"
    with pytest.raises(Enough):
        build.run(build.CONTROL_MSGS, "x", ["bash", "-c", script, str(tmp_path / "lock")], os.environ, enough)
    with (tmp_path / "lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)


@pytest.mark.parametrize(("said", "share"), [("[ 3/12] a", 0.25), ("[ 50%] b", 0.5)])
def test_how_far_it_is_is_read_from_what_the_tools_say(said: str, share: float) -> None:
    heard: list[float] = []
    build.run(build.CONTROL_MSGS, "x", ["echo", f"{said}"], os.environ, heard.append)
    assert heard == [share]


@pytest.mark.parametrize("made", [True, False])
def test_ros_children_find_what_was_made(made: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    lacking_everything(monkeypatch)
    if made:
        build.cache().prefix.mkdir(parents=True)
    environment = ros_environment()
    first = {name: environment.get(name, "").split(os.pathsep)[0] for name in ("PYTHONPATH", "LD_LIBRARY_PATH")}
    assert (first["PYTHONPATH"] == str(build.cache().python)) == made
    assert (first["LD_LIBRARY_PATH"] == str(build.cache().prefix / "lib")) == made


def test_a_sourced_ros_goes_before_wheels_that_are_installed_too(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As after `pip install rtarm` beside /opt/ros: the wheels' start-up file has run, their rclpy is not taken."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    wheels = Path(processes.sysconfig.get_path("data")) / "lib"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{wheels}{os.pathsep}/opt/ros/jazzy/lib")
    monkeypatch.delenv(WHEELS_GUARD, raising=False)
    environment = ros_environment()
    assert environment["LD_LIBRARY_PATH"] == "/opt/ros/jazzy/lib"
    assert environment[WHEELS_GUARD] == "1"


def test_in_site_packages_ours_do_not_go_before_a_sourced_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "ROOT", Path(processes.sysconfig.get_path("purelib")))
    monkeypatch.setenv("PYTHONPATH", "/opt/ros/jazzy/python")
    assert processes.plain_environment()["PYTHONPATH"] == "/opt/ros/jazzy/python"
