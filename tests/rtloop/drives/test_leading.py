"""Leading a drive that plans its own ramp: where its target lies, and the speed that it is told."""

import numpy as np
import pytest

from config.derived import LEAD_PERIODS
from config.loader import load_arm
from rtloop.drives import leading
from rtloop.process.initial_state import new_loop

JOINT = 2
DELAY_S, RAMP = 0.002, 3.0
ARM = load_arm("episode1")
PERIOD_S = ARM.control.period_ns * 1e-9


@pytest.fixture
def loop() -> np.void:
    """A joint amid its range that is where it should be, on its way with 0.1 rad/s."""
    loop = new_loop(ARM, 0, 0)[0]
    axis, row = loop["axes"][JOINT], loop["joints"][JOINT]
    row["command_delay_s"], row["silence_deceleration_rad_s2"] = DELAY_S, RAMP
    axis["tracking"]["reference_rad"] = axis["measured"]["position_rad"] = 0.0
    axis["commanded"]["velocity_rad_s"] = axis["commanded"]["next_velocity_rad_s"] = 0.1
    axis["commanded"]["next_position_rad"] = 0.1 * PERIOD_S
    return loop


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("acceleration", [0.0, 2.0, -2.0])
def test_the_pace_is_that_of_the_plan_when_the_frame_arrives_and_the_target_lies_ahead(
    loop: np.void, direction: float, acceleration: float
) -> None:
    """By the way of the periods for which it must last, and by that on which the drive brakes."""
    axis = loop["axes"][JOINT]
    for word in ("velocity_rad_s", "next_velocity_rad_s", "next_position_rad"):
        axis["commanded"][word] *= direction
    axis["commanded"]["next_acceleration_rad_s2"] = acceleration
    speed = direction * 0.1 + acceleration * DELAY_S
    ahead = speed * (LEAD_PERIODS * PERIOD_S + DELAY_S) + direction * speed * speed / (2.0 * RAMP)
    assert leading.target_ahead(loop, JOINT, 0.0) == pytest.approx(
        (axis["commanded"]["next_position_rad"] + ahead, speed)
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("error_rad", "share"), [(0.001, 8.0), (0.1, None)])
def test_an_error_is_made_good_within_an_eighth_of_a_second_but_without_a_rush(
    loop: np.void, sign: float, error_rad: float, share: float | None
) -> None:
    axis, most = loop["axes"][JOINT], 0.25 * ARM.joints[JOINT].max_velocity_rad_s
    axis["tracking"]["reference_rad"] = axis["tracking"]["error_before_rad"] = sign * error_rad
    _, speed = leading.target_ahead(loop, JOINT, 0.0)
    assert speed - 0.1 == pytest.approx(sign * (share * error_rad if share else most))


@pytest.mark.parametrize(
    ("error_rad", "corrected_rad"), [(0.0005, 0.0), (-0.0005, 0.0), (0.003, 0.002), (-0.003, -0.002)]
)
def test_what_a_coarse_speed_explains_is_not_corrected(loop: np.void, error_rad: float, corrected_rad: float) -> None:
    axis = loop["axes"][JOINT]
    axis["tracking"]["reference_rad"] = axis["tracking"]["error_before_rad"] = error_rad
    _, speed = leading.target_ahead(loop, JOINT, 0.001 / PERIOD_S)
    assert speed - 0.1 == pytest.approx(8.0 * corrected_rad)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_speed_is_told_beyond_the_margin_and_no_target_beyond_the_limits(loop: np.void, sign: float) -> None:
    axis, row, config = loop["axes"][JOINT], loop["joints"][JOINT], ARM.joints[JOINT]
    axis["commanded"]["next_position_rad"] = sign * 10.0 * config.max_velocity_rad_s * PERIOD_S
    _, speed = leading.target_ahead(loop, JOINT, 0.0)
    assert speed == pytest.approx(sign * ARM.limits.velocity_margin * config.max_velocity_rad_s)
    end_rad = row["upper_rad"] + row["slack_rad"] if sign > 0.0 else row["lower_rad"] - row["slack_rad"]
    axis["commanded"]["position_rad"] = end_rad - sign * 0.001
    axis["commanded"]["next_position_rad"] = end_rad
    assert leading.target_ahead(loop, JOINT, 0.0)[0] == end_rad


def test_a_joint_that_stands_is_led_to_where_it_is_due_whatever_its_error(loop: np.void) -> None:
    axis = loop["axes"][JOINT]
    axis["commanded"]["velocity_rad_s"] = axis["commanded"]["next_velocity_rad_s"] = 0.0
    axis["commanded"]["next_position_rad"] = axis["commanded"]["position_rad"] = 0.25
    axis["tracking"]["reference_rad"] = axis["tracking"]["error_before_rad"] = 0.01
    assert leading.target_ahead(loop, JOINT, 0.0)[0] == 0.25
    for word in ("velocity_rad_s", "next_velocity_rad_s"):  # it sets off, or comes to rest
        axis["commanded"][word] = 0.1
        assert leading.target_ahead(loop, JOINT, 0.0)[0] > 0.25
        axis["commanded"][word] = 0.0


def test_whole_rpm_carry_over_what_they_leave_out(loop: np.void) -> None:
    axis, rpm_per_rad_s = loop["axes"][JOINT], loop["joints"][JOINT]["rpm_per_rad_s"]
    told = [leading.whole_rpm(loop, JOINT, -10.25 / rpm_per_rad_s, 3000) for _ in range(8)]
    assert (set(told), sum(told)) == ({10, 11}, 82)
    axis["sent"]["rpm_remainder"] = 0.0
    assert leading.whole_rpm(loop, JOINT, 0.0, 3000) == 1
    assert leading.whole_rpm(loop, JOINT, 5000.0 / rpm_per_rad_s, 3000) == 3000
    for beyond, carried in ((5.0, 1.0), (-5.0, -1.0)):
        axis["sent"]["rpm_remainder"] = beyond
        leading.whole_rpm(loop, JOINT, 10.0 / rpm_per_rad_s, 3000)
        assert abs(axis["sent"]["rpm_remainder"]) <= abs(carried)
