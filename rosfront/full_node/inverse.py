"""Joint angles that bring the flange of an arm into a pose: the closed solution for arms with a spherical wrist.

It is for six joints whose last three axes meet in one point, on a shoulder whose first axis is perpendicular to two
parallel ones: Episode1 and most industrial arms. Then the point where the axes meet decides the first three joints and
the rotation the last three (Pieper 1968), with two choices each for shoulder, elbow and wrist:

- *shoulder*: with joint 1 the arm turns towards the point, or away from it and reaches over itself;
- *elbow*: two sides of known length close the triangle to the point on either side;
- *wrist*: joint 5 tilts the hand to one side, or joint 4 turns half round and joint 5 tilts to the other.

All eight solutions are computed, for many poses at once. So "out of reach" and "only outside the limits of a joint" are
facts, not failures of a search, and a path through space can be followed on one of the solutions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.geometry import KinematicsConfig
from config.joint import JointConfig
from config.kinematics import Poses, flange_pose, link_poses

Angles = NDArray[np.float64]
"""Joint angles (…, 6) in rad."""

JOINTS = 6
WAYS = 8
_SAME = 1e-9
"""Lengths (m), sines and shares of a reach up to this count as 0."""
_LOCKED = 1e-7
"""Sine of the wrist's tilt, or distance (m) from the first axis, below which an angle is free to choose."""


class NoWay(Exception):
    """The flange cannot be brought into a pose; the text is one sentence that says why."""


class OtherGeometry(NoWay):
    """The closed solution does not apply to this arm."""


class OutOfReach(NoWay):
    """No joint angles at all give the pose."""


class OutsideLimits(NoWay):
    """Joint angles exist, but only outside the limits of `joint`, which would stand at `angle_rad`."""

    def __init__(self, joint: JointConfig, angle_rad: float) -> None:
        super().__init__(
            f"It is in reach only with {joint.name} outside its limits, at {math.degrees(angle_rad):.1f}°, and allowed "
            f"are {joint.lower_deg:g}° to {joint.upper_deg:g}°: choose another position or rotation."
        )
        self.joint = joint.name
        self.angle_rad = angle_rad


@dataclass(frozen=True)
class Solutions:
    """All solutions for some poses."""

    angles_rad: Angles
    """(8, n, 6), each angle within half a turn of the seed's; NaN where a solution does not exist."""
    room: NDArray[np.float64]
    """(3, 8, n): how far each is from a singularity, where two solutions become one: of the shoulder (m from the first
    axis), of the elbow (sine of the angle between its sides), of the wrist (sine of its tilt)."""


