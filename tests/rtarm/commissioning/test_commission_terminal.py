"""`rtarm commission` as a person runs it: at a terminal, beside a simulated drive."""

from __future__ import annotations

import json
import math
import os
import signal
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from arm_files import edited
from at_terminal import CTRL_C, PATIENCE_S, Terminal, rtarm_at_terminal
from stack import PATIENT, Stack, run_rtarm
from waiting import until

from config.loader import load_arm
from rtarm.recording.mcap_reader import read
from rtloop.kept import commissioned
from rtloop.kept.commissioned import PowerProof
from shm import files
from shm.files import DIRECTORY


@pytest.fixture
def bench(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    stack = Stack(arm_name, tmp_path)
    stack.start_sim()
    yield stack
    stack.close()


def flat(at: Terminal) -> str:
    """What was said, on one line."""
    return " ".join(at.said.split())


def no_process_left(stack: Stack) -> bool:
    return not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


@pytest.mark.process
def test_a_whole_bench_test_and_its_report(bench: Stack, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    with closing(rtarm_at_terminal("commission", str(bench.arm_file), "joint6", "-o", str(folder))) as at:
        at.reply("Ask it?", "y")
        at.read_until("answers: as documented.")
        at.reply("Ask it?", "n")
        at.read_until("reply delay is left out.")
        at.reply("Try it?", "y")
        at.read_until("fast targets: as documented.")
        at.reply("Try it?", "y")
        at.read_until("reports: as documented.")
        at.reply("Turn it?", "y")
        at.read_until("silence: as documented.")
        at.reply("Turn it?", "o")
        at.read_until("retarget: as documented.")
        bench.sim.say("stall:joint=joint6,at_s=0")
        at.reply("Is it clamped", "y")
        at.read_until("stall: as documented.")
        at.reply("Watch it while you switch it off and on?", "y")
        at.read_until("Switch the power of joint6's drive off now")
        bench.sim.say("power-loss:joint=joint6,at_s=0,off_s=3")
        at.read_until("It is silent.")
        at.read_until("power flag: as documented. read 0 before, seen 1 after the power cycle, cleared, read 0.")
        at.read_until("volatile settings: as documented.")
        at.read_until("proof of power (a silent drive keeps its reference): unlocked")
        at.read_until("This was a simulated drive")
        at.read_until("| zdt 2.0.0 | slcan | 8 | none | flag |")
        assert at.code() == 0
    assert no_process_left(bench)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["unlocked"] == dict.fromkeys(("proof of power", "fast targets", "reports", "healing"), True)
    assert report["simulated"] and report["record"]["firmware"] == "2.0.0" and len(report["findings"]) == 8
    assert "".join((folder / "report.txt").read_text(encoding="utf-8").split()) in "".join(at.said.split())
    assert commissioned.load(load_arm(bench.arm_file))[5].heals
    recording = read(folder / "recording.mcap").recording
    assert len(recording.frames) > 1000 and recording.arm == bench.name
    motions = bench.truth()
    assert all(np.ptp(motion.position_rad) == 0.0 for name, motion in motions.items() if name != "joint6")
    assert math.degrees(np.max(np.abs(motions["joint6"].position_rad))) <= 15.1


@pytest.mark.process
@pytest.mark.parametrize("how", ["Ctrl-C", "kill -9"])
def test_whatever_ends_it_amid_a_move_stops_it_and_leaves_what_was_found(
    bench: Stack, tmp_path: Path, how: str
) -> None:
    folder = tmp_path / "report"
    with closing(rtarm_at_terminal("commission", str(bench.arm_file), "joint5", "-o", str(folder))) as at:
        at.reply("Ask it?", "y")
        for question in ("Ask it?", "Try it?", "Try it?"):
            at.reply(question, "")
        at.reply("Turn it?", "y")
        until(lambda: abs(bench.truth()["joint5"].position_rad[-1]) > math.radians(1.0), patience_s=PATIENCE_S)
        if how == "Ctrl-C":
            at.press(CTRL_C)
            assert at.code() == 1
            assert "Ended early (SIGINT); the drive stands." in at.said
            report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
            assert [finding["check"] for finding in report["findings"]] == ["answers"]
        else:
            at.process.kill()
        at.process.wait(PATIENCE_S)
        until(lambda: no_process_left(bench), patience_s=PATIENCE_S)
    assert "answers: as documented" in (folder / "report.txt").read_text(encoding="utf-8")
    stood = bench.truth()["joint5"]
    assert stood.velocity_rad_s[-1] == 0.0 and 1.0 < abs(math.degrees(stood.position_rad[-1])) < 14.5


@pytest.mark.process
@pytest.mark.parametrize("how", ["Ctrl-C", "terminal gone"])
def test_a_drive_that_falls_silent_amid_a_move_is_not_said_to_stand(bench: Stack, tmp_path: Path, how: str) -> None:
    with closing(rtarm_at_terminal("commission", str(bench.arm_file), "joint5", "-o", str(tmp_path / "report"))) as at:
        at.reply("Ask it?", "y")
        for question in ("Ask it?", "Try it?", "Try it?"):
            at.reply(question, "")
        at.reply("Turn it?", "y")
        until(lambda: abs(bench.truth()["joint5"].position_rad[-1]) > math.radians(1.0), patience_s=PATIENCE_S)
        bench.befall("silent:joint=joint5,at_s=0,until_s=30")
        if how == "Ctrl-C":
            at.press(CTRL_C)
            assert at.code() == 2
            assert "use the switch in the power line" in flat(at) and "the drive stands" not in flat(at)
        else:
            at.hang_up()
            assert at.process.wait(PATIENCE_S) == 2
    text = (tmp_path / "report" / "report.txt").read_text(encoding="utf-8")
    assert "Ended early" in text and "use the switch in the power line" in text


@pytest.mark.process
def test_what_is_refused_leaves_nothing_behind(bench: Stack, tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.mkdir()
    (there / "mine").write_text("mine")
    taken = run_rtarm("commission", str(bench.arm_file), "joint6", "-o", str(there))
    assert taken.returncode == 1 and "for the report cannot be made (File exists): give another with -o" in taken.stderr
    assert (there / "mine").read_text() == "mine"
    folder = tmp_path / "report"
    piped = run_rtarm("commission", str(bench.arm_file), "joint6", "-o", str(folder), typed="y\n" * 50)
    assert piped.returncode == 1 and "answers are taken from a terminal alone" in piped.stderr
    bench.befall("silent:joint=joint6,at_s=0")
    assert not folder.exists() and no_process_left(bench)
    silent = run_rtarm("commission", str(bench.arm_file), "joint6", "-o", str(folder))
    assert silent.returncode == 5 and no_process_left(bench)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert [(one["check"], one["verdict"]) for one in report["findings"]] == [("answers", "differs")]
    assert "joint6" in report["findings"][0]["came"] and (folder / "recording.mcap").exists()


def test_a_joint_that_is_none_and_an_arm_without_a_bus() -> None:
    assert "has no joint 'elbow'; it has joint1" in run_rtarm("commission", "episode1", "elbow").stderr
    assert "has mock drives and no bus" in run_rtarm("commission", "mock", "joint1").stderr


@pytest.mark.process
def test_a_drive_that_was_limp_before_and_nobody_wanted_held_is_well_at_the_end(bench: Stack, tmp_path: Path) -> None:
    bench.befall("disabled:joint=joint5,at_s=0")
    with closing(rtarm_at_terminal("commission", str(bench.arm_file), "joint5", "-o", str(tmp_path / "report"))) as at:
        at.reply("joint5 is limp", "n")
        at.reply("Ask it?", "y")
        at.read_until("answers: as documented.")
        at.reply("Ask it?", "q")
        assert at.code() == 1
        assert "Ended early (you ended it); the drive stands." in flat(at) and "use the switch" not in flat(at)


@pytest.fixture
def led(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    stack = Stack(arm_name, tmp_path, "damiao6", start_deg=(0.0, 10.0, 0.0, 0.0, 0.0, 0.0))
    with edited(stack.arm_file) as values:
        values["joints"][1]["drive"]["encoder"] = "incremental"
        values.setdefault("limits", {})["front_timeout_s"] = PATIENT["front_timeout_s"]
    stack.start_sim()
    yield stack
    stack.close()


@pytest.mark.process
def test_a_whole_bench_test_of_a_drive_that_is_led(led: Stack, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(folder))) as at:
        at.reply("Bring it up?", "y")
        at.read_until("answers: as documented.")
        at.reply("Listen to it?", "y")
        at.read_until("reply delay: ")
        at.reply("Turn it?", "o")
        at.read_until("retarget: as documented.")
        at.reply("Turn it?", "y")
        at.read_until("silence: as documented.")
        at.reply("Is it clamped", "n")
        at.read_until("stall is left out.")
        at.reply("Watch it while you pull its CAN plug", "y")
        at.read_until("Pull the CAN plug of joint2's drive now")
        led.sim.say("silent:joint=joint2,at_s=0,until_s=3")
        at.read_until("It is silent.")
        at.reply("Is it back in", "y")
        at.reply("Shall that be cleared", "y")
        at.read_until("unplugged: as documented. its angle was kept")
        at.reply("Turn it, and watch it while you switch it off and on?", "o")
        at.read_until("Switch the power of joint2's drive off now")
        led.sim.say("power-loss:joint=joint2,at_s=0,off_s=3")
        at.read_until("It is silent.")
        at.reply("Was it dark", "y")
        at.reply("joint2 is limp, and is enabled where it stands", "y")
        at.read_until("power cycle: as documented. its angle was lost")
        at.read_until("healing (the arm clears by itself the fault of a short silence of all drives): unlocked")
        at.read_until("| damiao  | slcan | 6 | none | canary |")
        assert at.code() == 0
    assert no_process_left(led)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["unlocked"] == {"proof of power": True, "healing": True} and report["simulated"]
    assert commissioned.load(load_arm(led.arm_file))[1].heals
    assert len(read(folder / "recording.mcap").recording.frames) > 1000
    motions = led.truth()
    assert all(np.ptp(motion.position_rad) == 0.0 for name, motion in motions.items() if name != "joint2")
    moved_deg = np.abs(np.degrees(motions["joint2"].position_rad) - 10.0)
    assert 14.5 < np.max(moved_deg) < 15.5


@pytest.mark.process
@pytest.mark.parametrize("how", ["Ctrl-C", "kill -9"])
def test_whatever_ends_it_a_drive_that_is_led_stands(led: Stack, tmp_path: Path, how: str) -> None:
    folder = tmp_path / "report"
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(folder))) as at:
        at.reply("Bring it up?", "y")
        at.reply("Listen to it?", "")
        at.reply("Turn it?", "")
        at.reply("Turn it?", "y")
        until(lambda: abs(led.truth()["joint2"].position_rad[-1] - math.radians(10.0)) > 0.1, patience_s=PATIENCE_S)
        if how == "Ctrl-C":
            at.press(CTRL_C)
            assert at.code() == 1
            report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
            assert "Ended early (SIGINT); the drive stands." in at.said
        else:
            at.process.kill()
            at.process.wait(PATIENCE_S)
            report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        assert [finding["check"] for finding in report["findings"]] == ["answers"]
        at.process.wait(PATIENCE_S)
        until(lambda: no_process_left(led), patience_s=PATIENCE_S)
    assert led.truth()["joint2"].velocity_rad_s[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.process
def test_a_proof_that_fails_is_known_although_the_bench_test_is_killed(led: Stack, tmp_path: Path) -> None:
    """The person pulls the plug that carries power, too: its angle is lost where its family keeps it."""
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(tmp_path / "report"))) as at:
        at.reply("Bring it up?", "y")
        at.reply("Listen to it?", "")
        for question in ("Turn it?", "Turn it?", "Is it clamped"):
            at.reply(question, "")
        at.reply("Watch it while you pull its CAN plug", "y")
        at.read_until("Pull the CAN plug of joint2's drive now")
        led.befall("power-loss:joint=joint2,at_s=0,off_s=3")
        at.read_until("It is silent.")
        at.reply("Is it back in", "y")
        at.reply("joint2 is limp, and is enabled where it stands", "y")
        at.read_until("unplugged: differs. its angle was lost")
        at.process.kill()
        at.process.wait(PATIENCE_S)
    until(lambda: no_process_left(led), patience_s=PATIENCE_S)
    assert commissioned.load(load_arm(led.arm_file))[1].power_proof is PowerProof.NONE


