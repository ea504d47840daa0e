"""Motions that the front plans itself, from rest to rest: of the joints, or of the flange on a straight line.

Both follow a path by its share from 0 to 1, with the same speed profile: a ramp up, a part of constant speed, the same
ramp down. On a ramp the speed is the smoothstep 3x² - 2x³, so that the acceleration begins and ends at 0 and peaks at
1.5 times its mean. The result is a trajectory like those that clients send, and is checked like them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from config.kinematics import Poses, flange_pose
from config.schema import ArmConfig
from rosfront.full_node.inverse import Inverse, NoWay
from rosfront.full_node.rotations import turn_of, turned
from rosfront.plan import NS
from rosfront.points import Columns, Rows
from rosfront.refusals import OffTheLine, OutOfLimits, Singular, Unreachable
from rosfront.trajectory_bytes import Header, Stamp, Trajectory

SAMPLE_M, SAMPLE_RAD = 1e-3, math.radians(0.5)
"""Spacing of the samples, along the line and in rotation, at which a line is checked before it is accepted."""
WAYPOINT_M, WAYPOINT_RAD = 5e-3, math.radians(2.0)
"""Largest spacing of a line's waypoints, along the line and in rotation; the latter also holds for any joint."""
NEAREST_M, NEAREST_SINE = 0.01, 0.02
"""How near a line may come to the singularities, where two configurations meet: of the shoulder, of elbow and wrist.

Nearer than that a joint turns more than fifty times as far as the flange does, and beyond lies another configuration.
"""
SINGULAR = (
    "the wrist's centre comes too near to joint 1's axis, where that joint would have to spin",
    "the arm is stretched out or folded up, where joint 3 can go no farther",
    "joints 4 and 6 turn about almost one axis (joint 5 is straight), where they would have to spin",
)
_DIFFERENCE = 1e-5
"""Share of a line by which the finite difference of its joint velocities steps, also beyond the line's ends."""


