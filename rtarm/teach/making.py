"""From what the encoders read while a hand led the arm to a motion that the arm can do, checked against both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from rtarm.console.errors import Refusal
from rtarm.running.limits import Limits
from rtarm.teach.motion import Motion, Reals, curve, peaks
from rtarm.teach.smoothing import FEWEST_READINGS, moving_part, smoothed
from rtarm.teach.timing import FINER, Timing, timed

VELOCITY_SHARE, ACCELERATION_SHARE = 0.95, 0.8
"""What is used of the limits at first; less, if the spline through the points would then pass them."""
SMOOTHING_SHARE = 0.8
"""Of the tolerance; the rest is for the spline between points."""
STILL_RAD = math.radians(0.5)
"""An arm of which no joint is farther than this from where it was stands still."""
LEAD_S = 0.25
"""What is kept of the still parts at both ends."""
SPACING_S = 0.04
"""Between two points, at first."""
MOST_TRIES = 12
DECIMALS = 6
"""Of a time in seconds and an angle in degrees, as they are kept."""


@dataclass(frozen=True)
class Readings:
    """What the encoder of one joint said: when (s) and where (rad), (readings,) each, times rising."""

    times_s: Reals
    positions_rad: Reals


@dataclass(frozen=True)
class Taught:
    """A motion, and how it came about.

    Attributes:
        hand_s: how long the hand took for it.
        slowed: joints for whose sake it is slower than the hand.
        beyond_rad: joints that were led out of their range, and how far; the motion stays inside.
    """

    motion: Motion
    hand_s: float
    slowed: tuple[str, ...]
    beyond_rad: dict[str, float]


def make(arm: str, limits: Limits, taught: str, readings: Sequence[Readings], tolerance_rad: float) -> Taught:
    """A motion along what was read of each joint, in the order of `limits`; of none where nothing was read at all.

    Raises:
        Refusal: there is too little of it, nothing moved, or it cannot be timed.
    """
    if not readings or any(len(joint.times_s) < FEWEST_READINGS for joint in readings):
        raise Refusal("Too little was recorded for a motion: lead the arm for longer. Nothing was saved.")
    inner = [
        Readings(joint.times_s, np.clip(joint.positions_rad, lower + tolerance_rad, upper - tolerance_rad))
        for joint, lower, upper in zip(readings, limits.lower_rad, limits.upper_rad, strict=True)
    ]
    splines = [smoothed(joint.times_s, joint.positions_rad, SMOOTHING_SHARE * tolerance_rad) for joint in inner]
    first_s = max(joint.times_s[0] for joint in inner)  # readings of different joints come at different times
    last_s = min(joint.times_s[-1] for joint in inner)

    def path_at(times_s: Reals) -> Reals:
        return np.column_stack([spline(times_s) for spline in splines])

    looked_at_s = np.linspace(first_s, last_s, math.ceil((last_s - first_s) / SPACING_S) + 2)
    part = moving_part(looked_at_s, path_at(looked_at_s), STILL_RAD, LEAD_S)
    if part is None:
        raise Refusal(
            f"Nothing moved: no joint was led farther than {math.degrees(STILL_RAD):g}° from where it was. "
            "Nothing was saved."
        )
    begin_s, end_s = part

    spacing_s, velocity_share, acceleration_share = SPACING_S, VELOCITY_SHARE, ACCELERATION_SHARE
    for _ in range(MOST_TRIES):
        grid_s = np.linspace(begin_s, end_s, math.ceil((end_s - begin_s) / spacing_s) + 2)
        hand = CubicSpline(grid_s, path_at(grid_s))
        timing = timed(hand, limits, velocity_share, acceleration_share, spacing_s)
        points = timing.every(FINER)
        times_s = np.round(points.times_s, DECIMALS)
        positions_rad = np.radians(np.round(np.degrees(hand(points.hand_s)), DECIMALS))
        path = curve(times_s, positions_rad)
        deviation_rad = _deviation_rad(timing, path, inner)
        velocity, acceleration = peaks(path)
        too_fast = float((velocity / limits.velocity_rad_s).max())
        too_hard = float((acceleration / limits.acceleration_rad_s2).max())
        if deviation_rad <= tolerance_rad and too_fast <= 1.0 and too_hard <= 1.0:
            break
        spacing_s *= 0.5 if deviation_rad > tolerance_rad else 1.0
        velocity_share *= min(1.0, 0.97 / too_fast)
        acceleration_share *= min(1.0, 0.97 / too_hard)
    else:
        raise Refusal(
            f"The motion cannot be kept within {math.degrees(tolerance_rad):g}° and inside the arm's limits: teach it "
            "again, more evenly, or allow more with --tolerance. Nothing was saved."
        )
    motion = Motion(arm, limits, taught, tolerance_rad, deviation_rad, times_s, positions_rad)
    if outside := motion.outside():
        raise Refusal(f"The motion is not inside the arm's limits: {outside}. Teach it again; nothing was saved.")
    return Taught(motion, end_s - begin_s, _too_fast(hand, limits), _beyond_rad(limits, readings, begin_s, end_s))


def _deviation_rad(timing: Timing, path: CubicSpline, readings: Sequence[Readings]) -> float:
    """How far any reading is at most from where the motion is at that moment of the hand."""
    worst = 0.0
    for number, joint in enumerate(readings):
        part = (joint.times_s >= timing.hand_s[0]) & (joint.times_s <= timing.hand_s[-1])
        if part.any():
            there = path(timing.time_of(joint.times_s[part]))[:, number]
            worst = max(worst, float(np.abs(there - joint.positions_rad[part]).max()))
    return worst


def _too_fast(hand: CubicSpline, limits: Limits) -> tuple[str, ...]:
    """Joints that the hand led faster or harder than they may go."""
    velocity, acceleration = peaks(hand)
    over = (velocity > limits.velocity_rad_s) | (acceleration > limits.acceleration_rad_s2)
    return tuple(joint for joint, is_over in zip(limits.joints, over, strict=True) if is_over)


def _beyond_rad(limits: Limits, readings: Sequence[Readings], begin_s: float, end_s: float) -> dict[str, float]:
    """How far each joint was led out of its range, where it was."""
    beyond = {}
    for joint, lower, upper, read in zip(limits.joints, limits.lower_rad, limits.upper_rad, readings, strict=True):
        led = read.positions_rad[(read.times_s >= begin_s) & (read.times_s <= end_s)]
        farthest = max(float(led.max() - upper), float(lower - led.min())) if len(led) else 0.0
        if farthest > 0.0:
            beyond[joint] = farthest
    return beyond
