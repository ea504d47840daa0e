"""Which way is positive, in words for a person who stands before the arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from config.kinematics import flange_pose, link_poses
from config.schema import ArmConfig

MOSTLY = 0.9
"""Share of a direction along one axis of the base from which on it is called by that axis' name."""
SEEN_M = 0.01
"""A flange nearer than this to a joint's axis does not visibly move when the joint turns."""

Vector = NDArray[np.float64]


def positive_in_words(arm: ArmConfig, joint: int) -> str:
    """What a positive turn of the joint is: right-hand rule about its axis in the arm file's geometry."""
    name = arm.joints[joint].name
    if arm.kinematics is None:
        return (
            f"Positive is what your robot model (URDF) calls positive: with the thumb of your right hand along the "
            f"axis of {name} there, the fingers curl the positive way."
        )
    at_zero = np.zeros(len(arm.joints))
    link = link_poses(arm.kinematics, at_zero)[joint + 1]
    axis = arm.kinematics.dh[joint].sign * link[:3, 2]
    way = np.cross(axis, flange_pose(arm.kinematics, at_zero)[:3, 3] - link[:3, 3])
    thumb = direction_in_words(axis)
    words = (
        f"Positive, with all joints at zero: the thumb of your right hand along the axis of {name}, pointing {thumb}; "
        "the fingers curl the positive way. In another pose the axis has turned with the arm."
    )
    if np.linalg.norm(way) > SEEN_M:
        words += f" At zero the flange then goes {direction_in_words(way)}."
    return words


def direction_in_words(vector: Vector) -> str:
    """A direction in the base's frame: forward is its x, left its y."""
    unit = vector / np.linalg.norm(vector)
    names = (("forward", "backward"), ("left", "right"), ("up", "down"))
    strong = [names[i][int(unit[i] < 0)] for i in np.argsort(-np.abs(unit)) if abs(unit[i]) > np.sqrt(1 - MOSTLY**2)]
    return " and ".join(strong)
