"""`python -m stop_crowd ROLE ARM_FILE SEED`: somebody who goes on sending to an arm that runs, until it is terminated.

ROLE is one of SENDERS, or `suspended`: that one asks something of the arm and stands still in the middle of it, by
SIGSTOP, with the producers' lock in its hands. Prints `ready` when it has begun.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from config.loader import load_arm
from shm import files
from shm.client import CommandWriter, StateReader
from shm.errors import RingFull
from shm.words import Request

STREAM_HZ = 100.0
FLOOD_PAUSE_S = 0.0005
RING_PAUSE_S = 0.2
SHORTEST_S, LONGEST_S = 0.8, 3.0
POLL_S = 0.002
ANSWER_S = 1.0
"""For a goal to be answered: a request that a server just discovered does not hear is sent again after that."""


class Crowd:
    """A ROS node that knows where the arm is commanded to be, for what a planner takes from /joint_states."""

    def __init__(self, arm_file: Path, seed: int) -> None:
        from fault_rig import User

        self.arm = load_arm(arm_file)
        self.random = np.random.default_rng(seed)
        self.reader = StateReader(files.open_state(self.arm.name))
        self.writer = CommandWriter(files.open_command(self.arm.name))
        self.user = User(self.arm.front.controller_name)
        self.sent: Any = None

    def here(self) -> np.ndarray:
        """Where the arm is commanded to be, (joints,)."""
        snapshot = self.reader.snapshot()
        here: np.ndarray = snapshot["joints"]["commanded_position_rad"][: len(self.arm.joints)].copy()
        return here

    def goal(self, origin: np.ndarray | None = None) -> Any:
        """A random goal from an origin, or from where the arm is commanded to be."""
        from fault_rig import random_goal

        seconds = self.random.uniform(SHORTEST_S, LONGEST_S)
        return random_goal(self.arm, self.here() if origin is None else origin, seconds, self.random)

    def send(self, goal: Any) -> None:
        self.sent = self.user.send(goal)

    def has_ended(self) -> bool:
        """Whether the last goal has; one that is not answered at all counts as ended too."""
        if self.sent is None or self.sent.ended.is_set():
            return True
        waited_s = (time.monotonic_ns() - self.sent.sent_ns) * 1e-9
        return not self.sent.accepted.is_set() and waited_s > ANSWER_S


def stream(crowd: Crowd) -> None:
    """Points sent one by one along waves, each to be reached a tenth of a second later."""
    from builtin_interfaces.msg import Duration
    from random_ways import waves_from
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    ahead_s = 0.1
    publisher = crowd.user.node.create_publisher(JointTrajectory, f"/{crowd.user.controller}/joint_trajectory", 10)
    way = waves_from(
        crowd.arm.joints, crowd.here(), crowd.random.uniform(0.3, 0.7), int(crowd.random.integers(1 << 30))
    )
    names = [joint.name for joint in crowd.arm.joints]
    began_s = next_s = time.monotonic()
    while True:
        position, velocity = way(time.monotonic() - began_s + ahead_s)
        point = JointTrajectoryPoint(positions=position.tolist(), velocities=velocity.tolist())
        point.time_from_start = Duration(nanosec=round(ahead_s * 1e9))
        publisher.publish(JointTrajectory(joint_names=names, points=[point]))
        next_s = max(next_s + 1.0 / STREAM_HZ, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))


def flood(crowd: Crowd) -> None:
    """A client that goes on, beside speed scales by ROS and by the command file, cancels and requests."""
    from control_msgs.msg import SpeedScalingFactor

    publisher = crowd.user.node.create_publisher(
        SpeedScalingFactor, f"/{crowd.user.controller}/speed_scaling_input", 10
    )
    asks_s = 0.0
    while True:
        if crowd.has_ended():
            crowd.send(crowd.goal())
        scale = float(crowd.random.uniform(0.3, 1.0))
        publisher.publish(SpeedScalingFactor(factor=scale))
        crowd.writer.scale(scale)
        crowd.writer.cancel(max(crowd.writer.announced_goal - int(crowd.random.integers(1, 9)), 0))
        if time.monotonic() > asks_s:
            try:
                kind = (Request.ENABLE, Request.CLEAR_FAULT)[crowd.random.integers(2)]
                epoch = int(crowd.reader.snapshot()["epoch"])
                crowd.writer.request(kind, consumed=crowd.reader.requests_consumed(), epoch=epoch)
            except RingFull:
                asks_s = time.monotonic() + RING_PAUSE_S
        time.sleep(FLOOD_PAUSE_S)


def wait_for_start(crowd: Crowd) -> None:
    """Goals that are stamped ahead, each from where the one before it ends."""
    end, over_s = None, 0.0
    while True:
        goal = crowd.goal(end)
        in_s = max(over_s - time.monotonic(), 0.0) + crowd.random.uniform(0.0, 1.0)
        start_ns = time.time_ns() + round(in_s * 1e9)
        goal.trajectory.header.stamp.sec, goal.trajectory.header.stamp.nanosec = divmod(start_ns, 10**9)
        crowd.send(goal)
        over_s = time.monotonic() + in_s + crowd.sent.duration_s
        end = np.array(goal.trajectory.points[-1].positions)
        next_s = time.monotonic() + in_s + crowd.random.uniform(0.1, 1.0) * crowd.sent.duration_s
        while time.monotonic() < next_s:
            if crowd.has_ended() and not crowd.sent.succeeded:
                end, over_s = None, 0.0
                break
            time.sleep(POLL_S)


def replace(crowd: Crowd) -> None:
    """Goals that replace each other, planned from rest where the arm is; half of them leave out their first point."""
    while True:
        goal = crowd.goal()
        if crowd.random.random() < 0.5:
            del goal.trajectory.points[0]
        crowd.send(goal)
        time.sleep(crowd.random.uniform(0.03, 0.6))


def retry(crowd: Crowd) -> None:
    """What did not succeed is sent again at once: the same goal, or a plan from where the arm is by then."""
    goal = crowd.goal()
    while True:
        crowd.send(goal)
        while not crowd.has_ended():
            time.sleep(POLL_S)
        if crowd.sent.succeeded or crowd.random.random() < 0.5:
            goal = crowd.goal()


SENDERS: dict[str, Callable[[Crowd], None]] = {
    "stream": stream,
    "flood": flood,
    "waiting": wait_for_start,
    "replacing": replace,
    "retrying": retry,
}


def suspend(arm_file: Path) -> None:
    """Take the producers' lock and stand still."""
    command = files.open_command(load_arm(arm_file).name)
    with files.producers_lock(command.fd):
        print("ready", flush=True)
        os.kill(os.getpid(), signal.SIGSTOP)


def main(role: str, arm_file: str, seed: str) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if role == "suspended":
        suspend(Path(arm_file))
        return
    crowd = Crowd(Path(arm_file), int(seed))
    try:
        assert crowd.user.action.wait_for_server(30.0)
        print("ready", flush=True)
        SENDERS[role](crowd)
    finally:
        crowd.user.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
