"""An error counts only as far as two readings in a row agree on it: the serial line has no checksum, so one alone may
be garbled."""

import math

from compilation.jit import jit
from rtloop.memory.axis import Axis


@jit
def smaller_of_same_sign(now: float, before: float) -> float:
    """The smaller of two values of the same sign, 0 where their signs differ."""
    if now * before <= 0.0:
        return 0.0
    return math.copysign(min(abs(now), abs(before)), now)


@jit
def filtered_error_rad(axis: Axis) -> float:
    """How far the joint is from its setpoint as the last two readings agree."""
    return float(
        smaller_of_same_sign(axis.tracking.reference_rad - axis.measured.position_rad, axis.tracking.error_before_rad)
    )


@jit
def steady_error_rad(axis: Axis, noise_rad: float) -> float:
    """The error to correct: the last one, or what two readings agree on if they differ by more than their noise.

    Agreement alone would leave a joint that swings about its setpoint to itself, and roughen slow motion.
    """
    now_rad = float(axis.tracking.reference_rad - axis.measured.position_rad)
    return now_rad if abs(now_rad - axis.tracking.error_before_rad) <= noise_rad else float(filtered_error_rad(axis))


@jit
def filtered_error_rad_s(axis: Axis) -> float:
    """The same of its velocity."""
    now = axis.tracking.reference_velocity_rad_s - axis.measured.velocity_rad_s
    return float(smaller_of_same_sign(now, axis.tracking.velocity_error_before_rad_s))


@jit
def filtered_error_rad_s2(axis: Axis) -> float:
    """The same of its acceleration, which is smoothed."""
    return float(
        smaller_of_same_sign(axis.tracking.error_acceleration_rad_s2, axis.tracking.error_acceleration_before_rad_s2)
    )
