"""An arm goes on by itself after a stall, with real processes: the simulated arm stands still for a moment."""

import math
import signal
import time
from contextlib import closing

import pytest
from stack import Process

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from ros_client import ABORTED, SUCCEEDED, Client, recorded
from waiting import until

from shm.words import Mode

pytestmark = pytest.mark.process

STALE_S = {"stale_brake_s": 0.1, "stale_fault_s": 0.5}
"""A busy machine's own stalls are shorter than this."""
STALL_S = 0.8


def test_a_stall_ends_the_goal_and_the_next_one_succeeds_without_a_person(stack_at):
    goal = recorded("large")
    stack = stack_at([math.degrees(angle) for angle in goal.trajectory.points[0].positions])
    stack.change(limits=STALE_S)
    up = stack._keep(Process("rtarm", "up", str(stack.arm_file), needs_ros=True))
    up.line_with("running; Ctrl-C")
    with closing(Client(f"controller_{stack.name}")) as client:
        handle = client.send(goal)
        stack.until(lambda report: report["mode"] == Mode.EXECUTING.name.lower())
        stack.sim.process.send_signal(signal.SIGSTOP)
        time.sleep(STALL_S)  # which is the stall itself
        stack.sim.process.send_signal(signal.SIGCONT)
        status, _, words = client.result(handle)
        assert status == ABORTED
        assert words.startswith("No drive of the simulated arm has answered")
        up.line_with("so the arm holds by itself")
        report = stack.until(lambda report: report["mode"] == Mode.HOLDING.name.lower())
        assert all(joint["referenced"] for joint in report["joints"])
        assert "-stale_reading.mcap" in up.line_with("recorded: ")
        home = goal.trajectory.points[0]  # where it stood, from where it stands now
        home.velocities, home.accelerations, home.time_from_start = [], [], goal.trajectory.points[-1].time_from_start
        goal.trajectory.points = [home]
        status, _, words = client.run(goal)
        assert status == SUCCEEDED, words
    until(lambda: not stack.until(bool)["fault"], "an arm without a fault")
