"""The timing of a taught motion: the hand's own, and slower only where the arm's limits ask for it.

The path is given over the hand's time s. What is looked for is s(t): which moment of the hand the arm is at. That is
toppra's question, the fastest way along a path, with the hand's time itself as one more joint that turns by 1 a second
at most: never faster than the hand, as fast as the hand wherever the limits allow it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from rtarm.console.errors import Refusal
from rtarm.running.limits import Limits
from rtarm.teach.motion import Reals

QUICKEST_CHANGE = 10.0
"""How fast the pace may change (1/s²), where no joint's acceleration says less: from rest to the hand's in 0.1 s."""


@dataclass(frozen=True)
class Timing:
    """When the arm is at which moment of the hand.

    Attributes:
        times_s: (moments,), rising evenly from 0.
        hand_s: the hand's time at each, rising from its first to its last.
    """

    times_s: Reals
    hand_s: Reals

    def time_of(self, hand_s: Reals) -> Reals:
        """When the arm is at these moments of the hand."""
        return np.interp(hand_s, self.hand_s, self.times_s)

    def every(self, count: int) -> Timing:
        """Only one in so many moments, whose number must be a multiple of that and one more."""
        return Timing(self.times_s[::count], self.hand_s[::count])


FINER = 8
"""Moments told of for each spacing."""

END_PLACES = 10
"""Into how many stretches the last one is divided, each half as long as the one before."""


def timed(
    path: CubicSpline, limits: Limits, velocity_share: float, acceleration_share: float, spacing_s: float
) -> Timing:
    """The quickest timing of a path (over the hand's time) that is never quicker than the hand's.

    Args:
        path: places (rad) of the joints over the hand's time (s); begun and ended at rest, whatever the hand did.
        limits: of the joints.
        velocity_share, acceleration_share: what is used of them.
        spacing_s: of the places at which the limits are looked at; the result has `FINER` moments for each.

    Raises:
        Refusal: toppra found none.
    """
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

    begin_s, end_s = path.x[0], path.x[-1]
    grid_s = _grid(begin_s, end_s, spacing_s)
    velocity = np.append(velocity_share * limits.velocity_rad_s, 1.0)
    acceleration = np.append(acceleration_share * limits.acceleration_rad_s2, QUICKEST_CHANGE)
    found = TOPPRA(
        [
            JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
            JointAccelerationConstraint(
                np.stack([-acceleration, acceleration], axis=1),
                discretization_scheme=DiscretizationType.Interpolation,
            ),
        ],
        SplineInterpolator(grid_s, np.column_stack([path(grid_s), grid_s])),
        gridpoints=grid_s,
        solver_wrapper="seidel",
        parametrizer="ParametrizeConstAccel",
    )
    trajectory = found.compute_trajectory(0.0, 0.0)
    if trajectory is None:
        raise Refusal(
            f"No timing inside the arm's limits was found for this motion (toppra: {found.problem_data.return_code}): "
            "teach it again, more evenly."
        )
    duration_s = float(trajectory.duration)
    times_s = np.linspace(0.0, duration_s, math.ceil(duration_s / spacing_s) * FINER + 1)
    hand_s = np.clip(trajectory(times_s)[:, -1], begin_s, end_s)
    hand_s[0], hand_s[-1] = begin_s, end_s
    return Timing(times_s, np.maximum.accumulate(hand_s))


def _grid(begin_s: float, end_s: float, spacing_s: float) -> Reals:
    """Evenly spaced places, and closer and closer ones at the end.

    toppra goes as fast as it may from one place to the next. Before the last one that can mean almost to stand, and
    then to creep: so the last stretches are short.
    """
    even_s = np.linspace(begin_s, end_s, math.ceil((end_s - begin_s) / spacing_s) + 2)
    return np.concatenate(
        [even_s[:-1], end_s - (even_s[-1] - even_s[-2]) * 0.5 ** np.arange(1, END_PLACES), even_s[-1:]]
    )
