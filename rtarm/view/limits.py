"""How near joints are to their limits."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from config.joint import JointConfig

NEAR_SHARE = 0.05
"""A joint is near a limit within this share of its range."""


class Side(Enum):
    """Which limit a joint is near, or that it is outside both."""

    LOWER = "lower"
    UPPER = "upper"
    BEYOND = "beyond"


class Nearness(NamedTuple):
    """A limit that a joint is near: which, where it is and how far away (degrees, both)."""

    side: Side
    limit_deg: float
    distance_deg: float


def nearness(joint: JointConfig, position_rad: float | None) -> Nearness | None:
    """The limit that a joint is near or beyond, None in the midst of its range and where its position is not known."""
    if position_rad is None or not math.isfinite(position_rad):
        return None
    at_deg = math.degrees(position_rad)
    to_lower, to_upper = at_deg - joint.lower_deg, joint.upper_deg - at_deg
    limit_deg, distance_deg, side = min(
        (joint.lower_deg, to_lower, Side.LOWER), (joint.upper_deg, to_upper, Side.UPPER), key=lambda one: one[1]
    )
    if distance_deg < 0.0:
        return Nearness(Side.BEYOND, limit_deg, -distance_deg)
    near = distance_deg <= NEAR_SHARE * (joint.upper_deg - joint.lower_deg)
    return Nearness(side, limit_deg, distance_deg) if near else None


def share(joint: JointConfig, position_rad: float) -> float:
    """Where in its range a joint is, 0 at the lower and 1 at the upper limit, never outside them."""
    whole = joint.upper_deg - joint.lower_deg
    return min(max((math.degrees(position_rad) - joint.lower_deg) / whole, 0.0), 1.0)
