"""A stand-in for the ROS process of an arm that runs: it looks on, and sends requests and goals through the memory."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stack import PATIENCE_S

from config.loader import arm_hash, load_arm
from shm.client import CommandWriter, StateReader
from shm.errors import RingFull
from shm.files import open_state, own_command
from shm.snapshot import Snapshot
from shm.words import Answer, Mode, Outcome, Request


class MemoryFront:
    """It lives, to the control process, as long as it waits for something."""

    def __init__(self, arm_file: Path, patience_s: float = PATIENCE_S) -> None:
        self.config = load_arm(arm_file)
        self.joints = len(self.config.joints)
        self.patience_s = patience_s
        self.reader = StateReader(open_state(self.config.name))
        self.writer = CommandWriter(own_command(self.config.name, arm_hash(self.config)))

    def now(self) -> Snapshot:
        self.writer.beat()
        return self.reader.snapshot()

    def until(self, wanted: Callable[[Snapshot], bool]) -> Snapshot:
        """The first snapshot that is as wanted."""
        deadline = time.monotonic() + self.patience_s
        while not wanted(now := self.now()):
            assert time.monotonic() < deadline, f"it never came: {now}"
            time.sleep(0.002)
        return now

    def counter(self, name: str) -> int:
        return int(self.reader.memory.record["counters"][name])

    def answer(self, kind: Request) -> Answer:
        """Make a request; its answer."""
        sequence = self.writer.request(kind, consumed=self.reader.requests_consumed(), epoch=int(self.now()["epoch"]))
        answers = self.until(lambda now: sequence in now["answers"]["sequence"])["answers"]
        return Answer(int(answers["answer"][answers["sequence"] == sequence][0]))

    def swing(self, duration_s: float = 4.0, angle_rad: float = 0.1, *, judged: bool = False) -> int:
        """Send a goal that swings all joints out and back; its number. `judged`: it has tolerances."""
        holding = self.until(lambda now: now["mode"] == Mode.HOLDING)
        home = holding["joints"]["commanded_position_rad"][: self.joints].copy()
        goal, rows = self.writer.announced_goal + 1, (self.joints, 1)
        consumed = self.reader.setpoints_consumed
        self.writer.announce(goal)
        self.writer.begin(
            goal,
            start_ns=0,
            joint_mask=(1 << self.joints) - 1,
            goal_time_s=float(judged),
            epoch=int(holding["epoch"]),
            entry=0,
            tolerances=np.tile([0.1 * judged, 0.0, 0.0], rows),
            consumed=consumed(),
        )
        w = 2 * np.pi / duration_s
        for time_s in np.linspace(0.0, duration_s, round(duration_s * 10) + 1):
            joints = np.zeros((self.joints, 3))
            joints[:, 0] = home + angle_rad * (1 - np.cos(w * time_s)) / 2
            joints[:, 1] = angle_rad * w * np.sin(w * time_s) / 2 if 0 < time_s < duration_s else 0.0
            joints[:, 2] = angle_rad * w * w * np.cos(w * time_s) / 2
            self._waypoint(goal, round(time_s * 1e9), joints)
        self.writer.end(goal, np.tile([0.01 * judged, 0.05 * judged, 0.0], rows), consumed())
        return goal

    def _waypoint(self, goal: int, at_ns: int, joints: np.ndarray) -> None:
        while True:
            with contextlib.suppress(RingFull):
                self.writer.waypoint(goal, at_ns, 5, joints, self.reader.setpoints_consumed())
                return
            self.writer.beat()

    def outcome(self, goal: int) -> Outcome:
        """Wait for a goal's result."""
        told = self.until(lambda now: now.find("results", "goal_id", goal) is not None)
        return Outcome(int(told.find("results", "goal_id", goal)["outcome"]))

    def close(self) -> None:
        self.reader.close()
        self.writer.close()
