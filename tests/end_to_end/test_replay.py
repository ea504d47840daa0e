"""A recording replayed on the arm that it was made of, with real processes: the encoders say the same again."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from scipy.interpolate import CubicSpline
from scipy.spatial.distance import cdist
from stack import PATIENCE_S, Process, Stack

from config.loader import load_arm
from rtarm.client.sender import goal_document, sending
from rtarm.recording.mcap_reader import read
from rtarm.running.status import read_status

pytestmark = pytest.mark.process

START_DEG = (10.0, -20.0, 15.0, 30.0, -25.0, 40.0)
BESIDE_DEG = 0.1
"""How far the encoders may be, in place, from where they were when it was recorded."""


def rtarm(stack: Stack, *words: str) -> Process:
    return stack._keep(Process("rtarm", *words, needs_ros=True))


def moved_there(stack: Stack) -> None:
    """Let the ordinary action move joints 1 and 5 along a curve."""
    arm = load_arm(stack.arm_file)
    times_s = np.linspace(0.0, 3.0, 31)
    share = times_s / times_s[-1]
    ease = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    way_deg = np.tile(START_DEG, (len(times_s), 1))
    way_deg[:, 0] += 12.0 * ease
    way_deg[:, 4] += 8.0 * np.sin(2.0 * math.pi * ease)
    way = CubicSpline(times_s, np.radians(way_deg), bc_type="clamped")
    goal = goal_document([joint.name for joint in arm.joints], times_s, way(times_s), way(times_s, 1))
    with sending(arm) as sender:
        outcome = sender.ended(sender.send(goal), PATIENCE_S)
        assert outcome is not None
    assert outcome.succeeded, outcome


def encoders_deg(path: Path) -> np.ndarray:
    """Where the joints were while the newest goal of a recording moved them (ms, joints), between their readings too.

    Joints are read one after the other, and not in every cycle: a cycle's record is no place where the arm ever was.
    """
    records = read(path).recording.records
    newest = records[records["goal_id"] == records["goal_id"].max()]
    joints = newest["joints"]
    at_ns = np.arange(newest["monotonic_ns"][0], newest["monotonic_ns"][-1], 1_000_000)
    columns = zip(joints["measured_ns"].T, joints["measured_position_rad"].T, strict=True)
    return np.degrees(np.column_stack([np.interp(at_ns, *column) for column in columns]))


def test_a_recording_is_replayed_and_the_encoders_say_the_same(stack_at: Callable[..., Stack], tmp_path: Path) -> None:
    stack = stack_at(START_DEG)
    stack.start_loop()
    stack.start_front()
    moved_there(stack)
    then, again = tmp_path / "then.mcap", tmp_path / "again.mcap"
    assert rtarm(stack, "record", stack.name, "-o", str(then)).code() == 0
    on_arm = ("replay", str(then), "--on-arm", "--arm", str(stack.arm_file))

    nobody_asked = rtarm(stack, *on_arm)
    assert nobody_asked.code() == 1, nobody_asked.text
    assert "give --yes in a script" in nobody_asked.text

    replay = rtarm(stack, *on_arm, "--yes")
    assert replay.code() == 0, replay.text
    assert "To where it begins" in replay.text and "Goal reached" in replay.text
    assert rtarm(stack, "record", stack.name, "-o", str(again)).code() == 0
    first_deg, second_deg = encoders_deg(then), encoders_deg(again)
    assert np.ptp(first_deg[:, 0]) > 11.0 and np.ptp(first_deg[:, 4]) > 15.0  # it was the whole motion
    each_deg = cdist(first_deg, second_deg, "chebyshev")
    beside_deg = max(each_deg.min(axis=0).max(), each_deg.min(axis=1).max())
    print(f"beside the recorded path by at most {beside_deg:.3f} degrees")
    assert beside_deg < BESIDE_DEG
    assert np.abs(second_deg[-1] - first_deg[-1]).max() < BESIDE_DEG

    slow = rtarm(stack, *on_arm, "--yes", "--speed", "0.2")
    slow.line_with("Replaying.")
    slow.process.send_signal(signal.SIGINT)
    assert slow.code() == 4, slow.text
    assert f"Ended by SIGINT; arm {stack.name} stands." in slow.text
    report = read_status(stack.name)
    assert report["mode"] == "holding" and report["goal"] is None, report