class Inverse:
    """The inverse of `config.kinematics.flange_pose` for one arm."""

    def __init__(self, kinematics: KinematicsConfig, joints: Sequence[JointConfig]) -> None:
        """Raises OtherGeometry, naming the row of the table that does not fit."""
        _check_geometry(kinematics)
        self._kinematics, self._joints = kinematics, joints
        self.lower_rad = np.array([joint.lower_rad for joint in joints])
        self.upper_rad = np.array([joint.upper_rad for joint in joints])
        self.slack_rad = np.array([joint.slack_rad for joint in joints])
        """How far (rad) rounding may put a joint that stands at its limit beyond that limit."""
        rows = kinematics.dh
        self._signs = np.array([float(row.sign) for row in rows])
        self._offsets_rad = np.array([row.offset_rad for row in rows])
        self._alphas = [_about_x(row.alpha_rad) for row in rows]
        self._hand_m = np.array([rows[5].a_m, 0.0, rows[5].d_m])
        forearm = np.array([rows[2].a_m, -math.sin(rows[2].alpha_rad) * rows[3].d_m])
        self._elbow_m, self._elbow_rad = float(np.hypot(*forearm)), math.atan2(forearm[1], forearm[0])
        self._parallel = math.cos(rows[1].alpha_rad)  # 1 or -1
        self._square = math.sin(rows[0].alpha_rad)  # 1 or -1
        self._wrist_square = math.sin(rows[3].alpha_rad) * math.sin(rows[4].alpha_rad)  # 1 or -1
        along_m = rows[2].d_m + math.cos(rows[2].alpha_rad) * rows[3].d_m
        self._aside_m = rows[1].d_m + self._parallel * along_m

    def solutions(self, poses: Poses, seed_rad: Angles) -> Solutions:
        """All solutions for poses (n, 4, 4); where an angle is free to choose, it is that of the seed (6,)."""
        rows = self._kinematics.dh
        rotation, point = self._wrist(poses)
        count = len(poses)
        seed = self._signs * seed_rad + self._offsets_rad
        table = np.full((WAYS, count, JOINTS), np.nan)
        room = np.full((3, WAYS, count), np.nan)
        x, y, z = point.T
        out_m = np.hypot(x, y)
        with np.errstate(invalid="ignore"):
            beside = np.where(out_m < abs(self._aside_m) - _SAME, np.nan, 0.0)
            reach_m = np.sqrt(np.maximum(out_m**2 - self._aside_m**2, beside))
            for way in range(WAYS):
                shoulder, elbow, wrist = (1.0 - 2.0 * (way >> bit & 1) for bit in (0, 1, 2))
                ahead_m = shoulder * reach_m
                towards = np.arctan2(y, x) - np.arctan2(-self._square * self._aside_m, ahead_m)
                q1 = np.where(out_m < _LOCKED, seed[0], towards)
                # The triangle of upper arm, forearm and the line from joint 2 to the point, in their plane.
                across, up = ahead_m - rows[0].a_m, self._square * (z - rows[0].d_m)
                upper, fore = rows[1].a_m, self._elbow_m
                cosine = (across**2 + up**2 - upper**2 - fore**2) / (2.0 * upper * fore)
                cosine = np.where(np.abs(cosine) <= 1.0 + _SAME, np.clip(cosine, -1.0, 1.0), np.nan)
                bend = elbow * np.arccos(cosine)
                q2 = np.arctan2(up, across) - np.arctan2(fore * np.sin(bend), upper + fore * np.cos(bend))
                q3 = self._parallel * bend - self._elbow_rad
                q4, q5, q6, tilt = self._hand(np.stack([q1, q2, q3], axis=-1), rotation, wrist, seed)
                table[way] = np.stack([q1, q2, q3, q4, q5, q6], axis=-1)
                room[:, way] = reach_m, np.sin(np.abs(bend)), tilt
        angles = self._signs * (table - self._offsets_rad)
        angles[np.isnan(angles).any(axis=-1)] = np.nan
        return Solutions(seed_rad + _wrapped(angles - seed_rad), room)

    def nearest(self, pose: Poses, seed_rad: Angles) -> Angles:
        """The joint angles (6,) inside the limits that give a pose (4, 4) and lie nearest to the seed (6,).

        Nearest is the smallest sum of squared differences. With a straight wrist, joint 4 stays as near to the seed as
        the limits of joint 6 allow. Raises OutOfReach, OutsideLimits.
        """
        solutions = self.solutions(pose[np.newaxis], seed_rad)
        exists = np.isfinite(solutions.angles_rad[:, 0]).all(axis=-1)
        found, tilt = solutions.angles_rad[exists, 0], solutions.room[2, exists, 0]
        if len(found) == 0:
            raise self._out_of_reach(pose)
        for way in np.flatnonzero(tilt < _LOCKED):
            found[way] = self._with_turn_shared(found[way], seed_rad)
        turns = 2.0 * math.pi * np.arange(-2, 3)
        candidates = found[..., np.newaxis] + turns  # (ways, joints, turns)
        outside = np.maximum(self.lower_rad[:, np.newaxis] - candidates, candidates - self.upper_rad[:, np.newaxis])
        allowed = outside <= self.slack_rad[:, np.newaxis]
        away = np.where(allowed, np.abs(candidates - seed_rad[:, np.newaxis]), np.inf)
        costs = (away.min(axis=-1) ** 2).sum(axis=-1)
        if np.isfinite(costs).any():
            best = int(costs.argmin())
            chosen = away[best].argmin(axis=-1)
            nearest: Angles = np.take_along_axis(candidates[best], chosen[:, np.newaxis], axis=-1)[:, 0]
            return nearest
        worst = np.maximum(outside.min(axis=-1), 0.0)  # (ways, joints)
        best = int(worst.sum(axis=-1).argmin())
        joint = int(worst[best].argmax())
        raise OutsideLimits(self._joints[joint], float(candidates[best, joint, outside[best, joint].argmin()]))

    def _with_turn_shared(self, way_rad: Angles, seed_rad: Angles) -> Angles:
        """The angles (6,) of a straight wrist with joint 4 as near to the seed (6,) as the limits of joint 6 allow.

        Both turn about one axis, so the pose determines only their combined turn. If no distribution of it between them
        is inside the limits, they stay as they are.
        """
        outer = [3, 5]
        held = _about_z(self._signs[4] * way_rad[4] + self._offsets_rad[4])
        turns_over = (self._alphas[3] @ held @ self._alphas[4])[2, 2] < 0.0
        # Joint 6 undoes what joint 4 turns: the pose stays if they turn by t and `back` * t.
        back = self._signs[3] * self._signs[5] * (1.0 if turns_over else -1.0)
        whole = 2.0 * math.pi * np.arange(-2, 3)
        angles = way_rad[outer, np.newaxis, np.newaxis] + np.stack(np.meshgrid(whole, whole))
        along = np.array([1.0, back])[:, np.newaxis, np.newaxis]
        ends = [along * (limit[outer, np.newaxis, np.newaxis] - angles) for limit in (self.lower_rad, self.upper_rad)]
        first, last = np.minimum(*ends).max(axis=0), np.maximum(*ends).min(axis=0)
        away = angles - seed_rad[outer, np.newaxis, np.newaxis]
        turn = np.clip(-away[0], first, last)
        costs = np.where(first <= last, ((away + along * turn) ** 2).sum(axis=0), np.inf)
        best = np.unravel_index(costs.argmin(), costs.shape)
        shared = way_rad.copy()
        if np.isfinite(costs[best]):
            shared[outer] = (angles + along * turn)[:, best[0], best[1]]
        return shared

    def jacobian(self, angles_rad: Angles) -> NDArray[np.float64]:
        """(…, 6, 6): the flange's translation (m) and rotation (rad) in the base's axes, per rad of each joint."""
        links = link_poses(self._kinematics, angles_rad)[..., 1:, :, :]
        tip = flange_pose(self._kinematics, angles_rad)[..., :3, 3]
        axes = links[..., :3, 2] * self._signs[:, np.newaxis]
        moved = np.cross(axes, tip[..., np.newaxis, :] - links[..., :3, 3])
        return np.swapaxes(np.concatenate([moved, axes], axis=-1), -1, -2)

    def _wrist(self, poses: Poses) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The rotations (n, 3, 3) before the last twist, and the points (n, 3) where the last three axes meet."""
        rotation = poses[:, :3, :3] @ self._alphas[5].T
        return rotation, poses[:, :3, 3] - rotation @ self._hand_m

    def _hand(
        self, arm: NDArray[np.float64], rotation: NDArray[np.float64], side: float, seed: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], ...]:
        """The last three angles of the table for the first three (n, 3), and the sine of the wrist's tilt."""
        held = np.eye(3)
        for joint in range(3):
            held = held @ _about_z(arm[:, joint]) @ self._alphas[joint]
        left = np.swapaxes(held, -1, -2) @ rotation  # Rz(q4) Rx(alpha4) Rz(q5) Rx(alpha5) Rz(q6)
        tilt = np.hypot(left[:, 0, 2], left[:, 1, 2])
        q5 = side * np.arctan2(tilt, -left[:, 2, 2] * self._wrist_square)
        middle = self._alphas[3] @ _about_z(q5) @ self._alphas[4]
        turned = np.arctan2(left[:, 1, 2], left[:, 0, 2]) - np.arctan2(middle[:, 1, 2], middle[:, 0, 2])
        q4 = np.where(tilt < _LOCKED, seed[3], turned)
        rest = np.swapaxes(_about_z(q4) @ middle, -1, -2) @ left
        q6 = np.arctan2(rest[:, 1, 0], rest[:, 0, 0])
        return q4, q5, q6, tilt

    def _out_of_reach(self, pose: Poses) -> OutOfReach:
        _, (point,) = self._wrist(pose[np.newaxis])
        x, y, z = point.tolist()
        first, second = self._kinematics.dh[:2]
        if math.hypot(x, y) < abs(self._aside_m) - _SAME:
            return OutOfReach(
                f"It is out of reach: the wrist's centre would be {math.hypot(x, y) * 1e3:.1f} mm from joint 1's axis, "
                f"and it cannot come nearer than {abs(self._aside_m) * 1e3:.1f} mm: choose a position farther out."
            )
        ahead = math.sqrt(max(x * x + y * y - self._aside_m**2, 0.0))
        ways_m = [math.hypot(side * ahead - first.a_m, z - first.d_m) for side in (1.0, -1.0)]
        upper_m = abs(second.a_m)
        longest, shortest = upper_m + self._elbow_m, abs(upper_m - self._elbow_m)
        way_m = min(ways_m, key=lambda way: max(way - longest, shortest - way))
        return OutOfReach(
            f"It is out of reach: the wrist's centre would be {way_m * 1e3:.1f} mm from joint 2's axis, and the arm "
            f"reaches from {shortest * 1e3:.1f} to {longest * 1e3:.1f} mm: choose another position or rotation."
        )


