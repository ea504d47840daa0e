"""Random ways through an arm's joint space that stay inside its limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from config.joint import JointConfig

BOX_SHARE = 0.7
"""Share of each joint's range, around its middle, that random goals stay in."""
LIMIT_SHARE = 0.85
"""Of the velocity and acceleration limits that random goals use at most."""
QUINTIC_VELOCITY, QUINTIC_ACCELERATION = 1.875, 5.774
"""Peaks of a rest-to-rest quintic over the unit of way and time."""

Way = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Positions and velocities (joints,) at a time in s."""


def random_box_pose(joints: Sequence[JointConfig], random: np.random.Generator) -> np.ndarray:
    """A pose (joints,) that random goals may reach."""
    return np.array([random.uniform(*_box(joint)) for joint in joints])


def random_way(
    joints: Sequence[JointConfig], here: np.ndarray, seconds: float, random: np.random.Generator
) -> np.ndarray:
    """How far each joint goes (joints,) by a rest-to-rest quintic of so many seconds, which keeps the limits."""
    way = np.zeros(len(here))
    for i, joint in enumerate(joints):
        most = LIMIT_SHARE * min(
            joint.max_velocity_rad_s * seconds / QUINTIC_VELOCITY,
            joint.max_acceleration_rad_s2 * seconds**2 / QUINTIC_ACCELERATION,
        )
        wanted = np.clip(here[i] + random.uniform(-most, most), *_box(joint))
        way[i] = np.clip(wanted - here[i], -most, most)
    return way


def shortest_quintic_s(joints: Sequence[JointConfig], way: np.ndarray) -> float:
    """How long a rest-to-rest quintic along a way takes at least, with room to the limits."""
    return max(
        1.0,
        *(
            max(
                abs(w) * QUINTIC_VELOCITY / (LIMIT_SHARE * joint.max_velocity_rad_s),
                math.sqrt(abs(w) * QUINTIC_ACCELERATION / (LIMIT_SHARE * joint.max_acceleration_rad_s2)),
            )
            for w, joint in zip(way, joints, strict=True)
        ),
    )


def shortest_stop_s(joints: Sequence[JointConfig], velocity_rad_s: np.ndarray) -> float:
    """What the slowest joint to brake needs at its acceleration limit, each by itself: v / a, off any path."""
    limits = np.array([joint.max_acceleration_rad_s2 for joint in joints])
    return float(np.max(np.abs(velocity_rad_s) / limits))


def waves_from(joints: Sequence[JointConfig], here: np.ndarray, share: float, seed: int) -> Way:
    """A smooth way through random directions that begins at rest, with `share` of the limits at its hardest."""
    random = np.random.default_rng(seed)
    velocity = np.array([joint.max_velocity_rad_s for joint in joints])
    acceleration = np.array([joint.max_acceleration_rad_s2 for joint in joints])
    omega = random.uniform(1.0, 3.0, len(here))
    sign = random.choice([-1.0, 1.0], len(here))
    room = np.array([min(j.upper_rad - p, p - j.lower_rad) for j, p in zip(joints, here, strict=True)])
    size = sign * np.minimum(share * np.minimum(velocity / omega, acceleration / omega**2), 0.2 * room)

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        # 1 - cos begins at rest; fading it in takes away the first step of its acceleration
        fade = min(t / 0.5, 1.0) ** 2 * (3 - 2 * min(t / 0.5, 1.0))
        slope = 6 * (t / 0.5) * (1 - t / 0.5) / 0.5 if t < 0.5 else 0.0
        shape, speed = 1 - np.cos(omega * t), omega * np.sin(omega * t)
        return here + size * fade * shape, size * (fade * speed + slope * shape)

    return at


def _box(joint: JointConfig) -> tuple[float, float]:
    middle, half = (joint.lower_rad + joint.upper_rad) / 2, BOX_SHARE * (joint.upper_rad - joint.lower_rad) / 2
    return middle - half, middle + half