@dataclass(frozen=True)
class Profile:
    """The speed profile of a path: two ramps and a part of constant speed between them."""

    ramp_s: float
    even_s: float
    speed: float
    """The constant speed between the ramps, in shares per second."""

    @classmethod
    def fastest(cls, speed: float, acceleration: float) -> Profile:
        """The quickest profile within a speed (1/s) and an acceleration (1/s²)."""
        ramp_s = 1.5 * speed / acceleration
        if speed * ramp_s > 1.0:  # the ramps, each 0.5 * speed * ramp_s long, would overlap
            speed = math.sqrt(acceleration / 1.5)
            ramp_s = 1.0 / speed
        return cls(ramp_s, 1.0 / speed - ramp_s, speed)

    @property
    def duration_s(self) -> float:
        return 2.0 * self.ramp_s + self.even_s

    def times_s(self, widest: float) -> np.ndarray:
        """Times (n,) in s, at most a share of `widest` apart, the ends of the ramps among them."""
        ramp = np.linspace(0.0, self.ramp_s, 1 + math.ceil(self.speed * self.ramp_s / widest))
        even = np.linspace(0.0, self.even_s, 1 + math.ceil(self.speed * self.even_s / widest))
        return np.concatenate([ramp, self.ramp_s + even[1:], self.ramp_s + self.even_s + ramp[1:]])

    def at(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Share, its rate (1/s) and its acceleration (1/s²), (n,) each."""
        left_s = self.duration_s - times_s
        down = left_s < times_s
        share, rate, bend = self._rising(np.where(down, left_s, times_s))
        return np.where(down, 1.0 - share, share), rate, np.where(down, -bend, bend)

    def _rising(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.clip(times_s / self.ramp_s, 0.0, 1.0)
        ramp = self.speed * self.ramp_s * (x**3 - 0.5 * x**4)
        share = ramp + self.speed * np.maximum(times_s - self.ramp_s, 0.0)
        return share, self.speed * (3.0 - 2.0 * x) * x**2, self.speed / self.ramp_s * 6.0 * x * (1.0 - x)


def joint_move(arm: ArmConfig, start_rad: np.ndarray, target_rad: np.ndarray, speed_ratio: float) -> Trajectory:
    """Move all joints (joints,) together from rest to rest, as fast as the slowest of them may.

    `speed_ratio` (above 0, up to 1) is the share of the velocity limits; accelerations are those of the limits.
    """
    way = target_rad - start_rad
    if not way.any():
        return _trajectory(arm, np.zeros(1), start_rad[np.newaxis], *np.zeros((2, 1, len(way))))
    fastest, hardest = _limits(arm)
    profile = Profile.fastest(
        float((speed_ratio * fastest / _above_zero(np.abs(way))).min()),
        float((hardest / _above_zero(np.abs(way))).min()),
    )
    times_s = profile.times_s(1.0)
    share, rate, bend = (values[:, np.newaxis] for values in profile.at(times_s))
    return _trajectory(arm, times_s, start_rad + share * way, rate * way, bend * way)


class Line:
    """A straight line of the flange, from its pose at some joint angles to another pose, turning evenly about one axis.

    That axis is the one of the shortest turn; for exactly half a turn it is one of the two possible ones.
    """

    def __init__(self, arm: ArmConfig, inverse: Inverse, start_rad: np.ndarray, pose: Poses) -> None:
        """Raises Unreachable, or OutOfLimits, Singular, OffTheLine, which name the place on the line."""
        assert arm.kinematics is not None
        self._arm, self._inverse, self._start_rad = arm, inverse, start_rad
        self._from = flange_pose(arm.kinematics, start_rad)
        self._way_m = pose[:3, 3] - self._from[:3, 3]
        self._turn_rad = turn_of(pose[:3, :3] @ self._from[:3, :3].T)
        self.length_m = float(np.linalg.norm(self._way_m))
        self.turn_rad = float(np.linalg.norm(self._turn_rad))
        try:
            inverse.nearest(pose, start_rad)
        except NoWay as reason:
            raise Unreachable(str(reason)) from reason
        samples = max(2, math.ceil(self.length_m / SAMPLE_M), math.ceil(self.turn_rad / SAMPLE_RAD))
        self._shares = np.linspace(0.0, 1.0, 1 + samples)
        self._follow()

    def poses(self, shares: np.ndarray) -> Poses:
        """The flange (n, 4, 4) at shares (n,) of the line."""
        poses = np.zeros((len(shares), 4, 4))
        poses[:, :3, :3] = turned(shares[:, np.newaxis] * self._turn_rad) @ self._from[:3, :3]
        poses[:, :3, 3] = self._from[:3, 3] + shares[:, np.newaxis] * self._way_m
        poses[:, 3, 3] = 1.0
        return poses

    def share_at(self, flange: Poses, otherwise: float) -> float:
        """The share of the line, 0 to 1, that a flange (4, 4) has covered; `otherwise` if only the rotation changes."""
        if self.length_m == 0.0:
            return otherwise
        share = float((flange[:3, 3] - self._from[:3, 3]) @ self._way_m) / self.length_m**2
        return min(max(share, 0.0), 1.0)

    def _follow(self) -> None:
        """Choose the arm's present configuration and check the line in it; raises as the constructor does."""
        found = self._inverse.solutions(self.poses(self._shares), self._start_rad)
        nearness = np.nan_to_num(np.abs(found.angles_rad[:, 0] - self._start_rad).max(axis=-1), nan=np.inf)
        self._branch = int(nearness.argmin())
        room = found.room[:, self._branch]
        narrow = room < np.array([NEAREST_M, NEAREST_SINE, NEAREST_SINE])[:, np.newaxis]
        angles = np.unwrap(found.angles_rad[self._branch], axis=0)  # the first is close to the start
        lost = np.isnan(angles).any(axis=-1)
        outside = np.maximum(self._inverse.lower_rad - angles, angles - self._inverse.upper_rad)
        outside = outside > self._inverse.slack_rad
        bad = np.flatnonzero(narrow.any(axis=0) | lost | outside.any(axis=-1))
        if len(bad) == 0:
            self._angles_rad = angles
            return
        first = int(bad[0])
        place = self._place(float(self._shares[first]))
        if narrow[:, first].any():
            raise Singular(place, SINGULAR[int(narrow[:, first].argmax())])
        if lost[first]:
            raise OffTheLine(place)
        joint = int(outside[first].argmax())
        limits = self._arm.joints[joint]
        raise OutOfLimits(place, limits.name, float(angles[first, joint]), limits.lower_rad, limits.upper_rad)

    def _place(self, share: float) -> str:
        if self.length_m > SAMPLE_M:
            return f"at {share * self.length_m * 1e3:.1f} mm of its {self.length_m * 1e3:.1f} mm ({share:.0%})"
        return f"at {math.degrees(share * self.turn_rad):.1f}° of its {math.degrees(self.turn_rad):.1f}° ({share:.0%})"

    def trajectory(self, step_m: float) -> Trajectory:
        """At the highest constant speed that the joints' limits allow all along; waypoints at most `step_m` apart."""
        if self.length_m == 0.0 and self.turn_rad == 0.0:
            return _trajectory(self._arm, np.zeros(1), self._start_rad[np.newaxis], *np.zeros((2, 1, 6)))
        slopes = self._slopes(self._angles_rad)
        bends = np.abs(np.gradient(slopes, self._shares, axis=0))
        slopes = np.abs(slopes)
        fastest, hardest = _limits(self._arm)
        # Half of each joint's acceleration is for the curvature of its path, and what that leaves for the ramps.
        speed = min(
            float((fastest / _above_zero(slopes)).min()), math.sqrt(float((0.5 * hardest / _above_zero(bends)).min()))
        )
        profile = Profile.fastest(speed, float(((hardest - bends * speed**2) / _above_zero(slopes)).min()))
        widest = 1.0 / max(
            1.0,
            self.length_m / min(step_m, WAYPOINT_M),
            self.turn_rad / WAYPOINT_RAD,
            float(slopes.max()) / WAYPOINT_RAD,
        )
        times_s = profile.times_s(widest)
        share, rate, bend = (values[:, np.newaxis] for values in profile.at(times_s))
        before, angles, after = (self._angles_at(share[:, 0] + aside) for aside in (-_DIFFERENCE, 0.0, _DIFFERENCE))
        slope = self._slopes(angles)
        curve = (self._slopes(after) - self._slopes(before)) / (2.0 * _DIFFERENCE)
        return _trajectory(self._arm, times_s, angles, slope * rate, curve * rate**2 + slope * bend)

    def _angles_at(self, shares: np.ndarray) -> np.ndarray:
        found = self._inverse.solutions(self.poses(shares), self._start_rad)
        angles: np.ndarray = np.unwrap(found.angles_rad[self._branch], axis=0)
        return angles

    def _slopes(self, angles_rad: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6) of the joint angles by the share of the line."""
        flange = np.concatenate([self._way_m, self._turn_rad])
        slopes: np.ndarray = np.linalg.solve(self._inverse.jacobian(angles_rad), flange[:, np.newaxis])[..., 0]
        return slopes


def _above_zero(values: np.ndarray) -> np.ndarray:
    """The values as divisors, never 0: a joint that does not move does not limit the speed."""
    divisor: np.ndarray = np.maximum(values, 1e-12)
    return divisor


def _limits(arm: ArmConfig) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (rad/s) and acceleration (rad/s²) limits, (joints,) each."""
    fastest = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    return fastest, np.array([joint.max_acceleration_rad_s2 for joint in arm.joints])


def _trajectory(
    arm: ArmConfig, times_s: np.ndarray, positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray
) -> Trajectory:
    times_ns = np.round(times_s * NS).astype(np.int64)
    apart = np.append(np.diff(times_ns) > 0, True)  # parts of a profile may be shorter than a nanosecond

    def rows(values: np.ndarray) -> Rows:
        return np.full(int(apart.sum()), values.shape[1]), values[apart].ravel()

    return Trajectory(
        Header(Stamp(0, 0)),
        [joint.name for joint in arm.joints],
        Columns(
            times_ns[apart],
            rows(positions),
            rows(velocities),
            rows(accelerations),
            rows(np.empty((len(times_ns), 0))),
        ),
    )
