"""`rtarm calibrate` as a person runs it: at a terminal, beside simulated drives whose joint is built otherwise."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from arm_files import edited
from at_terminal import CTRL_C, PATIENCE_S, Terminal, rtarm_at_terminal
from stack import Stack, run_rtarm
from waiting import until

from config.loader import load_arm
from shm.files import DIRECTORY


@pytest.fixture
def truth(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    """Drives that are switched on; joint6 is built otherwise than episode1's."""
    stack = Stack(arm_name, tmp_path, start_deg=[0, 0, 0, 0, 0, -20])
    with edited(stack.arm_file) as values:
        values["joints"][5].update(ratio=2, direction=-1, zero_deg=25)
    stack.start_sim()
    yield stack
    stack.close()


@pytest.fixture
def mine(truth: Stack, tmp_path: Path) -> Path:
    """The person's file: the true one but for joint6, with comments."""
    values = yaml.safe_load(truth.arm_file.read_text(encoding="utf-8"))
    values["joints"][5].update(ratio=1, direction=1, zero_deg=30)
    path = tmp_path / "mine.yaml"
    path.write_text("# my arm\n" + yaml.safe_dump(values) + "# its end\n", encoding="utf-8")
    return path


def no_process_left(stack: Stack) -> bool:
    return not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


@pytest.mark.process
def test_a_session_from_direction_to_file(truth: Stack, mine: Path) -> None:
    before = mine.read_text(encoding="utf-8")
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint6")) as at:
        at.read_until("The file says: direction 1, ratio 1, zero_deg 30.")
        at.read_until("turns by +7.5° at 1 rpm")
        at.reply("Turn it?", "y")
        at.reply("Which way did joint6 go?", "n")
        at.reply("Was that the opposite way?", "y")
        at.read_until("direction: -1; the file says 1.")
        at.reply("How shall joint6 get to the mark?", "d")
        at.reply("it is on the first mark", "y")
        for _ in range(3):
            at.reply("it is on the second mark", "15")
            at.read_until("turns by -15.0° at 1 rpm")
            at.reply("Turn it?", "y")
        at.reply("it is on the second mark", "y")
        at.reply("By how many degrees", "22.5")
        at.read_until("the ratio is 1.995 ± 0.09")
        at.reply("Take 2 (the only whole number that fits)?", "y")
        at.reply("Its drive says that it has been homed. Is that so", "y")
        at.reply("How shall joint6 get to the mark?", "d")
        at.reply("it is on its mark", "y")
        at.reply("At how many degrees", "2.5")
        at.reply("Take 24.9", "y")
        at.read_until("lower_deg in the file is -30: a goal beyond the stop would press the joint against it.")
        at.reply("for lower_deg?", "y")
        at.read_until("lower_deg: -24.9")
        at.read_until("+  zero_deg: 24.9")
        assert mine.read_text(encoding="utf-8") == before
        at.reply(f"Write this to {mine}?", "y")
        at.read_until(f"Written to {mine}: joint6 (direction: -1, ratio: 2, zero_deg: 24.9")
        at.read_until("lower_deg: -24.9")
        assert at.code() == 0
    found = load_arm(mine).joints[5]
    assert (found.direction, found.ratio) == (-1, 2.0)
    assert found.lower_deg == -found.zero_deg
    assert found.zero_deg == pytest.approx(25.0, abs=0.1)
    after = mine.read_text(encoding="utf-8")
    assert after.startswith("# my arm\n") and after.endswith("# its end\n")
    assert sum(old != new for old, new in zip(before.splitlines(), after.splitlines(), strict=True)) == 4
    assert no_process_left(truth)
    motions = truth.truth()
    for name, motion in motions.items():
        if name != "joint6":
            assert np.ptp(motion.position_rad) == 0.0
    assert math.degrees(motions["joint6"].position_rad[-1]) == pytest.approx(2.5, abs=0.1)
    assert np.max(np.abs(motions["joint6"].velocity_rad_s)) <= 2 * math.pi / 60 / 2 + 1e-9  # 1 rpm


def interrupt(at: Terminal, how: str) -> None:
    if how == "Ctrl-C":
        at.press(CTRL_C)
    elif how == "terminal gone":
        at.hang_up()
    else:
        at.process.send_signal(signal.SIGKILL)


