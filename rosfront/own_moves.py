"""Moves that the arm file asks for, not a client: to a pose after homing at the start, and to park at the end.

They are ordinary trajectories: planned from where the arm stands, checked, and handed on through the same ring.
"""

import math
from collections.abc import Callable

import numpy as np

from config.homing import ParkingConfig, PoseMove
from config.schema import ArmConfig
from rosfront.full_node.moves import joint_move
from rosfront.goal import plan_move
from rosfront.plan import GoalPlan
from rosfront.refusals import GoalRefused, InMotion, ParkingTooLong
from rosfront.serving import Serving
from rosfront.verdict import Status, Verdict
from shm.snapshot import Snapshot
from shm.words import Mode

Tell = Callable[[str], object]


class OwnMoves:
    """The moves that one arm's file asks for."""

    def __init__(self, arm: ArmConfig, serving: Serving, put: Callable[[Callable[[], None]], None], tell: Tell) -> None:
        """`put` runs a function in the thread that checks goals; `tell` is called with sentences for the operator."""
        self._arm, self._serving, self._put, self._tell = arm, serving, put, tell
        self._pose = arm.homing.then
        self._taken_up = False

    def look(self, snapshot: Snapshot) -> None:
        """Begin the move to the pose once the arm was homed at its start; call in the publisher's thread."""
        pose = self._pose
        if pose is None:
            return
        if not snapshot["pose_due"]:
            self._taken_up = False
        elif not self._taken_up and snapshot["mode"] == Mode.HOLDING:
            self._put(lambda: self._go_to(pose))
            self._taken_up = True

    def _go_to(self, pose: PoseMove) -> None:
        arrival = self._serving.arrival()  # before planning: a goal that is begun meanwhile takes precedence
        try:
            plan = self._plan(pose)
            newest = self._serving.newest()
            if newest is not None and not newest["pose_due"]:
                return  # so does a request that is no goal
            self._serving.start(plan, self._tell_end_of_pose, arrival=arrival)
        except GoalRefused as reason:
            self._tell(f"The arm does not go to its pose after homing: {reason.sentence}")
        else:
            self._tell("The arm is homed and goes to the pose that its file names (homing.then).")

    def _tell_end_of_pose(self, verdict: Verdict) -> None:
        reached = verdict.status is Status.SUCCEEDED
        said = "The pose after homing is reached." if reached else "The pose after homing is not reached:"
        self._tell(f"{said} {verdict.sentence}")

    def park(self, parking: ParkingConfig, on_end: Callable[[], object]) -> bool:
        """Begin to park if the arm is at rest, else tell why not; returns whether parking was begun.

        `on_end` is called once parking has ended, in whatever way.
        """

        def ended(verdict: Verdict) -> None:
            self._tell("Parked." if verdict.status is Status.SUCCEEDED else f"Not parked: {verdict.sentence}")
            on_end()

        arrival = self._serving.arrival()
        try:
            plan = self._plan(parking)
            newest = self._serving.newest()
            speed_scale = 0.0 if newest is None else newest["speed_scale_asked"]
            takes_s = plan.times_ns[-1] * 1e-9 / speed_scale if speed_scale > 0.0 else math.inf
            if takes_s > parking.timeout_s:
                raise ParkingTooLong(takes_s, parking.timeout_s, speed_scale)
            self._serving.start(plan, ended, arrival=arrival)
        except GoalRefused as reason:
            self._tell(f"Not parked: {reason.sentence}")
            return False
        self._tell(f"Parking, for {takes_s:.1f} s; a second signal stops the arm instead.")
        return True

    def _plan(self, pose: PoseMove) -> GoalPlan:
        """Plan a move from rest; raises GoalRefused, InMotion when the arm moves or a goal is undecided."""
        present = self._serving.present(for_own_move=True)
        if not present.standing or not self._serving.idle:
            raise InMotion
        trajectory = joint_move(self._arm, present.commanded[:, 0], np.array(pose.target_rad), pose.speed_ratio)
        return plan_move(trajectory, self._arm, present, self._serving.settings)
