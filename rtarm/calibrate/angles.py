"""What follows from turns of a motor and from what a person saw or measured: pure arithmetic, the same for all drives.

Angles are in degrees. A motor's turns are those that its drive counts, which may be of the shaft behind its own gear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rtloop.offline.calibration.session import MOST_RPM, MOST_TURNS

SLOW_DEG_S = 2.0
"""Speed of the joint, as far as whole motor rpm allow it."""
FIRST_MOTOR_DEG = 30.0
"""First move of all: whatever the true ratio (of 1 or more), the joint turns by no more."""
MOST_JOINT_DEG = 15.0
"""Longest single move, by the ratio that is believed then."""
READ_TO_DEG = 1.0
"""How well a person reads the angle between two marks."""
LEAST_ANGLE_DEG = 20.0
"""Between two marks: below it the ratio is known to no better than a twentieth."""
LEAST_MOTOR_DEG = 5.0
"""Between two marks: a motor that holds dithers by less, and one that turned less did not turn the joint."""


@dataclass(frozen=True)
class Move:
    """A move of one motor."""

    turns: float
    rpm: int

    @property
    def motor_deg(self) -> float:
        """By how much the motor turns."""
        return self.turns * 360.0


def slow_rpm(ratio: float, motor_rpm: float) -> int:
    """Motor speed for about `SLOW_DEG_S` of the joint, in the whole rpm that drives take."""
    return max(1, min(round(SLOW_DEG_S * ratio / 6.0), MOST_RPM, math.floor(motor_rpm)))


def nudges(ratio: float, motor_rpm: float) -> list[Move]:
    """Moves to see a direction by: the first turns the motor by 30° at most, each other one is twice as long."""
    most = most_joint_deg(ratio)
    moves = []
    joint_deg = min(FIRST_MOTOR_DEG / ratio, most / 2.0)
    while joint_deg <= most:
        moves.append(joint_move(joint_deg, ratio, motor_rpm))
        joint_deg *= 2.0
    return moves


def joint_move(joint_deg: float, ratio: float, motor_rpm: float) -> Move:
    """The move that turns a joint of this ratio by an angle, in the motor's own sense."""
    return Move(joint_deg * ratio / 360.0, slow_rpm(ratio, motor_rpm))


def most_joint_deg(ratio: float) -> float:
    """Longest single move of a joint of this ratio."""
    return min(MOST_JOINT_DEG, MOST_TURNS * 360.0 / ratio)


def motor_angle_deg(turns: float, ratio: float) -> float:
    """The motor's turns as an angle of the joint, without direction and zero (m of the arm file)."""
    return turns * 360.0 / ratio


def zero_deg(turns: float, ratio: float, direction: int, stands_at_deg: float) -> float:
    """`zero_deg` of a joint that stands at a known angle while its drive counts so many turns."""
    return round(direction * motor_angle_deg(turns, ratio) - stands_at_deg, 2) + 0.0  # no -0


@dataclass(frozen=True)
class RatioFound:
    """A measured ratio, how well it is known, and what it might be."""

    measured: float
    uncertainty: float
    """From reading the angle to ±1°: the true ratio lies within measured ± this."""
    suggestion: float | None
    """The file's ratio if it fits, else the only whole number that does; None if neither."""
    too_small_for: str | None
    """Why the measurement cannot tell what the ratio is, a sentence; None if it can."""


def ratio_found(turns: float, angle_deg: float, in_file: float) -> RatioFound:
    """Ratio of a joint that turned by an angle (without sign, as measured) while its motor made so many turns."""
    turns = abs(turns)
    if turns * 360.0 < LEAST_MOTOR_DEG:
        return RatioFound(
            math.nan,
            math.nan,
            None,
            f"The motor turned by {turns * 360.0:.1f}° only, which tells no ratio: the joint has to get from the first "
            "mark to the second one before it is measured.",
        )
    if angle_deg < LEAST_ANGLE_DEG:
        return RatioFound(
            math.nan,
            math.nan,
            None,
            f"An angle of {angle_deg:g}°, read to ±{READ_TO_DEG:g}°, is too small to tell a ratio: turn the joint by "
            f"{LEAST_ANGLE_DEG:g}° or more, better by 90°.",
        )
    measured = turns * 360.0 / angle_deg
    low, high = turns * 360.0 / (angle_deg + READ_TO_DEG), turns * 360.0 / (angle_deg - READ_TO_DEG)
    uncertainty = max(high - measured, measured - low)
    if low <= in_file <= high:
        return RatioFound(measured, uncertainty, in_file, None)
    whole = range(max(math.ceil(low), 1), math.floor(high) + 1)
    if len(whole) > 1:
        return RatioFound(
            measured,
            uncertainty,
            None,
            f"The ratio is {measured:.2f} ± {uncertainty:.2f}, and {whole[0]} fits as well as {whole[-1]}: turn the "
            f"joint by {least_angle_deg(measured):.0f}° or more, which tells them apart.",
        )
    return RatioFound(measured, uncertainty, float(whole[0]) if whole else None, None)


def least_angle_deg(ratio: float) -> float:
    """Angle between two marks from which on no two whole ratios near this one both fit."""
    return max(LEAST_ANGLE_DEG, 2.0 * ratio * READ_TO_DEG + 2.0)
