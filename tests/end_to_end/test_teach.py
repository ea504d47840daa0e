"""Teaching and playing with real processes: a hand leads the limp simulated arm, and the arm repeats it."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from at_terminal import rtarm_at_terminal
from scipy.spatial.distance import cdist
from stack import PATIENCE_S, Process, Stack
from waiting import until

from rtarm.teach.file import load
from rtarm.teach.motion import Motion
from shm.client import StateReader
from shm.files import open_state
from shm.words import Mode
from sim.truth import JointTruth

pytestmark = pytest.mark.process

START_DEG = (10.0, -20.0, 15.0, 30.0, -25.0, 40.0)
LED_S = 5.0
AT_MOST_DEG = 0.5
"""What a motion may be beside the hand by default."""
PLAYED_DEG = 0.25
"""How far the simulated arm is beside the motion that it plays, in place; typical values: docs/guides/teaching.md."""


def hands_way(times_s: np.ndarray) -> np.ndarray:
    """What the hand does with joints 1, 3 and 5 (degrees), at rest at both ends."""
    share = times_s / LED_S
    ease = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.column_stack([20.0 * ease, -15.0 * np.sin(np.pi * ease), 25.0 * np.sin(2.0 * np.pi * ease)])


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    times_s = np.arange(0.0, LED_S + 1e-9, 0.02)
    rows = [
        f"{time:.2f},{','.join(f'{angle:.4f}' for angle in row)}"
        for time, row in zip(times_s, hands_way(times_s), strict=True)
    ]
    path = tmp_path / "hand.csv"
    path.write_text("\n".join(["time_s,joint1,joint3,joint5", *rows]) + "\n")
    return path


@pytest.fixture
def led(stack_at: Callable[..., Stack], hand: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stack:
    """An arm that holds, and somebody who leads it once it is limp."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    stack = stack_at(START_DEG, "--hand", str(hand))
    stack.start_loop()
    return stack


def rtarm(stack: Stack, *words: str) -> Process:
    return stack._keep(Process("rtarm", *words, needs_ros=True))


def mode(stack: Stack) -> int:
    with closing(StateReader(open_state(stack.name))) as reader:
        return int(reader.snapshot()["mode"])


def wait_until_led(stack: Stack) -> None:
    """Until the hand has led joint 1 for a part of its way."""
    reader = StateReader(open_state(stack.name))
    led_rad = math.radians(START_DEG[0] + 10.0)
    with closing(reader):
        until(lambda: reader.snapshot()["joints"]["measured_position_rad"][0] >= led_rad, "a led arm", PATIENCE_S)


def kept(tmp_path: Path, name: str = "wave") -> Motion:
    return load(tmp_path / "data" / "rtarm" / "motions" / f"{name}.yaml")


def nearest_deg(motion_rad: np.ndarray, truth: dict[str, JointTruth], since_ns: int) -> float:
    """How far any place of a way is from the nearest place where the arm truly was since then, in its worst joint."""
    first, *_ = truth.values()
    at_ns = np.arange(since_ns, first.times_ns[-1], 2_000_000)
    was_rad = np.column_stack([joint.position_at(at_ns) for joint in truth.values()])
    return math.degrees(float(cdist(motion_rad, was_rad, "chebyshev").min(axis=1).max()))


def test_a_motion_is_taught_and_played_within_the_stated_error(led: Stack, tmp_path: Path) -> None:
    teach = rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", str(LED_S + 3.0))
    assert teach.code() == 0, teach.text
    assert mode(led) == Mode.HOLDING
    motion = kept(tmp_path)

    # what is kept is what the hand did
    led_s = np.linspace(0.0, LED_S, 300)
    hand_deg = np.tile(START_DEG, (len(led_s), 1))
    hand_deg[:, [0, 2, 4]] += hands_way(led_s)
    every_s = np.arange(0.0, motion.duration_s, 0.002)
    taught_deg = np.degrees(motion.curve(every_s))
    assert cdist(hand_deg, taught_deg, "chebyshev").min(axis=1).max() < AT_MOST_DEG + 0.1
    assert motion.duration_s == pytest.approx(LED_S, rel=0.5)

    # the arm does what is kept, from wherever it stands
    led.start_front()
    once = rtarm(led, "play", "wave", "--arm", str(led.arm_file), "--yes")
    assert once.code() == 0, once.text
    assert "To where it begins" in once.text and "Goal reached" in once.text
    played_ns = led.truth()["joint1"].times_ns[-1]
    again = rtarm(led, "play", "wave", "--arm", str(led.arm_file), "--yes", "--speed", "0.9")
    assert again.code() == 0, again.text
    beside_deg = nearest_deg(motion.curve(every_s[::5]), led.truth(), int(played_ns))
    print(f"beside the taught path by at most {beside_deg:.3f} degrees")
    assert beside_deg < PLAYED_DEG


