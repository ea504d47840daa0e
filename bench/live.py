"""What the benchmarks with real processes share: an arm of their own, its clients, and what the kernel knows of it."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from rtarm.launch.own_domain import own_domain

# Before rclpy is imported: this run's ROS traffic stays on this machine and apart from others'.
os.environ.update(own_domain())

import numpy as np
import yaml
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from observer import frames_sent
from ros_client import Client, until
from stack import Process, Stack
from trajectory_msgs.msg import JointTrajectoryPoint

from config.budget import budget
from config.loader import ARMS_FOLDER, load_arm
from rosfront.transport import FAST_DDS, choose_udp
from shm.client import StateReader
from shm.files import DIRECTORY, open_state
from shm.words import Mode
from sim.truth import load_wire

choose_udp(os.environ, os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS)

Settings = Mapping[str, Mapping[str, Any]]

NAMES = [f"joint{i}" for i in range(1, 7)]
START_DEG = [17.0, 12.0, -6.0, 57.0, 29.0, 115.0]
NS = 1_000_000_000
POSITION = 0xFD
"""First byte of both packets of a position command."""
TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")

FASTEST_BUS = {"bitrate": 1_000_000, "serial_baud": "cdc"}
"""Of a simulated adapter: the fastest CAN bus, behind native USB."""


def highest_hz(bus: Mapping[str, Any]) -> float:
    """The highest control rate that a bus carries episode1 with, rounded down to ten."""
    return budget(load_arm("episode1", overrides={"bus": bus})).highest_rate_hz // 10 * 10


class LiveStack(Stack):
    """The processes of episode1 behind a simulated adapter that keeps the motion commands, or of a mock arm."""

    def __init__(self, folder: Path, *, mock_hz: float | None = None, settings: Settings | None = None) -> None:
        """`mock_hz`: the control rate of a mock arm, None for episode1; `settings`: {section: {key: value}} changed."""
        super().__init__(f"b{secrets.token_hex(4)}", folder, start_deg=START_DEG)
        self.mock = mock_hz is not None
        values = yaml.safe_load(self.arm_file.read_text(encoding="utf-8"))
        if self.mock:
            values = yaml.safe_load((ARMS_FOLDER / "mock.yaml").read_text(encoding="utf-8"))
            values["name"] = self.name
            values["control"]["rate_hz"] = mock_hz
            values.setdefault("front", {})["controller_name"] = f"controller_{self.name}"
        for section, changed in (settings or {}).items():
            values.setdefault(section, {}).update(changed)
        self.arm_file.write_text(yaml.safe_dump(values), encoding="utf-8")

    def commands(self) -> np.ndarray:
        """What the simulated adapter has read, (n, 3): CLOCK_MONOTONIC ns, address, target in pulses; ends it."""
        self.loop.close()
        self.sim.close()
        found = []
        for first, second in pairwise(frames_sent(load_wire(self.truth_file))):
            if first.data[0] == second.data[0] == POSITION and first.drive == second.drive:
                pulses = int.from_bytes(first.data[5:8] + second.data[1:2], "big")
                found.append((second.time_ns, second.drive, -pulses if first.data[1] else pulses))
        return np.array(found, np.int64).reshape(-1, 3)


class Quiet(Client):
    """A client that does not listen to /joint_states, which would cost its interpreter more than the rest."""

    def __init__(self, controller: str) -> None:
        super().__init__(controller)
        self.stop_listening()


@contextmanager
def live(
    folder: Path, *, mock_hz: float | None = None, settings: Settings | None = None, front: bool = True
) -> Iterator[LiveStack]:
    """An arm that holds, its `reader`, and with `front` a `client`; fails when it leaves a memory file."""
    stack = LiveStack(folder, mock_hz=mock_hz, settings=settings)
    closers = [stack.close]
    try:
        if not stack.mock:
            stack.start_sim()
        stack.start_loop()
        stack.reader = StateReader(open_state(stack.name))
        closers.append(stack.reader.close)
        until(lambda: stack.reader.snapshot()["mode"] == Mode.HOLDING, "holding")
        if front:
            stack.start_front()
            stack.client = Quiet(f"controller_{stack.name}")
            closers.append(stack.client.close)
        yield stack
    finally:
        for close in reversed(closers):
            close()
    assert not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


def commanded_rad(stack: LiveStack) -> np.ndarray:
    """Where the arm is commanded to be, (joints,)."""
    return stack.reader.snapshot()["joints"]["commanded_position_rad"][:6].copy()


def point(time_s: float, positions: Sequence[float], velocities: Sequence[float] = ()) -> JointTrajectoryPoint:
    sec, nanosec = divmod(round(time_s * NS), NS)
    return JointTrajectoryPoint(
        positions=list(positions), velocities=list(velocities), time_from_start=Duration(sec=sec, nanosec=nanosec)
    )


def goal_to(positions: Sequence[float], seconds: float) -> Any:
    """A goal of one point, reached in so many seconds from where the arm is."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    goal.trajectory.points = [point(seconds, positions)]
    return goal


class Usage:
    """What a process holds and has used, as the kernel tells it."""

    def __init__(self, process: Process) -> None:
        pid = process.process.pid
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        words = {name: value.split() for name, value in (line.split(":", 1) for line in lines)}
        self.resident_kb = int(words["VmRSS"][0])
        self.peak_kb = int(words["VmHWM"][0])
        self.threads = int(words["Threads"][0])
        self.files = len(os.listdir(f"/proc/{pid}/fd"))
        times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        self.processor_s = (int(times[11]) + int(times[12])) / TICKS_A_SECOND


def percentiles(values: Sequence[float], *wanted: float) -> dict[str, float]:
    """Percentiles by name, and the largest value."""
    found = {f"p{p:g}": float(np.percentile(values, p)) for p in wanted}
    return {**found, "max": float(np.max(values))}


def in_words(figures: dict[str, float], digits: int = 1) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in figures.items())
