"""The limits of a joint in the cycle: what lays a motion, looks ahead at it or checks it last asks here."""

from compilation.jit import jit
from motion import limits
from rtloop.memory.axis import JointParams
from rtloop.memory.state import Loop

band = jit(limits.band)
first_broken = jit(limits.first_broken)


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
