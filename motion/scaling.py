"""Slowing down without leaving the path: the law of the trajectory clock.

A path q(τ) run with the clock rate s = dτ/dt has velocity s·q' and acceleration s²·q'' + ṡ·q'. The rate goes
from one value to another along a cubic in time that begins with the present slope and ends with slope
zero, so the acceleration of the joints stays continuous. Leaf functions; units: s, 1/s.
"""

from motion.segment import Number


def ramp(rate: Number, slope: Number, target: Number, duration_s: Number, t: Number) -> tuple[Number, Number, Number]:
    """Rate, slope and clock advance (seconds of trajectory time since t = 0) at t of a rate ramp.

    The ramp starts at `rate` with `slope` (1/s) and reaches `target` with slope zero at `duration_s` > 0;
    t must lie in [0, duration_s].
    """
    x = t / duration_s
    change = target - rate
    swing = slope * duration_s
    value = rate + x * (swing + x * ((3.0 * change - 2.0 * swing) + x * (swing - 2.0 * change)))
    derivative = (swing + x * (2.0 * (3.0 * change - 2.0 * swing) + x * 3.0 * (swing - 2.0 * change))) / duration_s
    advance = (
        duration_s
        * x
        * (rate + x * (swing / 2.0 + x * ((3.0 * change - 2.0 * swing) / 3.0 + x * (swing - 2.0 * change) / 4.0)))
    )
    return value, derivative, advance


def along(rate: Number, slope: Number, velocity: Number, acceleration: Number) -> tuple[Number, Number]:
    """Joint velocity and acceleration in time of a path derivative pair (q', q'') at clock rate and slope."""
    return rate * velocity, rate * rate * acceleration + slope * velocity
