"""The limits that setpoints keep, as everybody judges them who lays, looks ahead at, or last checks a motion."""

from compilation.jit import jit
from rtloop.memory.state import Loop

ROUNDING = 1.0 + 1e-6


@jit
def highest_rad_s(loop: Loop, joint: int) -> float:
    """Velocity between two setpoints that is still commanded."""
    return float(loop.params.velocity_margin * loop.joints[joint].max_velocity_rad_s * ROUNDING)


@jit
def hardest_rad_s2(loop: Loop, joint: int) -> float:
    """Acceleration between three setpoints that is still commanded."""
    return float(loop.params.acceleration_margin * loop.joints[joint].max_acceleration_rad_s2 * ROUNDING)


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
