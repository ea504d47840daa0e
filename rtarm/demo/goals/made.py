"""The demo's goals for an arm that the recorded ones do not fit: made from the limits of its file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from config.schema import ArmConfig
from rtarm.client.moves import slow_move
from rtarm.client.sender import goal_document
from rtarm.demo.goals import Goal, goal_of, tour

Reals = NDArray[np.float64]

SPEED = 0.6
"""Share of the joints' limits."""
LONGEST_S, FARTHEST_RAD, ROOM = 2.0, 1.0, 0.6
"""A joint goes no farther than in so long at that speed, than so far, and than such a share of what it has room for."""
ROUNDED = 1.001
"""MoveIt rounds its velocities up to this share of a limit."""
SMALL = 0.2
"""Share of the way that the small goals go."""


def goals_for(arm: ArmConfig) -> list[Goal]:
    """The recorded goals where all of them fit an arm, else such as are made for it."""
    recorded = tour()
    return recorded if all(fits(goal, arm) for goal in recorded) else made_for(arm)


def fits(goal: Goal, arm: ArmConfig) -> bool:
    """Whether an arm has the joints of a goal, and its limits of position and velocity hold all points."""
    joints = {joint.name: joint for joint in arm.joints}
    if not joints.keys() >= set(goal.joint_names):
        return False
    ordered = [joints[name] for name in goal.joint_names]
    return all(
        joint.lower_rad <= position <= joint.upper_rad and abs(velocity) <= ROUNDED * joint.max_velocity_rad_s
        for point in goal.document["trajectory"]["points"]
        for joint, position, velocity in zip(ordered, point["positions"], point["velocities"], strict=True)
    )


def made_for(arm: ArmConfig) -> list[Goal]:
    """Four goals, each of which starts where the one before ended: a little, one joint, far, and back."""
    start_rad, way_rad = start_and_way(arm)
    a_little_rad = start_rad + SMALL * way_rad
    places = {
        "small": a_little_rad,
        "single_joint": np.append(start_rad[0] + way_rad[0], a_little_rad[1:]),
        "large": start_rad + way_rad,
        "large_back": start_rad,
    }
    velocity_rad_s = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    acceleration_rad_s2 = np.array([joint.max_acceleration_rad_s2 for joint in arm.joints])
    goals, here_rad = [], start_rad
    for name, there_rad in places.items():
        way = slow_move(here_rad, there_rad, velocity_rad_s, acceleration_rad_s2, SPEED)
        goals.append(goal_of(name, goal_document([joint.name for joint in arm.joints], *way)))
        here_rad = there_rad
    return goals


def start_and_way(arm: ArmConfig) -> tuple[Reals, Reals]:
    """Where the joints stand at first, as near to 0 as leaves some room, and how far each goes to its roomier side."""
    lower, upper = (np.array([getattr(joint, end) for joint in arm.joints]) for end in ("lower_rad", "upper_rad"))
    fastest = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    edge = 0.1 * np.minimum(upper - lower, FARTHEST_RAD)
    start_rad = np.clip(0.0, lower + edge, upper - edge)
    up, down = upper - start_rad, start_rad - lower
    length = np.minimum.reduce(
        [ROOM * np.maximum(up, down), np.full(len(up), FARTHEST_RAD), SPEED * fastest * LONGEST_S]
    )
    return start_rad, np.where(up >= down, length, -length)
