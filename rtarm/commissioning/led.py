"""A joint that its ordinary control process leads, alone on its bench: what is asked of it, and what is seen of it.

Bench tests of families whose own dialogues check nothing more: a drive is brought up, led, fallen silent to and cleared
by the very code that does so every day.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

import numpy as np

from config.schema import ArmConfig
from rtarm.errors import Refusal
from rtarm.requests import Condition, Connection, cleared
from rtloop.commissioning.finding import Said, frames_of
from shm.client import CommandWriter, StateReader, find
from shm.errors import TornRead
from shm.recording import Position, now_at, read_on
from shm.sentences import outcome_sentence
from shm.words import Fault, Mode, Outcome, Request

DECIDED_S = 0.5
REST_TO_REST = 5
"""Order of a segment with which a joint goes from rest to rest: a quintic."""
FASTEST, HARDEST = 1.875, 5.774
"""Largest velocity and acceleration of such a segment, in way / T and way / T²: 15/8 and 10/√3."""


class Led(Connection):
    """The connection to an arm of one joint.

    `pass_time` lets a little time pass, in which its control process goes on and hears that somebody is there;
    `standing_still` is a context in which that process does nothing, so that its drive hears nothing more.
    """

    def __init__(
        self,
        config: ArmConfig,
        reader: StateReader,
        writer: CommandWriter,
        *,
        pass_time: Callable[[], None],
        now_ns: Callable[[], int],
        standing_still: Callable[[], AbstractContextManager[None]],
    ) -> None:
        super().__init__(config.name, reader, writer)
        self.config = config
        self.name = config.joints[0].name
        self.now_ns = now_ns
        self._pass_time, self._standing_still = pass_time, standing_still
        self._since: Position = now_at(reader.memory)

    def joint(self) -> Any:
        """What the newest snapshot says of the joint (dtype layout.JOINT)."""
        return self.snapshot()["joints"][0]

    @property
    def referenced(self) -> bool:
        """Whether what the drive counts is known to mean an angle."""
        return bool(self.joint()["referenced"])

    def frames(self) -> list[Said]:
        """What was said on the bus since the last look."""
        recording, self._since = read_on(self._reader.memory, self._since)
        return frames_of(recording.frames)

    def let_pass(self, seconds: float) -> None:
        """Let time pass."""
        self.until(lambda _: False, seconds)

    def until(self, condition: Condition, patience_s: float) -> np.ndarray | None:
        """The first snapshot that fulfils a condition; None where none does in time."""
        ends_ns = self.now_ns() + round(patience_s * 1e9)
        while not condition(now := self.snapshot()):
            if self.now_ns() >= ends_ns:
                return None
            self._pass_time()
        return now

    def wait(self, condition: Condition, patience_s: float, too_long: str) -> np.ndarray:
        now = self.until(condition, patience_s)
        if now is None:
            raise Refusal(too_long)
        return now

    def order(self, kind: Request, *, joint_mask: int = 0, value: float = 0.0) -> None:
        """Make a request as soon as the joint is at rest; raises Refusal with the sentence where it is refused."""
        ends_ns = self.now_ns() + round(self.patience.person_s * 1e9)
        while True:
            try:
                return super().order(kind, joint_mask=joint_mask, value=value)
            except Refusal:
                if self.now_ns() >= ends_ns:
                    raise
            self._pass_time()

    def say_nothing(self, seconds: float) -> tuple[Any, Any | None]:
        """Let its control process do nothing; the snapshots of before, and with its first reading since, if one comes.

        What follows from the silence is decided when this returns.
        """
        before = self.snapshot()
        with self._standing_still():
            with suppress(TornRead):  # it may stand still amid writing one
                before = self.snapshot()
            ends_ns = self.now_ns() + round(seconds * 1e9)
            while self.now_ns() < ends_ns:
                self._pass_time()
            # one that was on its way is stamped when the process goes on
            heard_ns = self.now_ns() + 3 * self.config.control.period_ns
        after = self.until(lambda now: int(now["joints"][0]["measured_ns"]) > heard_ns, self.patience.bring_up_s)
        self.let_pass(DECIDED_S)
        return before, after

    def hold(self) -> None:
        """Clear its fault, if there is one, and see it hold, whoever else brings it up; raises Refusal."""
        self.wait(
            lambda now: _at_fault(now) or int(now["mode"]) == Mode.HOLDING,
            self.patience.bring_up_s,
            f"{self.name} is not brought up.",
        )
        cleared(self)

    def reference(self, angle_rad: float) -> None:
        """Say where the joint stands; raises Refusal where that is not taken."""
        self.order(Request.REFERENCE, joint_mask=1, value=angle_rad)
        now = self.wait(
            lambda now: _at_fault(now) or (int(now["mode"]) == Mode.HOLDING and bool(now["joints"][0]["referenced"])),
            self.patience.bring_up_s,
            f"The angle of {self.name} is not taken.",
        )
        if fault := self.fault(now):
            raise Refusal(fault)

    def go(self, to_rad: float, seconds: float, tolerance_rad: float) -> int:
        """Send it there, from rest to rest, no farther from its path than so; the goal's number."""
        goal = self._writer.announced_goal + 1
        consumed = self._reader.setpoints_consumed
        now = self.snapshot()
        path = np.array([[tolerance_rad, 0.0, 0.0]])
        self._writer.announce(goal)
        self._writer.begin(
            goal,
            start_ns=0,
            joint_mask=1,
            goal_time_s=1.0,
            entry=0,
            epoch=int(now["epoch"]),
            tolerances=path,
            consumed=consumed(),
        )
        here_rad = float(now["joints"][0]["commanded_position_rad"])
        for at_ns, place_rad in ((0, here_rad), (round(seconds * 1e9), to_rad)):
            self._writer.knot(goal, at_ns, REST_TO_REST, np.array([[place_rad, 0.0, 0.0]]), consumed())
        self._writer.end(goal, path, consumed())
        return goal

    def end_of(self, goal: int, patience_s: float) -> str | None:
        """How a goal ended, in a sentence, "" for success; None where it has not in time."""

        def result(now: Any) -> Any:
            found = find(now["results"], "goal_id", goal)
            return found if found is not None and int(found["outcome"]) != Outcome.NONE else None

        now = self.until(lambda now: result(now) is not None, patience_s)
        if now is None:
            return None
        found = result(now)
        if int(found["outcome"]) == Outcome.SUCCEEDED:
            return ""
        if fault := self.fault(now):
            return fault
        return outcome_sentence(int(found["outcome"]), self.name, float(found["value"]), float(found["limit"]))


def _at_fault(snapshot: np.ndarray) -> bool:
    return int(snapshot["fault"]) != Fault.NONE


def seconds_for(arm: ArmConfig, way_rad: float, share: float) -> float:
    """Duration of a move from rest to rest that uses such a share of the joint's velocity and acceleration at most."""
    joint = arm.joints[0]
    return max(
        FASTEST * way_rad / (share * joint.max_velocity_rad_s),
        math.sqrt(HARDEST * way_rad / (share * joint.max_acceleration_rad_s2)),
    )


def alone(arm: ArmConfig, joint: int) -> dict[str, Any]:
    """What an arm file says of one of its joints alone, which is taken over as it stands."""
    values = arm.model_dump(mode="json", exclude_unset=True)
    kept = {name: value for name, value in values.items() if name not in ("gripper", "parking", "kinematics", "homing")}
    return {
        **kept,
        "joints": [values["joints"][joint]],
        "control": {**values["control"], "init_mode": 1},
        "realtime": {**values.get("realtime", {}), "require": False},
    }
