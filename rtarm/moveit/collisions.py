"""Which pairs of links MoveIt need not check, computed from the shapes and the joint limits.

Three kinds, with the names that MoveIt's Setup Assistant gives them: `Adjacent` are joined by a joint; `Always` and
`Default` touch in every pose, or at home, because the simple shapes overlap there; `Never` do not touch in any pose.
All others stay checked. The poses are sampled in a fixed order, so that the same arm gives the same pairs everywhere.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from config.geometry import KinematicsConfig
from config.kinematics import Poses, flange_pose, link_poses
from config.schema import ArmConfig
from rtarm.moveit.shapes import Link, distances_m, gripper_shape, link_shapes

SAMPLES = 10_000
"""Poses that every pair is looked at in, all joints at random; a quarter of all angles are limits, where arms fold."""

NEAREST = 24
"""From so many of a pair's nearest poses, the nearest one of all is sought."""

ROUNDS = 16
"""Rounds of that search, each with half the reach of the one before in every other round."""

NEVER_M = 0.002
"""Pairs that come nearer than this stay checked: the search may have missed the very nearest pose."""

TOUCHING_M = 1e-6
"""Nearer to zero, MoveIt may call it a collision or not: the robot model has lengths to the nanometre."""

Positions = NDArray[np.float64]
"""Joint angles (poses, joints), radians."""


@dataclass(frozen=True)
class Unchecked:
    """A pair of links whose collisions MoveIt does not check, and why."""

    one: str
    other: str
    reason: str


def home_rad(arm: ArmConfig) -> list[float]:
    """The pose called home: every joint at 0, or at the limit that is nearest to it."""
    return [min(max(0.0, joint.lower_rad), joint.upper_rad) for joint in arm.joints]


def home_positions_rad(arm: ArmConfig) -> dict[str, float]:
    """The same by the joints' names; a gripper is open then."""
    names = [joint.name for joint in arm.joints]
    gripper = {} if arm.gripper is None else {arm.gripper.joint: arm.gripper.open_rad}
    return {**dict(zip(names, home_rad(arm), strict=True)), **gripper}


def unchecked_pairs(arm: ArmConfig, kinematics: KinematicsConfig) -> list[Unchecked]:
    """The pairs that need no check, in the order of the links, a gripper the last."""
    links = [*link_shapes(kinematics), *([gripper_shape(arm.gripper)] if arm.gripper else [])]

    def poses_of(positions: Positions) -> Poses:
        poses = link_poses(kinematics, positions)
        return poses if arm.gripper is None else np.append(poses, flange_pose(kinematics, positions)[:, None], axis=1)

    chance = random.Random(0)  # its numbers are promised to be the same in every version of Python
    lower = np.array([joint.lower_rad for joint in arm.joints])
    upper = np.array([joint.upper_rad for joint in arm.joints])
    positions = np.concatenate([[home_rad(arm)], lower + _shares(chance, SAMPLES, len(lower)) * (upper - lower)])
    poses = poses_of(positions)
    pairs = []
    for first, second in combinations(range(len(links)), 2):
        one, other = links[first], links[second]
        if second == first + 1:
            pairs.append(Unchecked(one.name, other.name, "Adjacent"))
            continue
        distances = distances_m(one, other, poses[:, first], poses[:, second])
        if (distances < -TOUCHING_M).all():
            reason = "Always"
        elif distances[0] <= TOUCHING_M:
            reason = "Default"
        elif distances.min() > NEVER_M:
            start = positions[np.argsort(distances, kind="stable")[:NEAREST]]
            nearest_m = _nearest_m(poses_of, (links, first, second), start, (lower, upper), chance)
            reason = "Never" if nearest_m > NEVER_M else ""
        else:
            reason = ""
        if reason:
            pairs.append(Unchecked(one.name, other.name, reason))
    return pairs


def _nearest_m(
    poses_of: Callable[[Positions], Poses],
    pair: tuple[list[Link], int, int],
    positions: Positions,
    limits: tuple[Positions, Positions],
    chance: random.Random,
) -> float:
    """The smallest distance of a pair that is found around poses in which they are near (m)."""
    links, first, second = pair
    lower, upper = limits
    nearest = np.full(len(positions), np.inf)
    for turn in range(ROUNDS):
        reach = 0.25 * 0.5 ** (turn // 2) * (upper - lower)
        steps = 2.0 * _drawn(chance, 8 * len(positions), len(lower)) - 1.0
        tried = np.clip(np.repeat(positions, 8, axis=0) + steps * reach, lower, upper)
        tried = np.concatenate([positions, tried])
        poses = poses_of(tried)
        found = distances_m(links[first], links[second], poses[:, first], poses[:, second])
        best = np.argsort(found, kind="stable")[: len(positions)]
        positions, nearest = tried[best], found[best]
    return float(nearest[0])


def _shares(chance: random.Random, poses: int, joints: int) -> Positions:
    """Random places between the limits, as shares of each joint's range."""
    return np.clip(_drawn(chance, poses, joints) * (4.0 / 3.0) - 1.0 / 6.0, 0.0, 1.0)


def _drawn(chance: random.Random, poses: int, joints: int) -> Positions:
    return np.array([chance.random() for _ in range(poses * joints)]).reshape(poses, joints)
