"""A taught motion: where the joints are when, and the limits it was made for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from rtarm.running.limits import Limits

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Where the joints are when: between its points on a cubic spline that begins and ends at rest.

    Attributes:
        arm: name of the arm it was taught to.
        taught: when, as ISO 8601 says it.
        tolerance_rad: how far it may be beside what the hand did.
        deviation_rad: how far it is, at most.
        times_s: (points,), rising from 0.
        positions_rad: (points, joints).
    """

    arm: str
    limits: Limits
    taught: str
    tolerance_rad: float
    deviation_rad: float
    times_s: Reals
    positions_rad: Reals

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    @cached_property
    def curve(self) -> CubicSpline:
        """The motion between its points (rad, over s)."""
        return curve(self.times_s, self.positions_rad)

    def fastest(self) -> float:
        """By which factor it may be played at most, so that no joint leaves its limits."""
        velocity, acceleration = peaks(self.curve)
        by_velocity = self.limits.velocity_rad_s / np.maximum(velocity, 1e-12)
        by_acceleration = np.sqrt(self.limits.acceleration_rad_s2 / np.maximum(acceleration, 1e-12))
        return float(min(by_velocity.min(), by_acceleration.min()))

    def outside(self) -> str:
        """The joint that leaves its range on the way, in words; "" if none does."""
        lowest, highest = extremes(self.curve)
        limits = self.limits
        for number, joint in enumerate(limits.joints):
            for value, limit, beyond in (
                (lowest[number], limits.lower_rad[number], lowest[number] < limits.lower_rad[number]),
                (highest[number], limits.upper_rad[number], highest[number] > limits.upper_rad[number]),
            ):
                if beyond:
                    return f"{joint} goes to {math.degrees(value):.3f}°, beyond its limit of {math.degrees(limit):g}°"
        return ""


def curve(times_s: Reals, positions_rad: Reals) -> CubicSpline:
    """The cubic spline through points (points, joints) that begins and ends at rest."""
    return CubicSpline(times_s, positions_rad, bc_type="clamped")


def peaks(path: CubicSpline) -> tuple[Reals, Reals]:
    """Highest speed and acceleration of each joint anywhere on a cubic spline; exact.

    The acceleration is linear between waypoints and peaks at one; the speed peaks there or where the acceleration is 0.
    """
    waypoints = path.x
    speed, acceleration = path(waypoints, 1), path(waypoints, 2)
    first, last = acceleration[:-1], acceleration[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(first * last < 0.0, first / (first - last), 0.0)
    width = np.diff(waypoints)[:, np.newaxis]
    between = speed[:-1] + first * share * width / 2.0  # the triangle under the acceleration until it is 0
    return np.maximum(np.abs(speed).max(0), np.abs(between).max(0)), np.abs(acceleration).max(0)


def extremes(path: CubicSpline) -> tuple[Reals, Reals]:
    """Lowest and highest place of each joint, looked at five times between two waypoints."""
    waypoints = path.x
    times = np.concatenate(
        [waypoints[:-1] + share * np.diff(waypoints) for share in np.arange(5) / 5.0] + [waypoints[-1:]]
    )
    places = path(times)
    return places.min(0), places.max(0)
