"""An arm in virtual time behind the real serving front: what a goal's sender sees, cycle by cycle.

Goals and messages take the way they take in the ROS process (check, plan, ring, control cycle, verdict), but for the
middleware; only time is ours.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from trajectory_messages import NS
from virtual import VirtualArm

from config.bus import BusConfig
from config.drives.mock import MockDrive
from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.goal import plan_goal
from rosfront.link import Link
from rosfront.plan import GoalPlan
from rosfront.refusals import GoalRefused
from rosfront.serving import Execution, Serving
from rosfront.verdict import Status, Verdict, refused
from shm.client import CommandWriter
from shm.snapshot import Snapshot
from shm.words import Mode, Request
from sim.faults import Silent, Stall

ARM_FILE = Path(__file__).parent / "arm.yaml"
START = (1.1, 2.1, 3.1)
EPOCH_OFFSET_NS = 1_800_000_000 * NS
SUCCEEDED, CANCELED, ABORTED = Status.SUCCEEDED, Status.CANCELED, Status.ABORTED


def upstream_arm(drives: str = "zdt", *, gentle: bool = False, **sections: dict[str, Any]) -> ArmConfig:
    """The arm of arm.yaml; `gentle` gives it the limits of a real one, `sections` override the file.

    With mock drives what is commanded is measured at once, and its limits are those of a thought.
    """
    arm = load_arm(ARM_FILE, overrides=sections or None)
    limits: dict[str, Any] = {}
    if gentle:
        limits = {"motor_rpm": 120.0, "max_acceleration_rad_s2": 10.0}
    elif drives == "mock":
        limits = {"max_acceleration_rad_s2": 4000.0}
    if drives == "mock":
        limits["drive"] = MockDrive(family="mock")
        arm = arm.model_copy(update={"buses": [BusConfig(interface="mock")]})
    return arm.model_copy(update={"joints": [joint.model_copy(update=limits) for joint in arm.joints]})


def away(distance: float, *shares: float) -> tuple[float, ...]:
    """START moved by a distance, or by a share of it each joint."""
    return tuple(p + distance * share for p, share in zip(START, shares or (1.0, 1.0, 1.0), strict=True))


class Sent:
    """A goal or message on its way, and how it ended."""

    def __init__(self) -> None:
        self.verdicts: list[Verdict] = []
        self.execution: Execution | None = None

    @property
    def plan(self) -> GoalPlan:
        assert self.execution is not None, self.verdicts
        return self.execution.plan

    @property
    def ended(self) -> bool:
        return bool(self.verdicts)

    @property
    def verdict(self) -> Verdict:
        """The one verdict; a second one would be a defect."""
        (verdict,) = self.verdicts
        return verdict

    @property
    def outcome(self) -> tuple[Status, int]:
        return self.verdict.status, self.verdict.code

    @property
    def sentence(self) -> str:
        return self.verdict.sentence


class Stage:
    """The arm, its front, and what was commanded and measured so far."""

    def __init__(
        self, arm: ArmConfig, start: Sequence[float], monkeypatch: pytest.MonkeyPatch, **sim_options: Any
    ) -> None:
        mock = arm.bus.interface == "mock"
        self.arm = VirtualArm(arm, start_rad=None if mock else start, **sim_options)
        self.arm.memory["timing"]["epoch_offset_ns"] = EPOCH_OFFSET_NS
        self.names = [joint.name for joint in arm.joints]
        monkeypatch.setattr("rosfront.serving.time", SimpleNamespace(monotonic_ns=lambda: self.arm.now_ns))
        self.serving = Serving(arm)
        self.serving.attached(Link(arm.name, self.arm.reader, self.arm.writer))
        self.setpoints: list[np.ndarray] = []
        """What was commanded for the end of each cycle, (joints,)."""
        self.clocks_s: list[float] = []
        """The trajectory clock after each cycle."""
        self.running: list[int] = []
        """The goal that moved the arm in each cycle, as its feedback says; 0 for none."""
        self.bring_up(list(start) if mock else None)

    # --- time

    @property
    def period_s(self) -> float:
        return self.arm.period_ns / NS

    @property
    def epoch_ns(self) -> int:
        """The clock of ROS."""
        return self.arm.now_ns + int(self.arm.memory["timing"]["epoch_offset_ns"])

    def cycle(self) -> None:
        self.arm.cycle()
        self.look()
        self.setpoints.append(self.axes["commanded"]["next_position_rad"].copy())
        self.clocks_s.append(float(self.arm.memory["clock"]["time_s"]))

    def look(self) -> None:
        """What the publisher's thread does after each cycle."""
        moving = self.serving.look(self.snapshot)
        self.running.append(0 if moving is None else moving.goal_id)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.period_s)):
            self.cycle()

    def until(self, condition: Callable[[], bool], at_most_s: float = 20.0) -> None:
        """Cycle until a condition holds; fails when it does not within virtual seconds."""
        for _ in range(round(at_most_s / self.period_s)):
            if condition():
                return
            self.cycle()
        raise AssertionError(f"not within {at_most_s} virtual seconds")

    def configure(self, **settings: Any) -> None:
        """Change what the controller's parameters say."""
        self.serving.settings = replace(self.serving.settings, **settings)

    # --- goals, messages, requests

    def send(self, goal: Any) -> Sent:
        """Send a goal of the action; it is judged at once and begins with the next cycle."""
        sent = Sent()
        try:
            plan = plan_goal(goal, self.arm.arm, self.serving.present(), self.serving.settings)
            sent.execution = self.serving.start(plan, sent.verdicts.append)
        except GoalRefused as reason:
            sent.verdicts.append(refused(reason))
        return sent

    def finish(self, goal: Any, at_most_s: float = 20.0) -> Sent:
        """Send a goal and wait for its end."""
        sent = self.send(goal)
        self.until(lambda: sent.ended, at_most_s)
        return sent

    def publish(self, trajectory: Any) -> Sent:
        """Publish on ~/joint_trajectory."""
        sent = Sent()
        try:
            self.serving.stream(trajectory, sent.verdicts.append)
        except GoalRefused as reason:
            sent.verdicts.append(refused(reason))
        return sent

    def cancel(self, sent: Sent) -> None:
        assert sent.execution is not None
        self.serving.cancel(sent.execution)

    def ask(self, kind: Request, value: float = 0.0) -> tuple[bool, str]:
        """Make a request and wait for its reply."""
        replies: list[tuple[bool, str]] = []
        stores = {
            Request.STOP: CommandWriter.stop,
            Request.HOLD: CommandWriter.hold,
            Request.RESUME: CommandWriter.resume,
        }

        def on_reply(done: bool, sentence: str) -> None:
            replies.append((done, sentence))

        if kind == Request.SPEED_SCALE:
            self.serving.command(lambda writer: writer.scale(value), on_reply)
        elif kind in stores:
            self.serving.command(stores[kind], on_reply)
        else:
            self.serving.request(kind, on_reply, value=value)
        self.until(lambda: bool(replies), 1.0)
        (reply,) = replies
        return reply

    def bring_up(self, mock_positions_rad: list[float] | None = None) -> None:
        """What the control process does at its start and when it is asked to enable the drives."""
        assert self.arm.bring_up(mock_positions_rad=mock_positions_rad).failure is None
        assert self.mode is Mode.HOLDING
        self.look()

    # --- the arm

    @property
    def snapshot(self) -> Snapshot:
        return self.arm.reader.snapshot()

    @property
    def mode(self) -> Mode:
        return Mode(int(self.arm.memory["mode"]))

    @property
    def axes(self) -> np.ndarray:
        axes: np.ndarray = self.arm.loop[0]["axes"][: len(self.names)]
        return axes

    @property
    def commanded(self) -> np.ndarray:
        """The newest setpoint, (joints,) rad."""
        position: np.ndarray = self.axes["commanded"]["next_position_rad"].copy()
        return position

    @property
    def measured(self) -> np.ndarray:
        position: np.ndarray = self.axes["measured"]["position_rad"].copy()
        return position

    @property
    def velocity(self) -> np.ndarray:
        """Of the newest setpoint, (joints,) rad/s."""
        velocity: np.ndarray = self.axes["commanded"]["next_velocity_rad_s"].copy()
        return velocity

    @property
    def path(self) -> np.void:
        """The path that the control process runs, with what its goal allows."""
        path: np.void = self.arm.loop[0]["paths"][int(self.arm.memory["goals"]["active"])]
        return path

    @property
    def path_tolerances(self) -> np.ndarray:
        """(joints, 3): position, velocity, acceleration that the running goal allows on its way; 0 = anything."""
        return self._allowed("tolerances")

    @property
    def goal_tolerances(self) -> np.ndarray:
        """(joints, 3): the same at its end."""
        return self._allowed("goal_tolerances")

    def _allowed(self, word: str) -> np.ndarray:
        rows = self.path[word][: len(self.names)]
        return np.stack([rows[name] for name in rows.dtype.names], axis=1)

    def hold_shafts(self, joints: str = "abc") -> None:
        """Something holds these joints' shafts from now on: "stuck" in the words of the cases."""
        for joint in joints:
            self.arm.sim.inject(Stall(joint=joint, at_s=0.0), since_ns=self.arm.now_ns)

    def unplug(self, joint: str) -> None:
        """The drive of a joint neither hears nor answers from now on."""
        self.arm.sim.inject(Silent(joint=joint, at_s=0.0), since_ns=self.arm.now_ns)

    # --- what must hold

    def command_since(self, cycle: int) -> np.ndarray:
        """Setpoints (cycles, joints) from a cycle on."""
        return np.array(self.setpoints[cycle:])

    def assert_never_stepped(self) -> None:
        """Every setpoint so far kept the limits of velocity and acceleration with the configured margins.

        Differences of the commanded positions themselves, not what anything claims about them.
        """
        limits, joints = self.arm.arm.limits, self.arm.arm.joints
        command, period_s = self.command_since(0), self.period_s
        velocity = np.diff(command, axis=0) / period_s
        acceleration = np.diff(velocity, axis=0) / period_s
        rounding = 1.0 + 1e-6
        for column, joint in enumerate(joints):
            fastest = np.abs(velocity[:, column]).max(initial=0.0)
            hardest = np.abs(acceleration[:, column]).max(initial=0.0)
            assert fastest <= limits.velocity_margin * joint.max_velocity_rad_s * rounding
            assert hardest <= limits.acceleration_margin * joint.max_acceleration_rad_s2 * rounding

    def assert_stands(self, seconds: float = 0.5) -> None:
        """Nothing is commanded to move for a while, and nothing moves the arm any more."""
        before = self.commanded
        self.run(seconds)
        assert (self.commanded == before).all() and not self.velocity.any()

    def close(self) -> None:
        self.arm.close()
