"""ZDT drives that get targets alone (`FC`): where the target lies ahead of the plan, and how an error is taken back."""

import math

import pytest

from config.loader import load_arm
from rtloop.drives import zdt
from rtloop.process.initial_state import new_loop

ARM = load_arm("episode1")


def led(joint, position_rad, velocity_rad_s):
    """A loop whose joint is commanded to move evenly and follows exactly."""
    loop = new_loop(ARM, 0, 0)
    axis = loop[0]["axes"][joint]
    axis["commanded"]["position_rad"] = axis["tracking"]["reference_rad"] = axis["measured"]["position_rad"] = (
        position_rad
    )
    axis["commanded"]["velocity_rad_s"] = axis["commanded"]["next_velocity_rad_s"] = velocity_rad_s
    axis["commanded"]["next_position_rad"] = position_rad + velocity_rad_s * ARM.control.period_ns * 1e-9
    return loop


def driven(position, speed, target, ramp, duration_s):
    """Place and speed of a drive that goes to a target by its ramp for a while: as near to sqrt(2 a d) as it can."""
    steps = 400
    dt = duration_s / steps
    for _ in range(steps):
        gap = target - position
        wanted = math.copysign(math.sqrt(2.0 * ramp * abs(gap)), gap)
        speed += min(max(wanted - speed, -ramp * dt), ramp * dt)
        position += speed * dt
    return position, speed


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("acceleration_share", [0.0, 0.5, -0.5])
def test_targets_alone_lead_a_drive_along_the_plan(direction, acceleration_share):
    """With a new target every period it is on the plan when the next one comes, at an even speed and in a ramp too."""
    joint, delay_s, period_s = 2, 0.002, ARM.control.period_ns * 1e-9
    loop = new_loop(ARM, 0, 0)
    row, axis = loop[0]["joints"][joint], loop[0]["axes"][joint]
    row["command_delay_s"] = delay_s
    ramp = float(row["silence_deceleration_rad_s2"])
    start, acceleration = direction * 0.4, direction * acceleration_share * ramp

    def plan(t):
        return start * t + 0.5 * acceleration * t * t, start + acceleration * t

    position, speed = plan(delay_s)
    worst = 0.0
    for cycle in range(20):
        now_s = cycle * period_s
        axis["commanded"]["position_rad"], axis["commanded"]["velocity_rad_s"] = plan(now_s)
        axis["commanded"]["next_position_rad"], axis["commanded"]["next_velocity_rad_s"] = plan(now_s + period_s)
        axis["commanded"]["next_acceleration_rad_s2"] = acceleration
        axis["tracking"]["reference_rad"] = axis["measured"]["position_rad"] = axis["tracking"]["error_before_rad"] = (
            0.0
        )
        target = zdt.fast_target(loop[0], joint)
        position, speed = driven(position, speed, target, ramp, period_s)
        worst = max(worst, abs(position - plan(now_s + period_s + delay_s)[0]))
    assert worst < 0.02 * abs(start) * period_s


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_targets_alone_take_an_error_back_bit_by_bit_and_never_reach_beyond_the_limits(sign):
    """An eighth of a second's share in each period, up to a quarter of what the target lies ahead; none at rest."""
    joint, speed, error = 2, 0.4, sign * 0.004
    loop = led(joint, 0.0, speed)
    config, row, axis = ARM.joints[joint], loop[0]["joints"][joint], loop[0]["axes"][joint]
    period_s, ramp = ARM.control.period_ns * 1e-9, float(row["silence_deceleration_rad_s2"])

    def target():
        return zdt.fast_target(loop[0], joint)

    without = target()
    axis["tracking"]["reference_rad"] += error
    axis["tracking"]["error_before_rad"] = error
    for cycle in (1, 2):
        assert target() - without == pytest.approx(8.0 * period_s * error * cycle, abs=config.command_pulse_rad)
        assert axis["sent"]["fast_offset_rad"] == pytest.approx(8.0 * period_s * error * cycle)
    for _ in range(100):
        target()
    led_rad_s = speed - ramp * period_s / 4.0
    assert axis["sent"]["fast_offset_rad"] == pytest.approx(
        sign * 0.25 * (led_rad_s**2 / (2.0 * ramp) + speed * period_s), rel=1e-6
    )
    end_rad = float(row["upper_rad"] + row["slack_rad"])
    axis["commanded"]["next_position_rad"] = end_rad - 1e-4
    assert target() == pytest.approx(end_rad, abs=config.command_pulse_rad)
    axis["commanded"]["velocity_rad_s"] = axis["commanded"]["next_velocity_rad_s"] = 0.0
    axis["commanded"]["next_position_rad"] = 0.1
    assert target() == pytest.approx(0.1, abs=config.command_pulse_rad)
    assert axis["sent"]["fast_offset_rad"] == 0.0
