"""`make env`: the steps that make the environment, from a complete lock, with wheels and beside an installation."""

from __future__ import annotations

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from programs import ROOT, program

from rtarm.launch.steps import Step, StepFailed, run

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


environment = program("environment")


def pins(steps: Iterable[Step]) -> set[str]:
    """Names of all packages that some steps install."""
    return {
        argument.partition("==")[0]
        for step in steps
        for command in step.commands
        for argument in command
        if "==" in argument
    }


def steps_for(purpose: str, *, sourced: bool) -> list[Step]:
    steps = environment.steps_of(Path("/env"), sourced)
    wanted = environment.with_needs(environment.PURPOSES[purpose], steps)
    return [step for step in steps if step.name in wanted]


def needed(requirements: Iterable[str]) -> set[str]:
    """Names of what requirements lead to, as what is installed here says."""
    found: set[str] = set()
    waiting = [Requirement(line) for line in requirements if not line.startswith("rtarm[")]
    while waiting:
        here = waiting.pop()
        if here.marker is not None and not any(here.marker.evaluate({"extra": of}) for of in ("", *here.extras)):
            continue
        found.add(canonicalize_name(here.name))
        for line in importlib.metadata.requires(here.name) or []:
            of = Requirement(line)
            holds = of.marker is None or any(of.marker.evaluate({"extra": extra}) for extra in ("", *here.extras))
            if holds and canonicalize_name(of.name) not in found:
                of.marker = None
                waiting.append(of)
    return found


@pytest.mark.skipif(bool(os.environ.get("ROS_DISTRO")), reason="the wheels are not installed")
def test_the_lock_has_everything_that_each_purpose_needs() -> None:
    extras = PROJECT["optional-dependencies"]
    demo = needed([*PROJECT["dependencies"], *extras["ros"]])
    assert demo <= pins(steps_for("demo", sourced=False))
    everything = needed([*PROJECT["dependencies"], *(line for extra in extras.values() for line in extra)])
    assert everything <= pins(steps_for("all", sourced=False))


def test_beside_a_sourced_ros_the_wheels_are_left_out_and_nothing_else() -> None:
    extras = {name: lines for name, lines in PROJECT["optional-dependencies"].items() if name != "ros"}
    wanted = needed([*PROJECT["dependencies"], *(line for extra in extras.values() for line in extra)])
    installed = pins(steps_for("all", sourced=True))
    assert wanted <= installed
    assert not [name for name in installed if name.startswith("ros-")]


def test_pip_looks_for_nothing() -> None:
    installs = [c for s in steps_for("all", sourced=False) for c in s.commands if "install" in c]
    assert installs and all("--no-deps" in command for command in installs)


def test_each_stamp_stands_for_what_its_step_is_made_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def stamps(origin: str = "3.11") -> dict[str, str]:
        steps = environment.steps_of(Path("/env"), sourced=False)
        return dict(environment.stamps_of(steps, origin))

    def changed(since: dict[str, str], origin: str = "3.11") -> set[str]:
        return {name for name, stamp in stamps(origin).items() if stamp != since[name]}

    monkeypatch.setattr(environment, "ROOT", tmp_path)
    monkeypatch.setattr(environment, "LOCK", tmp_path / "constraints.txt")
    sections = {name: f"# --- {name}: x\n{name}==1\n" for name in ("cycle", "rtarm", "ros", "tools")}
    (tmp_path / "constraints.txt").write_text("\n".join(sections.values()))
    before = stamps()
    assert changed(before) == set()
    assert changed(before, "3.12") == set(before)
    (tmp_path / "rtloop").mkdir()
    (tmp_path / "rtloop" / "new.py").touch()
    assert changed(before) == {"cycle", "functions"}
    before = stamps()
    (tmp_path / "constraints.txt").write_text("\n".join(sections.values()).replace("tools==1", "tools==2"))
    assert changed(before) == {"tools"}


def test_what_pip_was_killed_amid_is_not_taken_for_there(tmp_path: Path) -> None:
    packages = tmp_path / "lib" / "python3.11" / "site-packages"
    for name, files in (("whole", ("METADATA", "INSTALLER", "RECORD")), ("half", ("METADATA", "RECORD"))):
        (packages / f"{name}-1.dist-info").mkdir(parents=True)
        for file in files:
            (packages / f"{name}-1.dist-info" / file).touch()
    environment.forget_half_installed(tmp_path)
    assert [found.name for found in packages.iterdir()] == ["whole-1.dist-info"]


# --- steps ----------------------------------------------------------------------------------------------


