"""The system's clock is set while the arm moves: the motion does not notice, the stamps follow.

Control process and front are told another time by a preloaded library (tests/stepped_clock.c); the machine's own clock
and this process' are left alone, so what stamps should say is known here. tests/vm sets a real clock.
"""

import os
import shutil
import subprocess
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from observer import judge, motion_after, motion_violations
from ros_client import ABORTED, SUCCEEDED, recorded
from waiting import until

from config.loader import load_arm
from shm.client import StateReader
from shm.files import open_state
from shm.words import Phase

pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="the stepped clock is a few lines of C: install gcc"),
]

HOUR_NS = 3600 * 10**9
TOUR = ("small", "single_joint", "large", "large_back")
"""Each begins where the last one ended."""
STEPS_NS = (HOUR_NS, -HOUR_NS, 500_000_000, -500_000_000)
FRESH_NS = 400_000_000
"""Age up to which a stamp is of the clock as it is now; less than the smallest step."""
AHEAD_NS = 3_000_000_000
"""Enough for a busy machine to take a goal before it begins."""
EARLY_NS = 50_000_000
"""Two clocks are read one after the other, and setpoints lead the encoders."""
SOURCE = Path(__file__).parents[1] / "stepped_clock.c"


class SteppedClock:
    """CLOCK_REALTIME of the processes started with `environment`: ours plus `step_ns`."""

    def __init__(self, folder: Path) -> None:
        library = folder / "stepped_clock.so"
        subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True)
        self._step = np.memmap(folder / "step_ns", np.int64, "w+", shape=(1,))
        self.environment = {"LD_PRELOAD": str(library), "STEPPED_CLOCK": str(folder / "step_ns")}

    @property
    def step_ns(self) -> int:
        return int(self._step[0])

    @step_ns.setter
    def step_ns(self, value: int) -> None:
        self._step[0] = value

    def now_ns(self) -> int:
        return time.time_ns() + self.step_ns


@pytest.fixture
def clock(tmp_path, monkeypatch):
    clock = SteppedClock(tmp_path)
    for name, value in clock.environment.items():
        monkeypatch.setitem(os.environ, name, value)  # every process of the stack inherits them
    return clock


@pytest.fixture
def stack(served_at, clock, monkeypatch):
    stack = served_at(recorded(TOUR[0]).trajectory.points[0].positions)
    for name in clock.environment:
        monkeypatch.delitem(os.environ, name)
    return stack


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def stamps_follow(client, clock):
    """Wait until joint states bear the present time of the stepped clock."""
    client.states.clear()
    until(
        lambda: client.states and abs(stamp_ns(client.states[-1][1]) - clock.now_ns()) < FRESH_NS,
        f"a joint state stamped with a clock {clock.step_ns * 1e-9:g} s from ours",
    )


def test_a_clock_that_is_set_changes_stamps_and_no_motion(stack, clock):
    """Forwards and backwards, by an hour and by half a second, while a goal runs: true motion within every limit."""
    began_ns = time.monotonic_ns()
    stamps_follow(stack.client, clock)
    for name, step_ns in zip(TOUR, STEPS_NS, strict=True):
        handle = stack.client.send(recorded(name))
        assert handle.accepted
        until(lambda: stack.client.feedback, "feedback")
        clock.step_ns += step_ns
        stamps_follow(stack.client, clock)
        state, _, words = stack.client.result(handle)
        assert state == SUCCEEDED, words
        stack.client.feedback.clear()
    judge(motion_violations(load_arm(stack.arm_file), stack.truth(), began_ns, time.monotonic_ns()))


def test_header_stamps_mean_the_clock_as_it_is_when_the_goal_comes(stack, clock):
    """A goal for an instant ahead begins after that time whatever is done to the clock meanwhile."""
    clock.step_ns = HOUR_NS
    stamps_follow(stack.client, clock)
    goal = recorded(TOUR[0])
    of_our_clock = time.time_ns()
    goal.trajectory.header.stamp.sec, goal.trajectory.header.stamp.nanosec = divmod(of_our_clock, 10**9)
    state, _, words = stack.client.run(goal)
    assert state == ABORTED  # an hour ago, on the clock of the arm's machine
    assert "clocks agree" in words
    sent_ns = time.monotonic_ns()
    begins = clock.now_ns() + AHEAD_NS
    goal.trajectory.header.stamp.sec, goal.trajectory.header.stamp.nanosec = divmod(begins, 10**9)
    handle = stack.client.send(goal)
    assert handle.accepted
    with closing(StateReader(open_state(stack.name))) as reader:  # a goal is accepted before its stamp is read
        until(lambda: reader.snapshot()["goal_phase"] == Phase.WAITING, "a goal that waits for its start")
    clock.step_ns = -HOUR_NS
    state, _, words = stack.client.result(handle)
    assert state == SUCCEEDED, words
    judge(motion_after(stack.truth(), sent_ns, sent_ns + AHEAD_NS - EARLY_NS))
