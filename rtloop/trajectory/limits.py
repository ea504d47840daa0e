"""The limits of a joint in the cycle: what lays a motion, looks ahead at it or checks it last asks here."""

import math

from compilation.jit import jit
from motion import limits
from rtloop.memory.axis import JointParams
from rtloop.memory.state import Loop

band = jit(limits.band)
first_broken = jit(limits.first_broken)

BESIDE_RAD = 1e-9
"""What the arithmetic of a stop may put a joint beyond its limit."""


@jit
def clamped_rad(row: JointParams, position_rad: float) -> float:
    """A position as near as the joint may be told it."""
    lowest_rad, highest_rad = band(row.lower_rad, row.upper_rad, row.slack_rad)
    return float(min(max(position_rad, lowest_rad), highest_rad))


@jit
def highest_rad_s(loop: Loop, joint: int) -> float:
    """Velocity between two setpoints that is still commanded."""
    return float(loop.params.velocity_margin * loop.joints[joint].max_velocity_rad_s * (1.0 + limits.ROUNDING))


@jit
def hardest_rad_s2(loop: Loop, joint: int) -> float:
    """Acceleration between three setpoints that is still commanded."""
    return float(loop.params.acceleration_margin * loop.joints[joint].max_acceleration_rad_s2 * (1.0 + limits.ROUNDING))


@jit
def stopping_distance_rad(velocity_rad_s: float, braking_rad_s2: float, period_s: float) -> float:
    """How far the setpoints of a joint still go (rad, signed) when each period takes as much velocity as can be.

    `velocity_rad_s` is that between the last two of them. What such a step leaves of the way is just what this says
    of the velocity that is left: a joint that can stop in time still can in the next cycle.
    """
    step = braking_rad_s2 * period_s
    steps = math.floor(abs(velocity_rad_s) / step)
    return math.copysign(steps * (abs(velocity_rad_s) - 0.5 * step * (steps + 1)) * period_s, velocity_rad_s)


@jit
def stop_rad(loop: Loop, joint: int, position_rad: float, velocity_rad_s: float) -> float:
    """Where a joint would stand, braked from a setpoint as hard as may be commanded."""
    period_s = loop.params.period_ns * 1e-9
    return position_rad + float(stopping_distance_rad(velocity_rad_s, hardest_rad_s2(loop, joint), period_s))


@jit
def keeps_room(
    loop: Loop, joint: int, lowest_rad: float, highest_rad: float, slowest_rad_s: float, fastest_rad_s: float
) -> bool:
    """Whether a joint can be stopped inside its limits from any setpoint within bounds of position and velocity.

    A joint at rest may be anywhere: it was found there.
    """
    row = loop.joints[joint]
    low_rad, high_rad = band(row.lower_rad, row.upper_rad, row.slack_rad)
    rises = fastest_rad_s > 0.0 and stop_rad(loop, joint, highest_rad, fastest_rad_s) > high_rad + BESIDE_RAD
    sinks = slowest_rad_s < 0.0 and stop_rad(loop, joint, lowest_rad, slowest_rad_s) < low_rad - BESIDE_RAD
    return not (rises or sinks)


@jit
def at_rest(loop: Loop) -> bool:
    """Whether nothing is commanded to move, now and next."""
    for joint in range(loop.params.joint_count):
        axis = loop.axes[joint]
        if (
            axis.commanded.velocity_rad_s != 0.0
            or axis.commanded.acceleration_rad_s2 != 0.0
            or axis.commanded.next_velocity_rad_s != 0.0
        ):
            return False
    return True
