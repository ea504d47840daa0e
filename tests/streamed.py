"""Messages of `~/joint_trajectory` as the front makes plans of them, and the stream recorded from MoveIt Servo."""

import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from commanded import CommandedArm
from servo import Servo, SinglePoints

from config.schema import ArmConfig
from rosfront.goal import plan_stream
from rosfront.path import PlannedPath
from rosfront.plan import GoalPlan, Present
from rosfront.points import Columns
from rosfront.settings import Settings
from shm.words import Mode, Outcome

SERVO = Path(__file__).parent / "data" / "servo" / "jog_and_twist.json.gz"
SERVO_POSE_RAD = (0.0, 0.0, 0.0, 0.0, np.radians(30.0), 0.0)
NS = 1_000_000_000


@dataclass(frozen=True)
class Message:
    """A message, and when it came (ns after the first one)."""

    came_ns: int
    stamp_ns: int
    joint_names: list[str]
    times_ns: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None

    def trajectory(self) -> Any:
        """What the front reads of its bytes."""
        count, width = self.positions.shape
        none = (np.zeros(count, np.int64), np.empty(0))
        velocities = none if self.velocities is None else (np.full(count, width), self.velocities.ravel())
        points = Columns(self.times_ns, (np.full(count, width), self.positions.ravel()), velocities, none, none)
        stamp = SimpleNamespace(sec=self.stamp_ns // NS, nanosec=self.stamp_ns % NS)
        return SimpleNamespace(header=SimpleNamespace(stamp=stamp), joint_names=self.joint_names, points=points)


def recorded_servo() -> list[Message]:
    """The recording, its stamps counted from the first one's."""
    recorded = json.loads(gzip.decompress(SERVO.read_bytes()))
    first_ns = recorded[0]["stamp_ns"]
    return [
        Message(
            round(message["t_s"] * NS),
            message["stamp_ns"] - first_ns,
            message["joint_names"],
            np.array([round(point["t_s"] * NS) for point in message["points"]]),
            np.array([point["positions"] for point in message["points"]]),
            np.array([point["velocities"] for point in message["points"]]),
        )
        for message in recorded
    ]


class Front:
    """What judges messages in the front, for an arm on which its plans are followed to the last digit."""

    EPOCH_NS = 1_700_000_000 * NS
    """System time at `begun_ns`."""

    def __init__(self, arm: ArmConfig, begun_ns: int) -> None:
        self.arm, self.begun_ns = arm, begun_ns
        self.settings = Settings.of(arm)
        self.newest: GoalPlan | None = None
        self.shaped = 0

    def judge(self, message: Message, commanded: np.ndarray, now_ns: int, *, standing: bool, over: bool) -> GoalPlan:
        """The plan of a message that came at `now_ns`; `over`: the stream before has ended."""
        stamped = Message(**{**vars(message), "stamp_ns": message.stamp_ns and message.stamp_ns + self.EPOCH_NS})
        present = Present(commanded, standing, now_ns, self.EPOCH_NS + now_ns - self.begun_ns)
        earlier = None if over else self.newest
        self.newest = plan_stream(stamped.trajectory(), self.arm, present, self.settings, earlier)
        self.shaped += self.newest.wanted is not None
        return self.newest


class FollowedArm:
    """An arm that is wherever its newest plan says, from the cycle after a message on: what is asked of the drives."""

    def __init__(self, arm: ArmConfig, here: np.ndarray) -> None:
        self.arm, self.here = arm, np.asarray(here, float)
        self.now_ns = 1_000_000_000
        self.front = Front(arm, self.now_ns)
        self.waiting: GoalPlan | None = None
        self.plan: GoalPlan | None = None
        self.positions = [self.here.copy()]

    @property
    def period_ns(self) -> int:
        return self.arm.control.period_ns

    def state(self, plan: GoalPlan | None, time_ns: int) -> np.ndarray:
        """Position, velocity and acceleration (joints, 3) at a time of the arm's clock."""
        state = np.zeros((len(self.here), 3))
        state[:, 0] = self.here
        if plan is not None:
            path = PlannedPath(plan)
            state[path.mask] = np.stack(path.at(np.array([time_ns - plan.start_ns])), axis=2)[0]
        return state

    def take(self, message: Message) -> GoalPlan:
        """Judge a message now; the next cycle begins with it."""
        commanded = self.state(self.plan, self.now_ns)
        still = self.plan is None
        self.waiting = self.front.judge(message, commanded, self.now_ns, standing=still, over=still)
        return self.waiting

    def cycle(self) -> None:
        if self.waiting is not None:
            self.plan, self.waiting = self.waiting, None
        self.now_ns += self.period_ns
        self.here = self.state(self.plan, self.now_ns)[:, 0]
        self.positions.append(self.here.copy())


class StreamedArm(CommandedArm):
    """An arm in virtual time to which messages come by way of the front."""

    def __init__(self, arm: ArmConfig | str = "mock", start_rad: Any = None, **options: Any) -> None:
        super().__init__(arm, start_rad, **options)
        self.front = Front(self.arm, self.now_ns)
        self.streams: list[int] = []

    def take(self, message: Message) -> GoalPlan:
        """Judge a message now and hand it to the control process."""
        now = self.loop[0]["axes"]["commanded"][: len(self.arm.joints)]
        commanded = np.stack([now[what] for what in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")], axis=1)
        standing = self.memory["mode"] == Mode.HOLDING
        over = not self.streams or self.outcome(self.streams[-1]) != Outcome.NONE
        plan = self.front.judge(message, commanded, self.now_ns, standing=standing, over=over)
        goal = self.send_goal(
            plan.times_ns,
            plan.joints,
            order=plan.orders,
            stream=True,
            approach=plan.approach,
            start_ns=plan.start_ns,
            joint_mask=plan.joint_mask,
        )
        self.streams.append(goal)
        return plan

    def play_messages(self, messages: list[Message], late_ns: int = 0) -> None:
        """Let messages come when they came, their stamps being `late_ns` behind; cycles in between."""
        for message in messages:
            while self.now_ns < self.front.begun_ns + message.came_ns + late_ns:
                self.cycle()
            self.take(message)


class _ByTheFront(Servo):
    """A sender whose messages the front judges."""

    arm: StreamedArm

    def hand_on(self, times_ns: np.ndarray, rows: np.ndarray, start_ns: int) -> None:
        """Have the front judge a message, and the control process given what comes of it."""
        names = [joint.name for joint in self.arm.arm.joints]
        stamp_ns = start_ns and start_ns - self.arm.front.begun_ns
        self.arm.take(Message(0, stamp_ns, names, times_ns, rows[:, :, 0], rows[:, :, 1]))


class JudgedServo(_ByTheFront):
    """MoveIt Servo as the control process hears of it."""


class JudgedPoints(_ByTheFront, SinglePoints):
    """Points one by one, as the control process hears of them."""
