"""An arm in virtual time, so that pictures show setpoints of the real cycle: no process, no bus, no clock.

Its drives are mock drives, for which what is commanded is at once measured. Goals take the way that they take in
service: they are judged and planned by the ROS process' functions and written into the command file, from which the
control cycle reads them.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from config.loader import load_arm
from rosfront.goal import plan_goal, plan_stream
from rosfront.plan import GoalPlan, Present
from rosfront.settings import Settings
from rosfront.streamer import Streamer, horizon_s
from rtloop.cycle import step
from rtloop.dialogues.bringup import BringUp
from rtloop.drives.power import Marks
from rtloop.process import entries
from rtloop.process.initial_state import new_loop
from rtloop.service.port import ServicePort
from shm import layout
from shm.client import CommandWriter
from shm.files import MemoryFile
from shm.words import Mode

START_NS = 1_000_000_000
PATIENCE_S = 5.0
NO_ORDERS: Mapping[float, Callable[[], None]] = {}
NOTHING = SimpleNamespace(joint_names=[], points=[])


class VirtualArm:
    """An arm that holds; `cycle` is one control period."""

    def __init__(self, start_rad: Sequence[float], overrides: Mapping[str, Any]) -> None:
        """The arm `mock`, which is Episode1 without a bus, with some values replaced."""
        self.arm = load_arm("mock", overrides=overrides)
        self._joints = len(self.arm.joints)
        rings = layout.rings(self._joints, self.arm.control.period_ns, 0)
        self._state = self._memory(layout.StateFile.dtype, rings.file_bytes)
        self._state.record["recorder"] = rings.described()
        command = self._memory(layout.CommandFile.dtype, layout.CommandFile.dtype.itemsize)
        self.writer = CommandWriter(command)
        self._loop = new_loop(self.arm, self._state.address, command.address)
        self._now_ns = START_NS
        self._goal = 0
        self._streamer: Streamer | None = None
        self._bring_up(list(start_rad))

    def _memory(self, dtype: np.dtype, size: int) -> MemoryFile:
        """A memory file that no other process can map."""
        mapped = mmap.mmap(-1, size)
        memory = MemoryFile(Path(), -1, mapped, np.frombuffer(mapped, dtype, 1))
        memory.record["header"]["joint_count"] = self._joints
        memory.record["header"]["period_ns"] = self.arm.control.period_ns
        return memory

    def _bring_up(self, start_rad: list[float]) -> None:
        talk = BringUp(
            self.arm,
            ServicePort(self._loop, entries),
            now_ns=self._now_ns,
            clears_protection=False,
            tell=print,
            marks=Marks(),
            held_rad={},
            mock_positions_rad=start_rad,
        )
        self.until(lambda: talk.poll(self._now_ns) and self._loop[0]["mode"] == Mode.HOLDING)

    def cycle(self) -> None:
        """Let one period pass."""
        self._now_ns += self.arm.control.period_ns
        self.writer.beat(self._now_ns)
        if self._streamer is not None:
            consumed = int(self._state.record["consumed"]["setpoints"])
            self._streamer.pump(self.writer, consumed, self._loop[0]["clock"]["time_s"] * 1e9)
        step(self._loop[0], self._state.array[0], self._now_ns)

    def until(self, condition: Callable[[], bool]) -> None:
        """Cycle until a condition holds; raises TimeoutError where it does not within virtual seconds."""
        too_late_ns = self._now_ns + round(PATIENCE_S * 1e9)
        while not condition():
            if self._now_ns > too_late_ns:
                raise TimeoutError(f"not within {PATIENCE_S:g} virtual seconds")
            self.cycle()

    @property
    def _commanded(self) -> np.ndarray:
        """(joints, 3): the present setpoint in rad, rad/s, rad/s²."""
        commanded = self._loop[0]["axes"]["commanded"][: self._joints]
        return np.stack([commanded[word] for word in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")], 1)

    def send(self, points: Sequence[SimpleNamespace], *, stream: bool = False) -> None:
        """Send a goal, or a message of a stream, and cycle until it moves the arm."""
        trajectory = SimpleNamespace(
            header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0)),
            joint_names=[joint.name for joint in self.arm.joints],
            points=points,
        )
        standing = self._loop[0]["mode"] == Mode.HOLDING
        present = Present(self._commanded, standing, self._now_ns, self._now_ns)
        settings = Settings.of(self.arm)
        if stream:
            plan = plan_stream(trajectory, self.arm, present, settings)
        else:
            plan = plan_goal(_goal(trajectory), self.arm, present, settings)
        self._start(plan)

    def _start(self, plan: GoalPlan) -> None:
        self._goal += 1
        epoch = int(self._loop[0]["goals"]["epoch"])
        self._streamer = Streamer(self._goal, plan, epoch, horizon_s(self.arm))
        self.until(lambda: self._loop[0]["snapshot"]["goal_id"] == self._goal)

    def cancel(self) -> None:
        """As a client of the action does."""
        self.writer.cancel(self._goal)

    def follow(self, seconds: float, orders: Mapping[float, Callable[[], None]] = NO_ORDERS) -> np.ndarray:
        """(cycles, joints, 3): the setpoints from now on; each order is given once its time (s) has come."""
        left = sorted(orders.items())
        rows = [self._commanded]
        for number in range(1, round(seconds * 1e9) // self.arm.control.period_ns + 1):
            while left and left[0][0] * 1e9 < number * self.arm.control.period_ns:
                left.pop(0)[1]()
            self.cycle()
            rows.append(self._commanded)
        return np.stack(rows)


def _goal(trajectory: SimpleNamespace) -> SimpleNamespace:
    """A goal of the action with a trajectory and the default tolerances."""
    return SimpleNamespace(
        trajectory=trajectory,
        multi_dof_trajectory=NOTHING,
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=[],
        component_goal_tolerance=[],
        goal_time_tolerance=SimpleNamespace(sec=0, nanosec=0),
    )