def python(program: str) -> list[str]:
    return [sys.executable, "-c", program]


def numberless(lines: Iterable[str]) -> list[str]:
    return [re.sub(r"\d+ s", "N s", line) for line in lines]


def test_steps_that_do_not_need_each_other_run_at_the_same_time(tmp_path: Path) -> None:
    """Each of two opens a pipe that only the other one opens too."""
    pipe = str(tmp_path / "pipe")
    os.mkfifo(pipe)
    steps = [
        Step("first", "one", 1.0, [python("")]),
        Step("reads", "two", 1.0, [python(f"open({pipe!r}).read()")], needs=["first"]),
        Step("writes", "three", 1.0, [python(f"open({pipe!r}, 'w')")], needs=["first"]),
    ]
    said: list[str] = []
    run(steps, said.append)
    assert numberless(said[:2]) == ["step 1 of 3: one, about N s …", "step 1 of 3: one, N s"]
    assert set(numberless(said[4:])) == {"step 2 of 3: two, N s", "step 3 of 3: three, N s"}


def test_a_step_that_fails_ends_the_others_and_says_why(tmp_path: Path) -> None:
    pipe = str(tmp_path / "pipe")
    os.mkfifo(pipe)
    done: list[str] = []
    steps = [
        Step("good", "one", 1.0, [python("")]),
        Step("fails", "two", 1.0, [python("print('the reason'); exit(3)")], needs=["good"]),
        Step("hangs", "three", 1.0, [python(f"open({pipe!r}).read()")]),
        Step("never", "four", 1.0, [python("")], needs=["fails"]),
    ]
    with pytest.raises(StepFailed) as failed:
        run(steps, lambda _: None, lambda step, _: done.append(step.name))
    reason, sentence = str(failed.value).splitlines()
    assert reason == "the reason"
    assert sentence.startswith("Step 2 of 4 (two) failed")
    assert done == ["good"]
    with pytest.raises(OSError, match="No such device"):  # the one that waited for a writer is gone
        os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)


def test_a_python_that_is_too_old_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.sys, "version_info", (3, 10, 1))
    assert "rtarm needs Python 3.11 to 3.13" in environment.refusal()


def test_where_ros_has_no_wheels_a_purpose_that_needs_ros_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.platform, "machine", lambda: "aarch64")
    why = environment.lacks_ros("all", False)
    assert "no wheels for aarch64" in why and "source a ROS 2 Jazzy installation" in why
    assert environment.lacks_ros("all", True) is None
    assert environment.lacks_ros("control", False) is None
    monkeypatch.setattr(environment.platform, "machine", lambda: "x86_64")
    assert environment.lacks_ros("all", False) is None


def test_what_a_processor_has_no_wheels_of_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a marker in the lock where a package says so itself, else by name."""
    monkeypatch.setattr(environment.platform, "machine", lambda: "aarch64")
    wanted = [Requirement(pin) for step in steps_for("control", sourced=False) for pin in argued(step)]
    names = {of.name for of in wanted if of.marker is None or of.marker.evaluate({"platform_machine": "aarch64"})}
    assert names >= {"numba", "pydantic-core", "mcap", "pytest"}
    assert not names & {"embreex", "toppra"}
    assert not [name for name in names if name.startswith("ros-")]


def argued(step: Step) -> list[str]:
    return [argument for command in step.commands for argument in command if "==" in argument]


def test_an_interrupted_or_repeated_call_does_only_what_is_missing(tmp_path: Path) -> None:
    """The program itself, where all but one step has a stamp that is right."""
    venv = tmp_path / "env"
    (venv / "stamps").mkdir(parents=True)
    steps = environment.steps_of(venv, False)
    stamps = environment.stamps_of(steps, f"{sys.version} False")
    for step in steps:
        (venv / "stamps" / step.name).write_text(stamps[step.name])
    (venv / "bin").mkdir()
    (venv / "bin" / "python").write_text("#!/bin/sh\necho no compiler; exit 1\n")
    (venv / "bin" / "python").chmod(0o755)
    command = [sys.executable, "packaging/environment.py", "demo", "--venv", str(venv)]
    plain = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"}

    def called() -> tuple[int, str]:
        ended = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True, check=False)
        return ended.returncode, ended.stderr

    assert called() == (0, "")
    (venv / "stamps" / "cycle").unlink()
    code, said = called()
    assert code == 1
    assert numberless(said.splitlines()[-3:-1]) == ["step 1 of 1: the control cycle, about N s …", "no compiler"]
    assert said.splitlines()[-1].startswith("Step 1 of 1 (the control cycle) failed")
