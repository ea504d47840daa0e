"""From a client's goal to the bus and back: real processes, a real action client in this one.

`send_goal` is the moment before `send_goal_async`; a command is there when the simulated adapter has read its last
character; the client's times are those of its futures' callbacks, so its own rclpy counts, too. Goals come at random
moments of the control cycle. Brisk ones ask of every joint the acceleration that is its limit, from the first setpoint
to the last, so that the drives are still arriving when the last one is due; of gentle ones the first setpoints are less
than a pulse away, so the cycle that begins the trajectory is given, too. The last setpoint is the one that commands the
trajectory's last point; it is due one period after the cycle that sends it, and earlier readings decide nothing.
"""

import math
import random
import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from live import LiveStack, commanded_rad, goal_to, in_words, live, percentiles
from ros_client import CANCELED, SUCCEEDED

from config.loader import load_arm
from shm.snapshot import Snapshot
from shm.words import Outcome

GOALS = 120
CANCELS = 40
GOAL_S = 0.25
PATIENCE_S = 10.0
PERIOD_NS = 8_333_333
PERIOD_S = PERIOD_NS / 1e9


@dataclass
class Goal:
    """The moments of one goal, CLOCK_MONOTONIC ns."""

    sent_ns: int = 0
    answered_ns: int = 0
    cancel_sent_ns: int = 0
    cancel_answered_ns: int = 0
    begun_ns: int = 0
    """Planned time of the cycle that sends the trajectory's first setpoint."""
    last_setpoint_ns: int = 0
    """Planned time of the cycle that sends the trajectory's last point."""
    decided_ns: int = 0
    """Planned time of the cycle that finds the arm has arrived."""
    result_ns: int = 0


class Timed:
    """A client that remembers when what happened; it asks for the result in the answer's callback."""

    def __init__(self, stack: LiveStack) -> None:
        self.stack = stack

    def run(self, goal, cancel_after_s: float | None = None) -> Goal:
        times, answered, ended = Goal(), threading.Event(), threading.Event()
        outcome = []

        def on_answer(future):
            times.answered_ns = time.monotonic_ns()
            self.handle = future.result()
            self.handle.get_result_async().add_done_callback(on_result)
            answered.set()

        def on_cancel(_):
            times.cancel_answered_ns = time.monotonic_ns()

        def on_result(future):
            times.result_ns = time.monotonic_ns()
            outcome.append(future.result())
            ended.set()

        times.sent_ns = time.monotonic_ns()
        self.stack.client.action.send_goal_async(goal).add_done_callback(on_answer)
        assert answered.wait(PATIENCE_S)
        if cancel_after_s is None:
            time.sleep(GOAL_S / 2)
            middle = self.stack.reader.snapshot()
            times.begun_ns, times.last_setpoint_ns = first_setpoint_ns(middle), last_setpoint_ns(middle)
        else:
            time.sleep(cancel_after_s)
            times.cancel_sent_ns = time.monotonic_ns()
            self.handle.cancel_goal_async().add_done_callback(on_cancel)
        assert ended.wait(PATIENCE_S)
        status, words = outcome[0].status, outcome[0].result.error_string
        assert status == (SUCCEEDED if cancel_after_s is None else CANCELED), words
        results = self.stack.reader.snapshot()["results"]
        decided = results[results["outcome"] != Outcome.NONE]
        times.decided_ns = int(decided["monotonic_ns"][decided["goal_id"].argmax()])
        return times


def first_setpoint_ns(snapshot: Snapshot) -> int:
    """When a running goal's first setpoint was commanded, which belongs to the end of that cycle's period."""
    return snapshot["monotonic_ns"] - round(snapshot["trajectory_clock_ns"]) + PERIOD_NS


def last_setpoint_ns(snapshot: Snapshot) -> int:
    """When a running goal's last point will be commanded, from the cycle in its middle that this snapshot shows."""
    left_ns = snapshot["trajectory_end_ns"] - snapshot["trajectory_clock_ns"]
    assert left_ns > 0
    return snapshot["monotonic_ns"] + math.ceil(left_ns / PERIOD_NS - 1e-6) * PERIOD_NS


def first_changed_ns(commands: np.ndarray, goal: Goal) -> int:
    """When a goal's first changed command had been read by the adapter."""
    firsts = []
    for address in np.unique(commands[:, 1]):
        times_ns, _, targets = commands[commands[:, 1] == address].T
        changed_ns = times_ns[1:][np.diff(targets) != 0]
        firsts += changed_ns[changed_ns > goal.sent_ns][:1].tolist()
    return min(firsts)


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(240)
@pytest.mark.parametrize("share", [1.0, 0.2], ids=["brisk", "gentle"])
def test_goal_latency(benchmark, report, tmp_path, share):
    def measure():
        with live(tmp_path) as stack:
            client, home = Timed(stack), commanded_rad(stack)
            accelerations = np.array([joint.max_acceleration_rad_s2 for joint in load_arm(stack.arm_file).joints])
            away = (
                share * accelerations * GOAL_S**2 / 6
            )  # a cubic from rest to rest begins and ends with the acceleration
            goals, cancels = [], []
            for turn in range(GOALS):
                target = home - (0.0 if turn % 2 else away)
                time.sleep(0.05 + random.random() * 2 * PERIOD_S)
                goals.append(client.run(goal_to(target, GOAL_S)))
            for turn in range(CANCELS):
                target = home - (0.0 if turn % 2 else 0.1)
                time.sleep(0.05 + random.random() * 2 * PERIOD_S)
                cancels.append(client.run(goal_to(target, 1.5), cancel_after_s=0.15 + random.random() * PERIOD_S))
            return goals, cancels, stack.commands()

    goals, cancels, commands = benchmark.pedantic(measure, rounds=1)
    spans = {
        "send_goal → accepted in the client": [g.answered_ns - g.sent_ns for g in goals],
        "send_goal → cycle that begins the trajectory": [g.begun_ns - g.sent_ns for g in goals],
        "send_goal → first changed command": [first_changed_ns(commands, g) - g.sent_ns for g in goals],
        "last setpoint due → arrived, in the loop": [g.decided_ns - g.last_setpoint_ns - PERIOD_NS for g in goals],
        "arrived, in the loop → result in the client": [g.result_ns - g.decided_ns for g in goals],
        "last setpoint due → result in the client": [g.result_ns - g.last_setpoint_ns - PERIOD_NS for g in goals],
        "send_goal → result in the client, less the goal's time": [
            g.result_ns - g.sent_ns - round(GOAL_S * 1e9) for g in goals
        ],
        "cancel → answered in the client": [g.cancel_answered_ns - g.cancel_sent_ns for g in cancels],
    }
    aims = {"send_goal → first changed command": 21.7, "arrived, in the loop → result in the client": 20.0}
    if share < 1.0:  # what the drives need to arrive from full acceleration is theirs
        aims["last setpoint due → result in the client"] = 15.0
    report(
        f"goals with {share:g} of the acceleration limits, {GOAL_S:g} s long",
        f"{len(goals)}, and {len(cancels)} canceled",
    )
    for what, values in spans.items():
        figures = benchmark.extra_info[what] = percentiles(np.array(values) / 1e6, 50, 99)
        aim = f" (aim: p99 ≤ {aims[what]:g})" if what in aims else ""
        report(f"  {what}", f"{in_words(figures)} ms{aim}")
