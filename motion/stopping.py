"""Stopping on the path, and how far a stream reaches that nobody continues.

A stop lowers the rate of the trajectory clock from 1 to 0 within T along the cubic of `motion.scaling.ramp`,
1 - 3x² + 2x³ with x = t / T. It is steepest in the middle, with 1.5 / T, and its integral is T / 2: on a straight
line a joint of velocity v is pushed with 1.5 |v| / T at the most and stands v T / 2 further on. With a braking
acceleration b for each joint all of them can stop together within T₀ = 1.5 max |v| / b.

The control process does not solve for T, since on a bent path it cannot: it tries STOP_FRACTIONS of the arm's longest
stop from short to long and takes the first that keeps the limits. On a straight line that is the shortest candidate
or one at most LENGTHENING times T₀.

What a stop adds stays within the acceleration limit (`ORDERLY`) unless safety wants the arm at rest: a person's stop, a
fault or a lost process uses `limits.braking_factor`. Leaf functions; units: rad, rad/s, rad/s², s.
"""

from itertools import pairwise

from motion.segment import Number

ORDERLY = 1.0
"""Share of the acceleration limit within which rates change and paths are entered in normal operation."""
PLAN_SHARE = 0.05
"""What a stop or a blend may add, as a share of the limit, where the plan alone uses all of it."""
STOP_FRACTIONS = (0.025, 0.035, 0.05, 0.07, 0.095, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Durations of the stops that are tried, as shares of the longest one."""
LENGTHENING = max(longer / shorter for shorter, longer in pairwise(STOP_FRACTIONS))
CYCLES_TO_BEGIN = 2.0
"""One in which the clock passes the last point, one until the ramp that follows is commanded."""
FADE_S = 0.02
FADE_PERIODS = 3.0
"""A difference in acceleration fades within this time, at least so many control periods."""


def way_s(longest_stop_s: float) -> float:
    """Path time (s) that the longest stop takes from the full rate, and that must therefore be known ahead."""
    return 0.5 * longest_stop_s


def fade_duration_s(period_s: float) -> float:
    """Time (s) in which a difference in acceleration is let go, at a control period."""
    return max(FADE_S, FADE_PERIODS * period_s)


def line_beyond(position: Number, velocity: Number, acceleration: Number, fade_s: Number) -> tuple[Number, Number]:
    """Position at the end's time, and velocity, of the straight line on which a stream runs on past its last point.

    Its acceleration goes like acceleration · (1 - t / fade_s)² (`motion.segment.fade`), so that the velocity changes
    by a third of acceleration · fade_s, and a twelfth of acceleration · fade_s² is what that lags behind the line.
    """
    return position - acceleration * fade_s * fade_s / 12.0, velocity + acceleration * fade_s / 3.0


def reach_s(to_brake_s: float, longest_stop_s: float, period_s: float) -> float:
    """Path time (s) beyond the end of a stream at which the arm stands if nothing newer comes.

    `to_brake_s` is the largest ratio of a joint's velocity on the line beyond to its braking acceleration; the way a
    joint still makes is its velocity there times the result, see the top of this file.
    """
    stop_s = max(LENGTHENING * 1.5 * to_brake_s, STOP_FRACTIONS[0] * longest_stop_s)
    return 0.5 * stop_s + CYCLES_TO_BEGIN * period_s
