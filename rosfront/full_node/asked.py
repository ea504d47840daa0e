"""Translates goals of the full node's actions into waypoints, or refuses them with a sentence that says why.

Pure functions of the goal, the arm and its commanded state. Clients use millimetres, degrees and motor-side angles. A
motor-side angle is 0 at the joint's homing stop: it is the joint's own angle plus its `zero_deg`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from config.kinematics import Poses, flange_pose
from config.schema import ArmConfig
from rosfront.full_node.inverse import Inverse, NoWay, OtherGeometry
from rosfront.full_node.moves import Line, joint_move
from rosfront.full_node.rotations import ORDERS, angles_of, matrix_of
from rosfront.goal import plan_move
from rosfront.plan import GoalPlan, Present
from rosfront.refusals import (
    BadSpeedRatio,
    InMotion,
    MotorAngleBeyondLimit,
    NotANumber,
    TooFineSteps,
    UnknownOrder,
    Unreachable,
)
from rosfront.settings import Settings

DEFAULT_ORDER = "zyx"
DEFAULT_STEP_MM = 8.0
SLOWEST_RATIO = 0.001
"""With it Episode1's longest move takes four hours; a ratio by which it takes years is a client's mistake."""
FINEST_STEP_MM = 0.1
"""Finer steps are refused: between two points the line is straight to some micrometres anyway."""
WITHOUT_GEOMETRY = (
    "The arm file has no kinematics section, so nobody knows where the flange is: add one (episode1.yaml shows how), "
    "or use angle_mode."
)


@dataclass(frozen=True)
class Move:
    """A move that was asked for, ready to be handed to the control process."""

    plan: GoalPlan
    note: str = ""
    """A sentence on what of the request was not taken literally; empty if all was."""
    line: Line | None = None

    @property
    def target_rad(self) -> np.ndarray:
        """Joint angles (6,) at the end."""
        target: np.ndarray = self.plan.joints[-1, :, 0]
        return target


class Moves:
    """Plans the moves of one arm."""

    def __init__(self, arm: ArmConfig) -> None:
        self._arm = arm
        self._zero_deg = np.array([joint.zero_deg for joint in arm.joints])
        self._inverse: Inverse | None = None
        self._no_inverse = WITHOUT_GEOMETRY
        if arm.kinematics is not None:
            try:
                self._inverse = Inverse(arm.kinematics, arm.joints)
            except OtherGeometry as reason:
                self._no_inverse = str(reason)

    # --- what is asked for; all of them raise GoalRefused ---

    def to_angles(self, angles_deg: Sequence[float], speed_ratio: float, present: Present, settings: Settings) -> Move:
        """Plan a move of all joints to motor-side angles (degrees)."""
        target_deg = _finite("angles", angles_deg)
        ratio, note = _ratio(speed_ratio)
        for index, (joint, value_deg) in enumerate(zip(self._arm.joints, target_deg.tolist(), strict=True)):
            slack_deg = math.degrees(joint.command_pulse_rad)
            lower_deg, upper_deg = joint.lower_deg + joint.zero_deg, joint.upper_deg + joint.zero_deg
            if not lower_deg - slack_deg <= value_deg <= upper_deg + slack_deg:
                raise MotorAngleBeyondLimit(index, joint.name, value_deg, lower_deg, upper_deg)
        target_rad = np.radians(target_deg - self._zero_deg)
        return self._joint_move(target_rad, ratio, note, present, settings)

    def to_pose(
        self,
        position_mm: Sequence[float],
        rotation_deg: Sequence[float],
        ik_mode: str,
        speed_ratio: float,
        present: Present,
        settings: Settings,
    ) -> Move:
        """Plan a joint move to a flange pose; of several configurations the one nearest to where the arm stands."""
        inverse = self._with_inverse()
        pose = _pose(position_mm, rotation_deg, "ik_mode", ik_mode)
        ratio, note = _ratio(speed_ratio)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # hostile numbers end up out of reach
                target_rad = inverse.nearest(pose, present.commanded[:, 0])
        except NoWay as reason:
            raise Unreachable(str(reason)) from reason
        return self._joint_move(target_rad, ratio, note, present, settings)

    def straight_to(
        self,
        position_mm: Sequence[float],
        rotation_deg: Sequence[float],
        rotation_mode: str,
        step_mm: float,
        present: Present,
        settings: Settings,
    ) -> Move:
        """Plan a straight line of the flange to a pose."""
        inverse = self._with_inverse()
        pose = _pose(position_mm, rotation_deg, "rotation_mode", rotation_mode or DEFAULT_ORDER)
        step_m = step_of(step_mm) / 1e3
        _at_rest(present)
        with np.errstate(over="ignore", invalid="ignore"):
            line = Line(self._arm, inverse, present.commanded[:, 0], pose)
        return Move(plan_move(line.trajectory(step_m), self._arm, present, settings), line=line)

    def _joint_move(
        self, target_rad: np.ndarray, ratio: float, note: str, present: Present, settings: Settings
    ) -> Move:
        _at_rest(present)
        trajectory = joint_move(self._arm, present.commanded[:, 0], target_rad, ratio)
        return Move(plan_move(trajectory, self._arm, present, settings), note)

    def _with_inverse(self) -> Inverse:
        if self._inverse is None:
            raise Unreachable(self._no_inverse)
        return self._inverse

    # --- what clients are told ---

    def motor_deg(self, positions_rad: np.ndarray) -> list[float]:
        """Motor-side angles (degrees) of joint angles (6,)."""
        angles: list[float] = (np.degrees(positions_rad) + self._zero_deg).tolist()
        return angles

    def flange(self, positions_rad: np.ndarray) -> Poses | None:
        """The flange pose (4, 4) at joint angles (6,); None for an arm without geometry."""
        return None if self._arm.kinematics is None else flange_pose(self._arm.kinematics, positions_rad)


def step_of(step_mm: float) -> float:
    """The step size (mm) that a request means; raises TooFineSteps, NotANumber."""
    if not math.isfinite(step_mm):
        raise NotANumber("step_size", step_mm)
    if 0.0 < step_mm < FINEST_STEP_MM:
        raise TooFineSteps(step_mm, FINEST_STEP_MM, DEFAULT_STEP_MM)
    return step_mm if step_mm > 0.0 else DEFAULT_STEP_MM


def position_and_rotation(pose: Poses, order: str) -> tuple[list[float], list[float]]:
    """A pose (4, 4) as mm and degrees; in the default order where `order` is none of `ORDERS`."""
    rotation_deg = angles_of(pose[:3, :3], order if order in ORDERS else DEFAULT_ORDER)
    return (pose[:3, 3] * 1e3).tolist(), rotation_deg.tolist()


def _pose(position_mm: Sequence[float], rotation_deg: Sequence[float], field: str, order: str) -> Poses:
    position, rotation = _finite("position", position_mm), _finite("rotation", rotation_deg)
    if order not in ORDERS:
        raise UnknownOrder(field, order, ORDERS)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix_of(rotation, order), position / 1e3
    return pose


def _finite(field: str, values: Sequence[float]) -> np.ndarray:
    numbers = np.array(values, dtype=float)
    for index in np.flatnonzero(~np.isfinite(numbers)).tolist():
        raise NotANumber(f"{field}[{index}]", float(numbers[index]))
    return numbers


def _ratio(speed_ratio: float) -> tuple[float, str]:
    """The share of the speed limits that a request means, and a sentence where that is not the requested number."""
    if not speed_ratio >= SLOWEST_RATIO:
        raise BadSpeedRatio(speed_ratio, SLOWEST_RATIO)
    if speed_ratio > 1.0:
        return 1.0, f"speed_ratio {speed_ratio:g} was taken for 1, which is full speed."
    return speed_ratio, ""


def _at_rest(present: Present) -> None:
    if not present.standing or present.awaited:
        raise InMotion