@pytest.mark.process
@pytest.mark.parametrize("how", ["Ctrl-C", "terminal gone", "kill -9"])
def test_whatever_ends_it_in_the_middle_of_a_move_stops_the_move(truth: Stack, mine: Path, how: str) -> None:
    before = mine.read_bytes()
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint5")) as at:
        at.reply("Turn it?", "")
        at.read_until("direction stays 1.")
        at.reply("How shall joint5 get to the mark?", "d")
        at.reply("it is on the first mark", "15")
        at.read_until("15 is no number from -7.5 to 7.5.")
        at.reply("it is on the first mark", "7.5")
        at.read_until("turns by +30.0° at 1 rpm")
        at.reply("Turn it?", "y")
        until(lambda: truth.truth()["joint5"].position_rad[-1] > math.radians(0.5), patience_s=PATIENCE_S)
        interrupt(at, how)
        if how == "Ctrl-C":
            assert at.code() == 1
            assert "Ended (SIGINT); the arm stands. Nothing was written." in at.said
        at.process.wait(PATIENCE_S)
        until(lambda: no_process_left(truth), patience_s=PATIENCE_S)
    stood = truth.truth()["joint5"]
    assert stood.velocity_rad_s[-1] == 0.0
    assert 0.5 < math.degrees(stood.position_rad[-1]) < 6.0  # of the 7.5 it was told to go
    assert np.max(np.abs(stood.velocity_rad_s)) <= 2 * math.pi / 60 / 4 + 1e-9
    assert mine.read_bytes() == before


@pytest.mark.process
def test_an_adapter_that_goes_away_in_the_middle_of_a_move(truth: Stack, mine: Path) -> None:
    before = mine.read_bytes()
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint6")) as at:
        at.reply("Turn it?", "y")
        until(lambda: abs(np.ptp(truth.truth()["joint6"].position_rad)) > 0.005, patience_s=PATIENCE_S)
        truth.unplug()
        at.read_until(
            "The drive of joint6 does not say that it stands: it ends its small move by itself; use the switch"
        )
        at.read_until(f"The adapter at {truth.link} is gone")
        assert at.code() == 2
    assert no_process_left(truth)
    assert mine.read_bytes() == before


@pytest.mark.process
def test_a_joint_that_is_limp_when_it_ends_is_held_again(truth: Stack, mine: Path) -> None:
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint2")) as at:
        at.reply("Turn it?", "")
        at.reply("How shall joint2 get to the mark?", "h")
        at.read_until("falls where gravity pulls it")
        at.reply("Make joint2 limp?", "y")
        at.read_until("It is limp. Put it on the first mark")
        interrupt(at, "Ctrl-C")
        assert at.code() == 1
    truth.truth()
    heard = b"".join(data for _, data in truth.wire())
    release, enable, stop = b"T000002005F3AB00006B\r", b"T000002005F3AB01006B\r", b"T000002004FE98006B\r"
    assert 0 < heard.rfind(release) < heard.rfind(enable) < heard.rfind(stop)


@pytest.mark.process
def test_only_a_terminal_is_asked_and_only_sound_drives_are_turned(truth: Stack, mine: Path) -> None:
    before = mine.read_bytes()
    piped = run_rtarm("calibrate", str(mine), typed="y\nn\ny\n" * 50)  # as of `yes |`
    assert piped.returncode == 1
    assert piped.stderr == (
        "Ended (answers are taken from a terminal alone, and the standard input is none); the arm stands. Nothing was "
        "written.\n"
    )
    truth.befall("protection:joint=joint3,at_s=0")
    refused = run_rtarm("calibrate", str(mine))
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "The drive of joint3 (address 3) is in protection (stall) and holds nothing" in refused.stderr
    ended = run_rtarm("calibrate", str(mine), "--joint", "joint6")  # whose drive is sound
    assert (ended.returncode, "not understood: joint3." in ended.stdout) == (1, True)
    assert all(np.ptp(motion.position_rad) == 0.0 for motion in truth.truth().values())
    assert mine.read_bytes() == before


@pytest.mark.process
def test_what_is_typed_before_a_question_is_no_answer_to_it(truth: Stack, mine: Path) -> None:
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint6")) as at:
        at.reply("Turn it?", "y\nn\ny\ny")  # a person in a hurry, while the motor turns
        at.reply("Which way did joint6 go?", "q")
        assert at.code() == 1
    assert "Was that the opposite way?" not in at.said and "you ended it" in at.said
    moved_deg = np.degrees(np.ptp(truth.truth()["joint6"].position_rad))
    assert moved_deg == pytest.approx(7.5 / 2, abs=0.1)


@pytest.mark.process
def test_a_drive_that_stalls_ends_it_with_its_sentence(truth: Stack, mine: Path) -> None:
    before = mine.read_bytes()
    truth.befall("stall:joint=joint6,at_s=0")
    with closing(rtarm_at_terminal("calibrate", str(mine), "--joint", "joint6")) as at:
        at.reply("Turn it?", "y")
        at.read_until("The drive of joint6 was held up (it says that it stalls): it was stopped")
        assert at.code() == 2
    assert np.ptp(truth.truth()["joint6"].position_rad) == 0.0
    assert mine.read_bytes() == before