def _check_geometry(kinematics: KinematicsConfig) -> None:
    rows = kinematics.dh
    wanted = (
        "a Cartesian move needs six joints, joint 1 square on joints 2 and 3, those parallel, and joints 4 to 6 square "
        "on each other and meeting in one point"
    )
    if len(rows) != JOINTS:
        raise OtherGeometry(f"This arm has {len(rows)} joints, and {wanted}: plan with MoveIt instead.")
    faults = [
        (1, abs(math.cos(rows[0].alpha_rad)) > _SAME, "alpha_deg must be 90 or -90"),
        (2, abs(math.sin(rows[1].alpha_rad)) > _SAME, "alpha_deg must be 0 or 180"),
        (2, abs(rows[1].a_m) < _SAME, "a_mm must not be 0"),
        (3, math.hypot(rows[2].a_m, math.sin(rows[2].alpha_rad) * rows[3].d_m) < _SAME, "its forearm has no length"),
        (4, abs(rows[3].a_m) > _SAME, "a_mm must be 0"),
        (4, abs(math.cos(rows[3].alpha_rad)) > _SAME, "alpha_deg must be 90 or -90"),
        (5, abs(rows[4].a_m) > _SAME or abs(rows[4].d_m) > _SAME, "a_mm and d_mm must be 0"),
        (5, abs(math.cos(rows[4].alpha_rad)) > _SAME, "alpha_deg must be 90 or -90"),
    ]
    for number, broken, demand in faults:
        if broken:
            raise OtherGeometry(
                f"Row {number} of this arm's kinematics.dh does not fit ({demand}): {wanted}. Plan with MoveIt instead."
            )


def _about_z(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    turn = np.zeros((*np.shape(angle_rad), 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angle_rad)
    turn[..., 1, 0] = np.sin(angle_rad)
    turn[..., 0, 1] = -turn[..., 1, 0]
    turn[..., 2, 2] = 1.0
    return turn


def _about_x(angle_rad: float) -> NDArray[np.float64]:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])


def _wrapped(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same angles within half a turn of 0."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
