"""`rtarm calibrate` at a terminal, beside simulated drives that are led by their ordinary control process."""

from __future__ import annotations

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
from at_terminal import CTRL_C, PATIENCE_S, rtarm_at_terminal
from stack import Stack, run_rtarm
from waiting import until

from config.loader import load_arm
from rtarm.led.joint import FRESH_S, silent_for_s
from rtloop.kept import reference_store
from shm import files
from shm.client import StateReader
from shm.files import DIRECTORY


@pytest.fixture(params=["damiao6", "odrive6"])
def truth(arm_name: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Stack]:
    """Drives that are switched on, whose joint6 is built otherwise than the file says."""
    stack = Stack(arm_name, tmp_path, request.param, start_deg=[0, 0, 0, 0, 0, 10])
    with edited(stack.arm_file) as values:
        values["joints"][5].update(ratio=1, direction=-1, zero_deg=25)
    stack.start_sim()
    with edited(stack.arm_file) as values:
        values["joints"][5].update(ratio=2, direction=1, zero_deg=30)
        values["joints"][5].update(lower_deg=-60, upper_deg=60)
    yield stack
    stack.close()


def no_process_left(stack: Stack) -> bool:
    return not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


@pytest.mark.process
def test_a_session_from_direction_to_file(truth: Stack) -> None:
    arm = load_arm(truth.arm_file)
    reference_store.keep_power_marks(arm, {5: "armed", 0: "armed"})
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("joint6 is brought up alone", "y")
        at.read_until("The file says: direction 1, ratio 2, zero_deg 30.")
        at.read_until("turns by +15.0° at 1 rpm")
        at.reply("Turn it?", "y")
        at.reply("Which way did joint6 go?", "n")
        at.reply("Was that the opposite way?", "y")
        at.read_until("direction: -1; the file says 1.")
        at.reply("How shall joint6 get to the mark?", "d")
        at.reply("it is on the first mark", "y")
        at.reply("it is on the second mark", "15")
        at.reply("Turn it?", "y")
        at.reply("it is on the second mark", "y")
        at.reply("By how many degrees", "30")
        at.reply("Take 1 (the only whole number that fits)?", "y")
        at.read_until("3. Zero: where its drive counts 0 joint6 is at -zero_deg")
        at.reply("How shall joint6 get to the mark?", "d")
        at.reply("it is on its mark", "y")
        at.reply("At how many degrees", "40")
        at.reply("Take 25", "y")
        at.reply(f"Write this to {truth.arm_file}?", "y")
        at.read_until(f"Written to {truth.arm_file}: joint6 (direction: -1, ratio: 1, zero_deg: 2")
        assert at.code() == 0
    found = load_arm(truth.arm_file).joints[5]
    assert (found.direction, found.ratio) == (-1, 1.0)
    assert found.zero_deg == pytest.approx(25.0, abs=0.1)
    assert reference_store.power_marks(arm) == {0: "armed"}
    assert no_process_left(truth)
    motions = truth.truth()
    assert all(np.ptp(motion.position_rad) == 0.0 for name, motion in motions.items() if name != "joint6")
    assert math.degrees(motions["joint6"].position_rad[-1]) == pytest.approx(40.0, abs=0.1)
    assert np.max(np.abs(motions["joint6"].velocity_rad_s)) <= 2 * math.pi / 60 * 1.2


@pytest.mark.process
@pytest.mark.parametrize("how", ["Ctrl-C", "terminal gone", "kill -9"])
def test_whatever_ends_it_amid_a_move_stops_the_move(truth: Stack, how: str) -> None:
    before = truth.arm_file.read_bytes()
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("Bring it up?", "y")
        at.reply("Turn it?", "y")
        until(lambda: math.degrees(np.ptp(truth.truth()["joint6"].position_rad)) > 1.0, patience_s=PATIENCE_S)
        if how == "Ctrl-C":
            at.press(CTRL_C)
            assert at.code() == 1
            assert "Ended (SIGINT); the arm stands. Nothing was written." in at.said
        elif how == "terminal gone":
            at.hang_up()
        else:
            at.process.send_signal(signal.SIGKILL)
        at.process.wait(PATIENCE_S)
        until(lambda: no_process_left(truth), patience_s=PATIENCE_S)
    until(lambda: abs(truth.truth()["joint6"].velocity_rad_s[-1]) < 1e-3, patience_s=PATIENCE_S)
    stood = truth.truth()["joint6"]
    assert 1.0 < math.degrees(np.ptp(stood.position_rad)) < 14.0  # of the 15 it was told to go
    assert truth.arm_file.read_bytes() == before


@pytest.mark.process
def test_what_was_not_seen_is_told(truth: Stack) -> None:
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("Bring it up?", "y")
        at.read_until("Turn it?")
        truth.befall("silent:joint=joint6,at_s=0,until_s=30")
        with closing(StateReader(files.open_state(truth.name))) as state:
            until(lambda: silent_for_s(state.snapshot()) > 2 * FRESH_S, patience_s=PATIENCE_S)
        at.press(CTRL_C)
        assert at.code() == 2
        said = " ".join(at.said.split())
        assert "did not answer at the end. The drive was not seen to stand: use the switch in the power line." in said
        assert said.endswith("Nothing was written.")
    assert no_process_left(truth)
    assert not list(Path(tempfile.gettempdir()).glob(f"rtarm-led-{truth.name}-*"))


@pytest.mark.process
def test_a_control_process_that_is_killed_ends_it(truth: Stack) -> None:
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("Bring it up?", "y")
        at.reply("Turn it?", "y")
        until(lambda: math.degrees(np.ptp(truth.truth()["joint6"].position_rad)) > 1.0, patience_s=PATIENCE_S)
        with closing(files.open_state(truth.name)) as state:
            os.kill(int(state.record["header"]["pid"]), signal.SIGKILL)
        assert at.code() == 3
        assert "ended by SIGKILL. The drive was not seen to stand" in " ".join(at.said.split())


@pytest.mark.process
def test_what_is_refused_moves_nothing(truth: Stack) -> None:
    truth.befall("silent:joint=joint6,at_s=0")
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("Bring it up?", "y")
        at.read_until("The drive of joint6")
        assert at.code() == 2
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint5")) as at:
        at.reply("Bring it up?", "n")
        at.read_until("joint5 is left out.")
        assert at.code() == 0
    piped = run_rtarm("calibrate", str(truth.arm_file), typed="y\ny\ny\n")
    assert piped.returncode == 1 and "the standard input is none" in piped.stderr
    assert all(np.ptp(motion.position_rad) == 0.0 for motion in truth.truth().values())


@pytest.mark.process
def test_a_joint_that_is_limp_when_it_ends_is_held_again(truth: Stack) -> None:
    """Else its drive would be said to be limp."""
    with closing(rtarm_at_terminal("calibrate", str(truth.arm_file), "--joint", "joint6")) as at:
        at.reply("Bring it up?", "y")
        at.reply("Turn it?", "")
        at.reply("How shall joint6 get to the mark?", "h")
        at.reply("Make joint6 limp?", "y")
        at.read_until("It is limp. Put it on the first mark")
        at.press(CTRL_C)
        assert at.code() == 1
        assert "Ended (SIGINT); the arm stands. Nothing was written." in at.said
    assert no_process_left(truth)