def test_a_loop_goes_round_until_ctrl_c_and_the_arm_stands_then(led: Stack, tmp_path: Path) -> None:
    assert rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", str(LED_S + 3.0)).code() == 0
    led.start_front()
    play = rtarm(led, "play", "wave", "--arm", str(led.arm_file), "--yes", "--loop")
    play.line_with("round 2")
    play.process.send_signal(signal.SIGINT)
    assert play.code() == 0, play.text
    assert "Ended by SIGINT after 1 round; arm" in play.text
    with closing(StateReader(open_state(led.name))) as reader:
        assert not reader.snapshot()["joints"]["commanded_velocity_rad_s"].any()
    alone = rtarm(led, "play", "wave", "--arm", str(led.arm_file), "--yes")
    alone.line_with("Playing wave")
    alone.process.send_signal(signal.SIGTERM)
    assert alone.code() == 4, alone.text
    fast = rtarm(led, "play", "wave", "--arm", str(led.arm_file), "--yes", "--speed", "50")
    assert fast.code() == 1
    assert "limits allow at most" in fast.text


def test_a_person_is_asked_ends_with_enter_and_is_told(led: Stack, tmp_path: Path) -> None:
    with closing(rtarm_at_terminal("teach", "wave", "--arm", led.name)) as at:
        at.reply("hold it. Let it go? [y/N, q ends]", "n")
        assert at.code() == 1
        assert "Nothing was done" in at.said
    assert mode(led) == Mode.HOLDING
    with closing(rtarm_at_terminal("teach", "wave", "--arm", led.name)) as at:
        at.read_until("Let it go?")
        os.kill(at.process.pid, signal.SIGINT)
        assert at.code() == 1
        assert "Nothing was done (SIGINT)" in at.said
    assert mode(led) == Mode.HOLDING
    with closing(rtarm_at_terminal("teach", "wave", "--arm", led.name)) as at:
        at.reply("Let it go?", "y")
        at.read_until("Enter ends it")
        wait_until_led(led)
        at.type("")
        at.read_until("holds where it stands")
        assert at.code() == 0, at.said
        at.read_until("Play it with `rtarm play wave`")
    assert mode(led) == Mode.HOLDING
    assert kept(tmp_path).duration_s > 1.0


def test_a_terminal_that_goes_away_ends_the_recording_and_the_arm_holds(led: Stack, tmp_path: Path) -> None:
    with closing(rtarm_at_terminal("teach", "wave", "--arm", led.name, "--yes")) as at:
        wait_until_led(led)
        at.hang_up()
        at.process.wait(60.0)
    assert mode(led) == Mode.HOLDING
    assert kept(tmp_path).duration_s > 0.5


def test_a_fault_amid_teaching_is_told_and_what_was_recorded_is_kept(led: Stack, tmp_path: Path) -> None:
    teach = rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", "60")
    wait_until_led(led)
    led.sim.say("silent:joint=joint2,at_s=0")
    assert teach.code() == 1
    assert "Hold the arm, nothing else does: joint2" in teach.text
    assert "What was recorded until then is kept." in teach.text
    assert kept(tmp_path).duration_s > 0.5
    refused = rtarm(led, "teach", "other", "--arm", led.name, "--yes")
    assert refused.code() == 1
    assert "A fault is latched" in refused.text


def test_a_control_process_that_dies_amid_teaching_is_told_and_what_was_recorded_is_kept(
    led: Stack, tmp_path: Path
) -> None:
    teach = rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", "60")
    wait_until_led(led)
    led.loop.process.kill()
    assert teach.code() == 1
    assert "Hold the arm, its drives do not" in teach.text
    assert kept(tmp_path).duration_s > 0.5


def test_somebody_else_who_enables_the_arm_ends_the_recording(led: Stack, tmp_path: Path) -> None:
    teach = rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", "60")
    wait_until_led(led)
    assert rtarm(led, "enable", led.name).code() == 0
    assert teach.code() == 0, teach.text
    assert "was taken over" in teach.text
    assert kept(tmp_path).duration_s > 0.5


def test_joints_without_a_reference_are_not_taught_with(
    stack_at: Callable[..., Stack], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    stack = stack_at(START_DEG, "--unhomed")
    stack.start_loop()
    teach = rtarm(stack, "teach", "wave", "--arm", stack.name, "--yes")
    assert teach.code() == 1
    assert "The drive of each of joint1, joint2, joint3, joint4, joint5 and joint6 may have lost power" in teach.text
    assert mode(stack) == Mode.HOLDING


def test_nothing_that_moved_is_nothing_that_is_kept(led: Stack, tmp_path: Path) -> None:
    teach = rtarm(led, "teach", "wave", "--arm", led.name, "--yes", "--seconds", "0.5")
    assert teach.code() == 1
    assert "Nothing moved" in teach.text
    assert mode(led) == Mode.HOLDING
    assert not list((tmp_path / "data" / "rtarm" / "motions").iterdir())
    piped = rtarm(led, "teach", "wave", "--arm", led.name)
    assert piped.code() == 1
    assert "give --yes in a script" in piped.text