@pytest.mark.process
def test_a_drive_that_is_not_brought_up_is_told_in_a_report(led: Stack, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    led.befall("silent:joint=joint2,at_s=0")
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(folder))) as at:
        at.reply("Bring it up?", "y")
        at.read_until("answers: differs.")
        at.read_until("does not answer on its master_id")
        assert at.code() == 5
    assert no_process_left(led)
    assert "answers: differs" in (folder / "report.txt").read_text(encoding="utf-8")
    assert len(read(folder / "recording.mcap").recording.frames) > 0


@pytest.mark.process
def test_a_drive_that_was_not_seen_to_stand_is_not_said_to(led: Stack, tmp_path: Path) -> None:
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(tmp_path / "report"))) as at:
        at.reply("Bring it up?", "y")
        for question in ("Listen to it?", "Turn it?", "Turn it?", "Is it clamped"):
            at.reply(question, "")
        at.reply("Watch it while you pull its CAN plug", "y")
        at.read_until("Pull the CAN plug of joint2's drive now")
        led.sim.say("silent:joint=joint2,at_s=0,until_s=30")
        at.read_until("It is silent.")
        at.press(CTRL_C)
        assert at.code() == 2
        assert "The drive of joint2 did not answer at the end. The drive was not seen to stand: use" in flat(at)
        assert "the drive stands" not in at.said
    assert not list(Path(tempfile.gettempdir()).glob(f"rtarm-led-{led.name}-*"))


@pytest.mark.process
def test_a_control_process_that_is_killed_says_nothing_of_the_drive(led: Stack, tmp_path: Path) -> None:
    with closing(rtarm_at_terminal("commission", str(led.arm_file), "joint2", "-o", str(tmp_path / "report"))) as at:
        at.reply("Bring it up?", "y")
        at.reply("Listen to it?", "")
        at.reply("Turn it?", "y")
        until(lambda: abs(led.truth()["joint2"].position_rad[-1] - math.radians(10.0)) > 0.1, patience_s=PATIENCE_S)
        with closing(files.open_state(led.name)) as state:
            os.kill(int(state.record["header"]["pid"]), signal.SIGKILL)
        assert at.code() == 3
        assert "ended by SIGKILL. The drive was not seen to stand" in flat(at)


@pytest.mark.process
def test_a_running_arm_is_refused_before_any_question_and_keeps_its_marks(led: Stack, tmp_path: Path) -> None:
    led.start_loop()
    refused = run_rtarm("commission", str(led.arm_file), "joint2", "-o", str(tmp_path / "report"))
    assert refused.returncode == 2 and "this arm has one already: end that first" in refused.stderr
    assert "Bring it up?" not in refused.stdout and not (tmp_path / "report").exists()
