"""What a hand meant, from what the encoders read: without their steps, without the hand's tremor, and near enough."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline

from rtarm.teach.motion import Reals

FEWEST_READINGS = 5
"""Fewer make no smoothing spline."""
SMOOTHEST_HZ = 2.0
"""Faster parts of a motion are taken for tremor (hands tremble at 8 to 12 Hz), if the tolerance allows that."""
STEP = 1.5
MOST_STEPS = 20
"""Beyond that the spline goes through the readings."""


def smoothed(times_s: Reals, positions_rad: Reals, tolerance_rad: float) -> BSpline:
    """The smoothest spline of one joint that stays within a tolerance of all its readings (readings,).

    A cubic smoothing spline is a low-pass filter without delay, 1/(1 + (f/f_c)^4) for evenly spaced readings, with
    f_c = (spacing * penalty)^(-1/4) / 2π. It begins at f_c = `SMOOTHEST_HZ`, and f_c rises until the tolerance is kept.
    """
    spacing_s = (times_s[-1] - times_s[0]) / (len(times_s) - 1)
    for step in range(MOST_STEPS):
        cutoff_hz = SMOOTHEST_HZ * STEP**step
        spline = make_smoothing_spline(times_s, positions_rad, lam=1.0 / (spacing_s * (math.tau * cutoff_hz) ** 4))
        if np.abs(spline(times_s) - positions_rad).max() <= tolerance_rad:
            return spline
    return make_smoothing_spline(times_s, positions_rad, lam=0.0)


def moving_part(times_s: Reals, positions_rad: Reals, still_rad: float, lead_s: float) -> tuple[float, float] | None:
    """From when to when a path (moments, joints) moves: without its still parts at both ends, but for a lead.

    A part is still while no joint is farther than `still_rad` from where it is at that end. None if all of it is.
    """
    away = (np.abs(positions_rad - positions_rad[0]) > still_rad).any(axis=1)
    unfinished = (np.abs(positions_rad - positions_rad[-1]) > still_rad).any(axis=1)
    if not away.any():
        return None
    begin_s = times_s[np.argmax(away)] - lead_s
    left = np.flatnonzero(unfinished)
    end_s = times_s[left[-1] if len(left) else -1] + lead_s
    return max(float(begin_s), float(times_s[0])), min(float(end_s), float(times_s[-1]))
