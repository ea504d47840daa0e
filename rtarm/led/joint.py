"""A joint that its ordinary control process leads alone: what is asked of it, and what is seen of it.

A drive of any family is brought up, led, fallen silent to, let go and cleared by the very code that does so every day.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from config.schema import ArmConfig
from rtarm.console.errors import Refusal
from rtarm.running.requests import Condition, Connection, cleared, enabled, limp, see_to_the_end
from rtarm.running.status import STOPPED_BY_A_PERSON
from rtloop.offline.commissioning.finding import Said, frames_of
from sentences.told import outcome_sentence
from shm.client import CommandWriter, StateReader
from shm.errors import TornRead
from shm.recording import Position, now_at, read_on
from shm.snapshot import Snapshot
from shm.words import DriveStatus, Fault, Mode, Outcome, Request

DECIDED_S = 0.5
REST_TO_REST = 5
"""Order of a segment with which a joint goes from rest to rest: a quintic."""
FASTEST, HARDEST = 1.875, 5.774
"""Largest velocity and acceleration of such a segment, in way / T and way / T²: 15/8 and 10/√3."""


FRESH_S = 0.5
"""A reading that is older says nothing of how the drive is now."""
AT_EASE_RAD = 0.1
"""A joint that is led may be so far from its path before its goal ends; its following error ends more."""


class Cause(Enum):
    """What ended a goal."""

    ARRIVED = "its joint arrived"
    BEHIND = "its joint stayed behind, or its protection tripped"
    DRIVE = "its drive let go, lost its power or refuses to move"
    ELSEWHERE = "a refusal, a person, the bus or this machine, which says nothing of the drive"


class End(NamedTuple):
    """How a goal ended."""

    cause: Cause
    sentence: str = ""
    """Empty where the joint arrived."""


_OF_OUTCOMES = {
    Outcome.SUCCEEDED: Cause.ARRIVED,
    Outcome.PATH_TOLERANCE: Cause.BEHIND,
    Outcome.GOAL_TOLERANCE: Cause.BEHIND,
}
_OF_FAULTS = {
    Fault.FOLLOWING_ERROR: Cause.BEHIND,
    Fault.DRIVE_FAULT: Cause.DRIVE,
    Fault.REFERENCE_LOST: Cause.DRIVE,
}


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
        """What the newest snapshot says of the joint (layout.Joint)."""
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

    def until(self, condition: Condition, patience_s: float) -> Snapshot | None:
        """The first snapshot that fulfils a condition; None where none does in time."""
        ends_ns = self.now_ns() + round(patience_s * 1e9)
        while not condition(now := self.snapshot()):
            if self.now_ns() >= ends_ns:
                return None
            self._pass_time()
        return now

    def wait(self, condition: Condition, patience_s: float, too_long: str) -> Snapshot:
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

    def hindrance(self) -> str:
        """What keeps it from moving, a fault or a person, "" where nothing does; raises Refusal.

        Whoever brings it up just now is waited for.
        """
        now = self.wait(
            lambda now: _at_fault(now) or now["mode"] == Mode.HOLDING,
            self.patience.bring_up_s,
            f"{self.name} is not brought up.",
        )
        return self.fault(now) or (STOPPED_BY_A_PERSON if now["held"] else "")

    def clear(self) -> None:
        """Take that away: its drive is enabled where it stands; raises Refusal."""
        cleared(self)
        self._writer.resume()
        self.wait_heard(lambda now: not now["held"])

    def let_go(self) -> None:
        """Let a person turn it; raises Refusal where it is not limp."""
        limp(self, Request.FREE)

    def hold(self) -> None:
        """Have it held where it stands; raises Refusal where it is not."""
        enabled(self)

    def home(self) -> None:
        """Let its drive find its stop, as far as that can; raises Refusal where it does not."""
        self.order(Request.HOME, joint_mask=1)
        if fault := self.fault(see_to_the_end(self, lambda _: None)):
            raise Refusal(fault)

    def drive_refused(self) -> bool:
        """Whether it was the drive that ended its bring-up, and not the bus or this machine."""
        return bool(self.snapshot()["fault"] == Fault.BRING_UP)

    def is_disabled(self) -> bool:
        """Whether its drive said last that it holds nothing."""
        status = int(self.joint()["drive_status"])
        return not status & DriveStatus.ENABLED or bool(status & DriveStatus.PROTECTED)

    def not_seen_to_stand(self) -> str:
        """Why nobody knows that its drive stands and holds the joint, a sentence; "" where that was seen last."""
        try:
            now = self.snapshot()
        except TornRead:
            return f"What {self.name} did last is not known."
        joint = now["joints"][0]
        if silent_for_s(now) > FRESH_S:
            return f"The drive of {self.name} did not answer at the end."
        if self.is_disabled():
            return f"The drive of {self.name} is limp."
        away_rad = abs(float(joint["commanded_position_rad"] - joint["measured_position_rad"]))
        if not joint["referenced"]:  # it goes nowhere but to its stop, and where it was is no place to be away from
            away_rad = 0.0
        homes = now["mode"] == Mode.REFERENCING
        moves = homes or bool(joint["commanded_velocity_rad_s"]) or away_rad > AT_EASE_RAD
        return f"{self.name} was still on its way." if moves else ""

    def reference(self, angle_rad: float) -> None:
        """Say where the joint stands; raises Refusal where that is not taken."""
        self.order(Request.REFERENCE, joint_mask=1, value=angle_rad)
        now = self.wait(
            lambda now: _at_fault(now) or (now["mode"] == Mode.HOLDING and bool(now["joints"][0]["referenced"])),
            self.patience.bring_up_s,
            f"The angle of {self.name} is not taken.",
        )
        if fault := self.fault(now):
            raise Refusal(fault)

    @contextmanager
    def stopped_by_any_end(self) -> Iterator[None]:
        """A motion is stopped by whatever ends this early, and at once: before anything is put in order."""
        try:
            yield
        except BaseException:
            self._writer.stop()
            raise

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
            epoch=now["epoch"],
            tolerances=path,
            consumed=consumed(),
        )
        here_rad = float(now["joints"][0]["commanded_position_rad"])
        for at_ns, place_rad in ((0, here_rad), (round(seconds * 1e9), to_rad)):
            self._writer.waypoint(goal, at_ns, REST_TO_REST, np.array([[place_rad, 0.0, 0.0]]), consumed())
        self._writer.end(goal, path, consumed())
        return goal

    def end_of(self, goal: int, patience_s: float, look: Callable[[Any], None] = lambda joint: None) -> End:
        """How a goal ended, which is stopped where it does not in time; `look` gets the joint of each snapshot."""

        def result(now: Any) -> Any:
            look(now["joints"][0])
            found = now.find("results", "goal_id", goal)
            return found if found is not None and int(found["outcome"]) != Outcome.NONE else None

        now = self.until(lambda now: result(now) is not None, patience_s)
        if now is None:
            self._writer.stop()  # it may be paused, and would go on when that is over
            return End(Cause.ELSEWHERE, "Its goal did not end in time, and was stopped.")
        found = result(now)
        outcome = Outcome(int(found["outcome"]))
        if _at_fault(now) and outcome != Outcome.SUCCEEDED:
            return End(_cause_of_fault(now), self.fault(now))
        cause = _OF_OUTCOMES.get(outcome, Cause.ELSEWHERE)
        if cause is Cause.ARRIVED:
            return End(cause)
        return End(cause, outcome_sentence(outcome, self.name, float(found["value"]), float(found["limit"])))


def silent_for_s(snapshot: Snapshot) -> float:
    """For how long its drive has not been heard."""
    return (int(snapshot["monotonic_ns"]) - int(snapshot["joints"][0]["measured_ns"])) * 1e-9


def _at_fault(snapshot: Snapshot) -> bool:
    return bool(snapshot["fault"] != Fault.NONE)


def _cause_of_fault(snapshot: Snapshot) -> Cause:
    fault = Fault(snapshot["fault"])
    if fault == Fault.DRIVE_FAULT and int(snapshot["joints"][0]["drive_status"]) & DriveStatus.PROTECTED:
        return Cause.BEHIND
    return _OF_FAULTS.get(fault, Cause.ELSEWHERE)


def seconds_for(arm: ArmConfig, way_rad: float, share: float) -> float:
    """Duration of a move from rest to rest that uses such a share of the joint's velocity and acceleration at most."""
    joint = arm.joints[0]
    return max(
        FASTEST * way_rad / (share * joint.max_velocity_rad_s),
        math.sqrt(HARDEST * way_rad / (share * joint.max_acceleration_rad_s2)),
    )


def alone(arm: ArmConfig, joint: int) -> dict[str, Any]:
    """What an arm file says of one of its joints alone and of its bus, which is taken over as it stands."""
    values = arm.model_dump(mode="json", exclude_unset=True)
    buses = values["bus"] if isinstance(values["bus"], list) else [values["bus"]]
    kept = {name: value for name, value in values.items() if name not in ("gripper", "parking", "kinematics")}
    return {
        **kept,
        "bus": buses[arm.bus_number(arm.joints[joint])],
        "joints": [values["joints"][joint]],
        "homing": {"timeout_s": arm.homing.timeout_s},
        "control": {**values["control"], "init_mode": 1},
        "realtime": {**values.get("realtime", {}), "require": False},
    }
