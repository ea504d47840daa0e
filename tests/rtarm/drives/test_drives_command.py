"""`rtarm drives` as a person runs it: a process of its own, simulated drives behind a pseudo-terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from arm_files import edited
from stack import ROOT, Process, Stack, run_rtarm
from typer.testing import Result
from waiting import until
from written_arm import WrittenArm

from rtarm.drives.settings import plan, question, summary
from shm.files import DIRECTORY

PATIENCE_S = 120.0


@pytest.fixture
def simulated(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    """Drives that are switched on; no control process runs."""
    stack = Stack(arm_name, tmp_path)
    with edited(stack.arm_file) as values:
        for joint in values["joints"][:2]:
            joint["drive"]["current_ma"] = 2500
        values["bus"]["acknowledge"] = True
        values["control"]["rate_hz"] = 100
    stack.start_sim()
    yield stack
    stack.close()


def drives(stack: Stack, *options: str, typed: str = "") -> subprocess.CompletedProcess[str]:
    return run_rtarm("drives", str(stack.arm_file), *options, typed=typed)


def currents(result: subprocess.CompletedProcess[str]) -> list[int]:
    report = json.loads(result.stdout)
    return [s["found"] for drive in report["drives"] for s in drive["settings"] if s["name"] == "current_ma"]


@pytest.mark.process
def test_a_session_from_reading_to_flash(simulated: Stack) -> None:
    read = drives(simulated)
    assert read.returncode == 5
    assert read.stdout.count("3000 → 2500") == 2
    assert "2 settings to be written: --write" in read.stdout

    declined = drives(simulated, "--write", "--store", typed="n\n")
    assert declined.returncode == 1
    assert "joint1 (address 1): current_ma 3000 → 2500" in declined.stderr
    assert "Flash wears out" in declined.stderr and "Nothing was written." in declined.stderr
    assert drives(simulated, "--write", "--store").returncode == 1  # nobody answers the question
    assert currents(drives(simulated, "--json")) == [3000] * 6

    tried = drives(simulated, "--write")
    assert (tried.returncode, tried.stderr.count("written and read back")) == (0, 2)
    assert "Every drive is as the arm file wants it" in tried.stdout

    nothing = drives(simulated, "--write", "--store")
    assert nothing.returncode == 0 and "What a drive's flash holds cannot be read" in nothing.stderr

    for joint in ("joint1", "joint2"):
        simulated.befall(f"power-loss:joint={joint},at_s=0,off_s=0.01")
    stored = drives(simulated, "--write", "--store", "--json", typed="y\n")
    report = json.loads(stored.stdout)
    assert (stored.returncode, report["agrees"], report["joints"]) == (0, True, ["joint1", "joint2"])
    assert not list(DIRECTORY.glob(f"rtarm.{simulated.name}.*"))


@pytest.mark.process
def test_a_session_with_drives_that_keep_whatever_they_are_told(arm_name: str, tmp_path: Path) -> None:
    stack = Stack(arm_name, tmp_path, "myactuator6")
    try:
        stack.start_sim()
        read = drives(stack)
        assert read.returncode == 5 and "10000 → 201" in read.stdout and "X8S2V10" in read.stdout
        assert "12 settings to be written: --write --store writes flash, where alone drives have them." in read.stdout
        volatile = drives(stack, "--write")
        assert volatile.returncode == 5 and "is written with --write --store alone" in volatile.stderr
        assert "joint1 (address 1): acceleration_dps_s 10000 → 201, deceleration_dps_s 10000 → 201" in (
            drives(stack, "--write", "--store", typed="n\n").stderr
        )
        stored = drives(stack, "--write", "--store", "--json", typed="y\n")
        report = json.loads(stored.stdout)
        assert (stored.returncode, report["agrees"], len(report["joints"])) == (0, True, 6)
    finally:
        stack.close()


@pytest.mark.process
def test_an_adapter_that_goes_away_between_reading_and_writing(simulated: Stack) -> None:
    with closing(Process("rtloop.offline.settings", str(simulated.arm_file))) as process:
        process.line_with("ready")
        simulated.unplug()
        process.line_with(f"refused The adapter at {simulated.link} is gone")
        assert process.code() == 2


@pytest.mark.process
def test_an_adapter_that_goes_away_while_a_person_thinks(simulated: Stack) -> None:
    command = [sys.executable, "-m", "rtarm", "drives", str(simulated.arm_file), "--write", "--store"]
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, env=environment, text=True, **pipes) as asked:
        assert asked.stderr is not None
        while "Flash wears out" not in asked.stderr.readline():
            pass
        simulated.unplug()
        until(lambda: not list(DIRECTORY.glob(f"rtarm.{simulated.name}.*")), patience_s=PATIENCE_S)
        _, said = asked.communicate("y\n", timeout=PATIENCE_S)
    assert asked.returncode == 2 and f"The adapter at {simulated.link} is gone" in said


@pytest.mark.process
def test_the_wrong_bit_rate_is_a_bus_without_drives(simulated: Stack) -> None:
    simulated.change(bus={"bitrate": 250_000}, control={"rate_hz": 40})
    read = drives(simulated, "--json")
    report = json.loads(read.stdout)
    assert (read.returncode, report["agrees"]) == (5, False)
    for drive in report["drives"]:
        assert "does not answer" in drive["left_alone"][0] and "250000 bit/s" in drive["left_alone"][0]


@pytest.mark.process
def test_a_signal_ends_it_in_order(simulated: Stack) -> None:
    with closing(Process("rtloop.offline.settings", str(simulated.arm_file))) as process:
        process.line_with("ready")
        process.process.terminate()
        assert process.code() == 0
        assert not list(DIRECTORY.glob(f"rtarm.{simulated.name}.*"))


@pytest.mark.process
def test_ctrl_c_amid_a_write_says_which_drives_were_not_written(simulated: Stack) -> None:
    with edited(simulated.arm_file) as values:
        for joint in values["joints"]:
            joint["drive"].update(current_ma=2500, watchdog_ms=5000)
    command = [sys.executable, "-m", "rtarm", "drives", str(simulated.arm_file), "--write", "--store", "--json"]
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, env=environment, text=True, process_group=0, **pipes) as asked:
        assert asked.stdin is not None and asked.stderr is not None
        asked.stdin.write("y\n")
        asked.stdin.flush()
        assert any("joint1: written and read back" in line for line in asked.stderr)
        asked.send_signal(signal.SIGINT)
        out, said = asked.communicate(timeout=PATIENCE_S)
    report = json.loads(out)
    names = [f"joint{number}" for number in range(1, 7)]
    written = len(report["joints"])
    assert (asked.returncode, report["joints"]) == (5, names[:written]) and 0 < written < 6
    assert "no other is begun" in said
    assert said.endswith(f"Ended as asked: nothing was written to the drives of {', '.join(names[written:])}.\n")
    found = [s["found"] for drive in report["drives"] for s in drive["settings"] if s["name"] == "current_ma"]
    assert found == [2500] * written + [3000] * (6 - written)


def test_an_arm_that_runs_is_left_alone(arm: WrittenArm, arm_file: Path, rtarm: Callable[..., Result]) -> None:
    result = rtarm("drives", str(arm_file))
    assert result.exit_code == 2
    assert "this arm has one already: end that first" in result.stderr
    assert f"pid {os.getpid()}" in result.stderr


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (("--channel", "/dev/nowhere"), 2, "There is no serial port /dev/nowhere"),
        (("--channel", "/dev/null"), 2, "/dev/null is not a serial port"),
        (("--interface", "socketcan", "--channel", "nocan"), 2, "nocan"),
        (("--store",), 1, "give both, or neither"),
        (("--interface", "mock"), 1, "interface mock reaches no drives"),
    ],
)
def test_what_cannot_be_is_refused(
    arm_file: Path, rtarm: Callable[..., Result], options: tuple[str, ...], code: int, sentence: str
) -> None:
    result = rtarm("drives", str(arm_file), *options)
    assert (result.exit_code, sentence in result.stderr, result.stdout) == (code, True, "")


def test_a_refusal_as_json(arm_file: Path, rtarm: Callable[..., Result]) -> None:
    result = rtarm("drives", str(arm_file), "--json", "--channel", "/dev/nowhere")
    report = json.loads(result.stdout)
    assert (result.exit_code, report["agrees"]) == (2, False)
    assert "There is no serial port" in report["problems"][0]


def test_mock_drives_have_no_settings(rtarm: Callable[..., Result]) -> None:
    result = rtarm("drives", "mock")
    assert (result.exit_code, result.stderr) == (
        1,
        "Arm mock has mock drives and no bus, so there are no settings to read.\n",
    )


def setting(name: str, wanted: Any, found: Any, *, kept: bool = False) -> dict[str, Any]:
    return {"name": name, "wanted": wanted, "found": found, "verdict": "differs", "writable": True, "kept": kept}


def test_the_question_names_drive_setting_old_and_new_value() -> None:
    drive = {
        "joint": "elbow",
        "address": 3,
        "settings": [setting("current_ma", 2500, 3000), setting("firmware", "2.0.0", "1.2.5")],
        "to_write": ["current_ma"],
        "agrees": False,
    }
    report = {"drives": [drive]}
    assert plan(report) == ["elbow (address 3): current_ma 3000 → 2500"]
    assert "  elbow (address 3): current_ma 3000 → 2500" in question(report)
    assert summary(report).startswith("1 setting to be written")


@pytest.mark.parametrize(("wanted", "said"), [(None, "names nothing of what they tell"), ("off", "wants it")])
def test_drives_agree_with_a_file_that_names_something_of_them_alone(wanted: str | None, said: str) -> None:
    drive = {"joint": "elbow", "address": 3, "settings": [setting("response", wanted, "off")], "to_write": []}
    assert said in summary({"drives": [drive | {"agrees": True}]})


def test_what_was_written_and_not_stored_is_no_success(
    rtarm: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = {"joint": "joint1", "address": 1, "settings": [setting("heartbeat_ms", 200, 200)], "to_write": []}
    report = {"drives": [drive | {"agrees": True}], "failure": "The drive of joint1 (node_id 1) does not store."}
    monkeypatch.setattr("rtarm.drives.settings.run", lambda *_, **__: report)
    result = rtarm("drives", "cia402_6", "--write", "--store")
    assert (result.exit_code, result.stderr) == (5, f"{report['failure']}\n")
    assert "not all have stored that" in summary(report)


@pytest.mark.parametrize("kept", [False, True])
def test_nobody_is_sent_to_volatile_memory_that_a_drive_does_not_have(kept: bool) -> None:
    changed = setting("response", "off", "on", kept=kept)
    report = {"drives": [{"joint": "elbow", "address": 3, "settings": [changed], "to_write": ["response"]}]}
    said = " ".join(question(report))
    assert ("try it in volatile memory first" in said) is not kept
    assert ("may store all else" in said) is not kept
