"""Commands to a drive that follows set-points: it goes to each one as hard as it can, and plans no motion itself."""

from compilation.jit import jit
from rtloop.memory.axis import NOT_LED
from rtloop.memory.state import Loop
from rtloop.trajectory.correction import ERROR_SHARE_1_S, ERROR_SPEED_SHARE
from rtloop.trajectory.limits import clamped_rad

STANDS_AFTER_CYCLES = 3
"""Cycles without a target after which a drive is at rest: it reaches its last one in the next, and rests soon after."""


@jit
def setpoint(loop: Loop, joint: int) -> tuple[float, float]:
    """Position (rad) and velocity (rad/s) of the joint in the middle of the time for which this cycle's frame counts.

    The frame arrives `command_delay_s` into the cycle and counts for one period. A setpoint that is exact in the middle
    of that time is as early at its beginning as it is late at its end, so the drive is on time in the mean.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    commanded = axis.commanded
    share = row.command_delay_s / (loop.params.period_ns * 1e-9) + 0.5
    position = commanded.position_rad + share * (commanded.next_position_rad - commanded.position_rad)
    velocity = commanded.velocity_rad_s + share * (commanded.next_velocity_rad_s - commanded.velocity_rad_s)
    return clamped_rad(row, position), velocity


@jit
def still_behind_rad(loop: Loop, joint: int, setpoint_rad: float) -> float:
    """How far (rad) the commanded position stays behind the setpoint because the drive got no targets for a while.

    Meanwhile the drive stood at its last target, and would jump to a new one within a period. So it is commanded to
    start at rest from where it is, within the joint's acceleration limit, and to catch up at a share of its highest
    speed. `behind_rad_s` of the axis is the rate at which the returned value changes. To be called exactly once in each
    cycle in which the drive gets a target.

    For drives whose own loop leaves no error at rest: a drive that carries a load by being off its target would let the
    load sag.
    """
    row, axis = loop.joints[joint], loop.axes[joint]
    sent = axis.sent
    period_s = loop.params.period_ns * 1e-9
    if sent.led_cycle == NOT_LED:  # it holds the commanded position, off it by what its load causes
        sent.behind_rad = sent.behind_rad_s = 0.0
    elif loop.timing.cycle - sent.led_cycle > STANDS_AFTER_CYCLES:
        sent.behind_rad = setpoint_rad - axis.measured.position_rad
        sent.behind_rad_s = axis.commanded.next_velocity_rad_s
    sent.led_cycle = loop.timing.cycle
    most = ERROR_SPEED_SHARE * row.max_velocity_rad_s
    wanted_rad_s = -min(max(ERROR_SHARE_1_S * sent.behind_rad, -most), most)
    change = row.max_acceleration_rad_s2 * period_s
    sent.behind_rad_s += min(max(wanted_rad_s - sent.behind_rad_s, -change), change)
    sent.behind_rad += sent.behind_rad_s * period_s
    return float(sent.behind_rad)
