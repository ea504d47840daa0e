"""What encoders read of a hand's motion, for tests: steps, tremor, readings at times of their own, some missing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from config.loader import load_arm
from rtarm.running.limits import Limits
from rtarm.teach.making import Readings

RATE_HZ = 120.0
ENCODER_RAD = 2.0 * np.pi / 65536.0

Way = Callable[[np.ndarray], np.ndarray]
"""Angles (rad) of a joint over the hand's time (s)."""


def limits(arm: str = "episode1") -> Limits:
    """Those of an arm that comes with rtarm."""
    joints = load_arm(arm).joints

    def column(name: str) -> np.ndarray:
        return np.array([getattr(joint, name) for joint in joints])

    return Limits(
        tuple(joint.name for joint in joints),
        *map(column, ("lower_rad", "upper_rad", "max_velocity_rad_s", "max_acceleration_rad_s2")),
    )


def readings(
    ways: list[Way], seconds: float, *, seed: int, tremor_rad: float = 0.0, lost: float = 0.0
) -> list[Readings]:
    """Every joint is read once a cycle at a moment of its own, but for a share of the cycles."""
    random = np.random.default_rng(seed)
    read = []
    for number, way in enumerate(ways):
        times_s = np.arange(0.0, seconds, 1.0 / RATE_HZ)
        times_s = times_s + number * 3e-4 + random.uniform(0.0, 5e-4, len(times_s))
        times_s = times_s[random.uniform(size=len(times_s)) >= lost]
        shaking = tremor_rad * np.sin(2.0 * np.pi * 9.0 * times_s + number)
        places = np.floor((way(times_s) + shaking) / ENCODER_RAD) * ENCODER_RAD
        read.append(Readings(times_s, places))
    return read
