"""Leading a drive that follows set-points: it goes where each one says, as hard as it can, and plans nothing itself."""

from typing import Any

from shm.jit import jit

Loop = Any  # record of dtype rtloop.state.LOOP


@jit
def setpoint(loop: Loop, joint: int) -> tuple[float, float]:
    """Position (rad) and velocity (rad/s) of the joint in the middle of the time for which this cycle's frame counts.

    It arrives `command_delay_s` into the cycle and holds for a period: what is right in the middle of that is early by
    as much as it becomes late, so the drive is on time in the mean.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    share = row.command_delay_s / (loop.params.period_ns * 1e-9) + 0.5
    position = axis.position_rad + share * (axis.next_position_rad - axis.position_rad)
    velocity = axis.velocity_rad_s + share * (axis.next_velocity_rad_s - axis.velocity_rad_s)
    return min(max(position, row.lower_rad - row.slack_rad), row.upper_rad + row.slack_rad), velocity
