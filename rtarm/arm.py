"""A running arm from Python: `rtarm.connect`.

Angles are radians, velocities rad/s, times seconds. Motions go through the arm's ordinary action, so that every check
of a MoveIt goal applies; ROS runs in a process of its own, which is started with the first motion and ends with the
`with` block. Everything else, `stop` and `hold` above all, goes straight to the control process through shared memory
and works without ROS.

    with rtarm.connect("my_arm") as arm:
        arm.move({"joint1": 0.2}, speed=0.3)
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from rtarm.client import moves
from rtarm.client.sender import LastingSender, goal_document
from rtarm.console.errors import Refusal
from rtarm.running import referencing, requests
from rtarm.running.arm_file import arm_file
from rtarm.running.limits import Reals, limits_of
from rtarm.running.status import STOPPED_BY_A_PERSON, resolve_arm
from rtarm.running.tracking import AFTER_CYCLE_S
from shm.snapshot import Snapshot
from shm.words import Request

if TYPE_CHECKING:
    from rtarm.running.requests import Connection

LOOK_S = 0.0005
"""Between two looks for a cycle that is late."""
AHEAD = 2.0
"""In how many periods of a stream each of its points is to be reached: one that comes a period late is in time."""
PAUSE_S = 1.0
"""A stream that paused for longer has ended, whatever its points said: the arm must just stand and hold again."""


@dataclass(frozen=True)
class State:
    """An arm at one control cycle; arrays (joints,) in the order of `Arm.joints`.

    Attributes:
        time_s: of the cycle, as `time.monotonic()` counts.
        position_rad, velocity_rad_s: as measured last.
        effort_nm: NaN where the drive measures none.
        commanded_rad: where the joints are told to be.
        measured_s: when each joint was read, as `time.monotonic()` counts; 0: never.
        moves: whether a motion is commanded or goes on.
        held: whether a person has stopped or held the arm; it takes no goals before `Arm.resume`.
        fault: the latched fault in a sentence, "" where there is none.
    """

    time_s: float
    position_rad: Reals
    velocity_rad_s: Reals
    effort_nm: Reals
    commanded_rad: Reals
    measured_s: Reals
    moves: bool
    held: bool
    fault: str


class Stream:
    """Points that an arm is to be at soon, one after the other; see `Arm.stream`."""

    def __init__(self, arm: Arm, period_s: float) -> None:
        self._arm = arm
        self._period_s = period_s
        self._last_rad: Reals | None = None
        self._last_s = time.monotonic()

    def send(self, target: Mapping[str, float] | ArrayLike, velocity_rad_s: ArrayLike | None = None) -> None:
        """Tell the arm where to be a moment from now.

        Args:
            target: joint → angle (rad), or all joints (joints,); a joint that is not named stays.
            velocity_rad_s: of all joints there (joints,), with which the arm runs on where no point follows, until it
                has stopped; zeros at the last point let it end there. Left out: what brought it there.

        Raises:
            Refusal: an angle lies beyond its limits or is none; a person has stopped the arm; a fault is latched; or
                the ROS process is gone.
        """
        paused_s = time.monotonic() - self._last_s
        in_time = paused_s <= AHEAD * self._period_s
        before_rad = self._last_rad if in_time else None  # where the arm is told to be may be elsewhere by now
        sender = self._arm._senders.ready()
        if paused_s > PAUSE_S:
            moves.refuse_unless_holding(self._arm._connection)
        else:
            self._arm._refuse_what_moves_nothing()
        target_rad = self._arm._target_rad(target, before_rad)
        if velocity_rad_s is not None:
            velocity = self._arm._all_joints(velocity_rad_s, "velocity")
        elif before_rad is None:
            velocity = np.zeros(len(target_rad))
        else:
            velocity = (target_rad - before_rad) / max(self._period_s, paused_s)
        self._last_rad, self._last_s = target_rad, time.monotonic()
        ahead_s = np.array([AHEAD * self._period_s])
        goal = goal_document(self._arm.joints, ahead_s, target_rad[None], velocity[None])
        sender.stream(goal)

    def _rest(self) -> None:
        """Wait until the arm stands, after the last point.

        Raises:
            Refusal: it still moves after the longest stop that it may take.
        """
        reached_s = self._last_s + AHEAD * self._period_s
        time.sleep(max(0.0, reached_s - time.monotonic()))
        connection = self._arm._connection
        connection.wait(
            requests.stands,
            connection.patience.person_s,
            f"Arm {self._arm.name} still moves {connection.patience.person_s:.1f} s after the end of the stream: use "
            "the emergency stop, then look at `rtarm status`.",
        )


class Arm:
    """A running arm; made by `connect`.

    Attributes:
        name: of the arm.
        joints: names of its joints, in the order of all arrays.
        limits: of its joints.
    """

    def __init__(self, connection: Connection, senders: LastingSender, opened: ExitStack) -> None:
        self._opened = opened
        self._one_at_a_time = threading.Lock()
        self._connection = connection
        self._senders = senders
        self.name = connection.arm
        self.joints = connection.joints
        self.limits = limits_of(connection.joints, connection.limits())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End what was started; a motion that still runs is cancelled, and the arm stops on its path."""
        self._opened.close()

    def state(self) -> State:
        """The arm at the newest control cycle.

        Raises:
            NotRunning: the control process has ended.
        """
        return self._state(self._newest())

    def states(self) -> Iterator[State]:
        """The arm at each control cycle from now on; cycles that go by while the caller is busy are left out.

        Raises:
            NotRunning: the control process has ended.
        """
        period_s = self._connection.period_s
        cycle = -1
        while True:
            snapshot = self._newest()
            if snapshot["cycle"] == cycle:
                time.sleep(LOOK_S)
                continue
            cycle = snapshot["cycle"]
            yield self._state(snapshot)
            next_s = snapshot["monotonic_ns"] * 1e-9 + period_s + AFTER_CYCLE_S
            time.sleep(max(0.0, next_s - time.monotonic()))

    def move(self, targets: Mapping[str, float], *, speed: float = 0.3, relative: bool = False) -> str:
        """Move joints together in a straight line of the joints, from rest to rest, and wait for the end.

        Nothing sees what stands in the arm's way. Ctrl-C cancels the motion, and the arm stands when it is raised.

        Args:
            targets: joint → angle (rad); the other joints stay.
            speed: share of the joints' limits of velocity and acceleration, above 0 to 1.
            relative: the angles are to be added to where the joints are told to be.

        Returns:
            How it ended, in a sentence.

        Raises:
            Refusal: it did not begin: an unknown joint, an angle beyond its limits, an arm that does not just
                stand and hold, no ROS process. Or it was cancelled and the arm still moves, which the sentence says.
            GoalFailed: it did not succeed; where it had begun, the arm has stopped on its path.
            NotRunning: the control process has ended meanwhile.
        """
        refuse_speed(speed)
        stops = self._stops()
        moves.refuse_unless_holding(self._connection)
        here_rad = self._newest()["joints"][: len(self.joints)]["commanded_position_rad"].copy()
        if relative:
            targets = {joint: here_rad[self._connection.index(joint)] + way for joint, way in targets.items()}
        target_rad = self._target_rad(targets, here_rad)
        if not np.any(np.abs(target_rad - here_rad) > moves.ROUNDING_RAD):
            return f"Arm {self.name} stands there already."
        limits = self.limits
        times_s, *way = moves.slow_move(here_rad, target_rad, limits.velocity_rad_s, limits.acceleration_rad_s2, speed)
        return self._run(goal_document(self.joints, times_s, *way), stops)

    def follow(self, times_s: ArrayLike, positions_rad: ArrayLike, velocities_rad_s: ArrayLike | None = None) -> str:
        """Follow a trajectory of all joints, and wait for the end.

        It must begin near where the arm stands (`limits.start_tolerance_rad` of the arm file) and end at rest.

        Args:
            times_s: of the points, from the start (points,), rising.
            positions_rad: (points, joints).
            velocities_rad_s: the same shape; without them a spline through the positions is followed.

        Returns:
            How it ended, in a sentence.

        Raises:
            Refusal, GoalFailed, NotRunning: as for `move`.
        """
        times, positions = np.asarray(times_s, float), np.asarray(positions_rad, float)
        velocities = None if velocities_rad_s is None else np.asarray(velocities_rad_s, float)
        shape = (len(times) if times.ndim == 1 else -1, len(self.joints))
        for what, values in (("positions", positions), ("velocities", velocities)):
            if values is not None and values.shape != shape:
                raise Refusal(
                    f"The {what} have the shape {values.shape}, but {times.shape} times of {len(self.joints)} joints "
                    f"need {shape}: give one row for each time."
                )
        if not np.isfinite(times).all():
            raise Refusal("A time is no number: give seconds from the start.")
        for values in positions:
            self._target_rad(values, None)
        stops = self._stops()
        moves.refuse_unless_holding(self._connection)
        return self._run(goal_document(self.joints, times, positions, velocities), stops)

    @contextmanager
    def stream(self, rate_hz: float = 50.0) -> Iterator[Stream]:
        """For a loop that decides some 20 to 100 times a second where the arm is to be, as a policy does.

        The arm follows as closely as its limits allow, and stops by itself where no point comes any more. The end of
        the block waits until it stands.

            with arm.stream(rate_hz=50.0) as stream:
                stream.send({"joint1": 0.1})

        Raises:
            Refusal: the arm does not just stand and hold, or there is no ROS process.
        """
        if not 1.0 <= rate_hz <= 250.0:
            raise Refusal(
                f"The rate is {rate_hz:g} Hz, but must be 1 to 250: points are no faster than control cycles."
            )
        moves.refuse_unless_holding(self._connection)
        with self._alone():
            self._senders.ready()
            stream = Stream(self, 1.0 / rate_hz)
            yield stream
            stream._rest()

    def stop(self) -> str:
        """Stop on the path, end the goal, wait until the arm stands; it takes no goals before `resume`."""
        try:
            return requests.stop(self.name)
        finally:
            if (sender := self._senders.present) is not None:
                sender.cancel()

    def hold(self) -> str:
        """Stop on the path and wait until the arm stands; its goal goes on with `resume`."""
        return requests.hold(self.name)

    def resume(self) -> str:
        """Let a held goal go on, and a held or stopped arm take goals again."""
        return requests.resume(self.name)

    def free(self) -> str:
        """Let the drives of a standing arm go limp, to lead it by hand: it falls where gravity pulls it."""
        return requests.let_go(self.name, Request.FREE)

    def enable(self) -> str:
        """Let the drives take hold of a limp arm where it stands."""
        return requests.enable(self.name)

    def clear_fault(self) -> str:
        """Clear the latched fault and bring the drives up again."""
        return requests.clear_fault(self.name)

    def reference(self, angles: Mapping[str, float | None]) -> str:
        """Say where joints stand whose angle is not known (rad), None: where they read. Goals believe it."""
        said_deg = {joint: None if angle is None else math.degrees(angle) for joint, angle in angles.items()}
        return referencing.reference(self.name, said_deg)

    # -- within ----------------------------------------------------------------------------------------

    def _stops(self) -> int:
        return int(self._newest()["stops"])

    def _run(self, goal: dict[str, Any], stops: int) -> str:
        """Send a goal and wait for its end; never one that was asked for before a stop, nor in place of another."""
        with self._alone():
            sender = self._senders.ready()  # which may take seconds
            moves.refuse_unless_holding(self._connection)
            if self._stops() != stops:
                raise Refusal("The arm was stopped before the motion could begin; nothing has moved.")
            return moves.run(self._connection, sender, goal)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """While this program moves the arm in one way, it does in no other."""
        if not self._one_at_a_time.acquire(blocking=False):
            raise Refusal(f"This program moves arm {self.name} already: wait for the end of that motion or stream.")
        try:
            yield
        finally:
            self._one_at_a_time.release()

    def _newest(self) -> Snapshot:
        snapshot = self._connection.snapshot()
        self._connection.check_running()
        return snapshot

    def _state(self, snapshot: Snapshot) -> State:
        rows = snapshot["joints"][: len(self.joints)]
        return State(
            time_s=snapshot["monotonic_ns"] * 1e-9,
            position_rad=rows["measured_position_rad"].copy(),
            velocity_rad_s=rows["measured_velocity_rad_s"].copy(),
            effort_nm=rows["measured_effort"].copy(),
            commanded_rad=rows["commanded_position_rad"].copy(),
            measured_s=rows["measured_ns"] * 1e-9,
            moves=not requests.stands(snapshot),
            held=bool(snapshot["held"]),
            fault=self._connection.fault(snapshot),
        )

    def _refuse_what_moves_nothing(self) -> None:
        moves.refuse_unsound(self._connection)
        if self._newest()["held"]:
            raise Refusal(STOPPED_BY_A_PERSON)

    def _all_joints(self, values: ArrayLike, what: str) -> Reals:
        found = np.asarray(values, float)
        if found.shape != (len(self.joints),):
            raise Refusal(
                f"The {what} has the shape {found.shape}, but must have one number for each of {self.joints}."
            )
        if not np.isfinite(found).all():
            joint = self.joints[int(np.argmin(np.isfinite(found)))]
            raise Refusal(f"The {what} of {joint} is no number.", joint=joint)
        return found

    def _target_rad(self, target: Mapping[str, float] | ArrayLike, others_rad: Reals | None) -> Reals:
        """All joints (joints,) of a target; raises Refusal for one that no joint can have.

        Args:
            others_rad: where joints stay that are not named; None: where they are told to be.
        """
        if isinstance(target, Mapping):
            if others_rad is None:
                others_rad = self._newest()["joints"][: len(self.joints)]["commanded_position_rad"]
            named = {self._connection.index(joint): angle for joint, angle in target.items()}
            target = others_rad.copy()
            for index, angle in named.items():
                target[index] = angle
        target_rad = self._all_joints(target, "angle")
        limits = self.limits
        inside_rad = np.clip(target_rad, limits.lower_rad, limits.upper_rad)
        target_rad = np.where(np.abs(inside_rad - target_rad) <= moves.ROUNDING_RAD, inside_rad, target_rad)
        for joint, value, lower, upper in zip(self.joints, target_rad, limits.lower_rad, limits.upper_rad, strict=True):
            if not lower <= value <= upper:
                limit = lower if value < lower else upper
                raise Refusal(
                    f"{joint} would have to go to {value:.4f} rad ({math.degrees(value):.2f}°), but may only be "
                    f"{lower:.4f} to {upper:.4f} rad ({math.degrees(lower):.2f}° to {math.degrees(upper):.2f}°); "
                    "nothing has moved.",
                    joint=joint,
                    value=float(value),
                    limit=float(limit),
                )
        return target_rad


def refuse_speed(speed: float) -> None:
    """Raise Refusal where it is no share of the joints' limits."""
    if not 0.0 < speed <= 1.0:
        raise Refusal(f"The speed is {speed:g}, but must be above 0 and at most 1, a share of the joints' limits.")


def connect(arm: str | None = None, *, namespace: str = "") -> Arm:
    """Connect to a running arm: for the time of a `with` block, or until `Arm.close`.

    Args:
        arm: its name, or the path of its arm file; None: the only one that runs.
        namespace: the ROS namespace of its front, if it was started in one.

    Raises:
        Refusal: no arm runs, or several do and none was named.
        NotRunning: it does not run, or has died.
    """
    name = resolve_arm(arm)
    with ExitStack() as opened:
        connection = opened.enter_context(requests.connect(name))
        senders = LastingSender(name, lambda: arm_file(arm, name, "rtarm.connect"), namespace)
        opened.callback(senders.close)
        return Arm(connection, senders, opened.pop_all())
