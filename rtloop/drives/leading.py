"""Commands to a drive that plans its own ramp to the target it received last: a target ahead, and a speed limit.

A target at the setpoint would make the drive accelerate and stop in every cycle. So the target lies ahead of the
setpoint by the motion of one period and of the frame's delay, plus the braking distance of the drive's ramp. The speed
alone then sets the pace: the planned mean velocity of the coming period plus a small share of the measured error. The
ramp is 1.5 to 2 times the joint's acceleration limit, so a drive that receives nothing more brakes by itself, bounded,
towards its last target.
"""

import math

from compilation.jit import jit
from config.derived import LEAD_PERIODS
from rtloop.memory.state import Loop
from rtloop.safety.outlier_filter import steady_error_rad
from rtloop.trajectory.correction import ERROR_SHARE_1_S, ERROR_SPEED_SHARE
from rtloop.trajectory.limits import clamped_rad


@jit
def target_ahead(loop: Loop, joint: int, coarse_rad_s: float) -> tuple[float, float]:
    """Target (rad) and signed speed (rad/s) of the joint to command for the coming period.

    `coarse_rad_s` is by how much the commanded speed may be off for a period because the drive takes whole numbers
    only. The caller carries the remainder over to the next period, so the position error that this rounding causes is
    not corrected here: that would only add to it.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    commanded = axis.commanded
    period_s = loop.params.period_ns * 1e-9
    planned = (commanded.next_position_rad - commanded.position_rad) / period_s
    # the frame arrives command_delay_s into the cycle and is in force for one period from there
    speed = planned + commanded.next_acceleration_rad_s2 * row.command_delay_s
    most = ERROR_SPEED_SHARE * row.max_velocity_rad_s
    rounding_rad = coarse_rad_s * period_s
    error_rad = steady_error_rad(axis, 2.0 * row.slack_rad)
    error_rad -= min(max(error_rad, -rounding_rad), rounding_rad)
    speed += min(max(ERROR_SHARE_1_S * error_rad, -most), most)
    most = loop.params.velocity_margin * row.max_velocity_rad_s
    speed = min(max(speed, -most), most)
    lead = period_s * LEAD_PERIODS + row.command_delay_s
    brake = speed * speed / (2.0 * row.silence_deceleration_rad_s2)
    target = commanded.next_position_rad
    standing = commanded.velocity_rad_s == 0.0 and commanded.next_velocity_rad_s == 0.0
    if not standing:
        target += speed * lead + math.copysign(brake, speed)
        target = clamped_rad(row, target)
    return target, speed


@jit
def whole_rpm(loop: Loop, joint: int, speed_rad_s: float, most_rpm: int) -> int:
    """The speed as a whole number of motor rpm, up to `most_rpm`; at least 1, so that the drive reaches its target.

    The remainder of the rounding is carried over to the next period.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    wanted_rpm = abs(speed_rad_s) * row.rpm_per_rad_s + axis.sent.rpm_remainder
    rpm = round(wanted_rpm)
    axis.sent.rpm_remainder = min(max(wanted_rpm - rpm, -1.0), 1.0)
    return min(max(rpm, 1), most_rpm)
