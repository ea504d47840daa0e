"""Set-points for drives that follow them, after they were not led for a while."""

import numpy as np
import pytest

from config.loader import load_arm
from rtloop.drives import following
from rtloop.memory.axis import NOT_LED
from rtloop.process.initial_state import new_loop


@pytest.fixture
def loop() -> np.void:
    """ODrives at 200 Hz, the first joint commanded to 0 and standing 0.05 rad beside that."""
    loop = new_loop(load_arm("odrive6"), 0, 0)[0]
    loop["timing"]["cycle"] = 1000
    loop["axes"][0]["measured"]["position_rad"] = -0.05
    return loop


def behind(loop: np.void, cycles: int) -> list[float]:
    """What is still to be made good in each of the next cycles, at a setpoint that stands at 0."""
    found = []
    for _ in range(cycles):
        loop["timing"]["cycle"] += 1
        found.append(following.still_behind_rad(loop, 0, 0.0))
    return found


def test_a_drive_that_was_adopted_goes_on_holding_what_it_holds(loop: np.void) -> None:
    """Its load may keep it off its target: the first set-point is no step to where it is measured."""
    axis = loop["axes"][0]
    axis["sent"]["led_cycle"] = NOT_LED
    axis["sent"]["behind_rad"], axis["sent"]["behind_rad_s"] = 0.1, -0.2  # of before
    assert behind(loop, 5) == [0.0] * 5


@pytest.mark.parametrize("missed", [4, 100])
def test_a_drive_that_stood_begins_where_it_is_and_makes_it_good(loop: np.void, missed: int) -> None:
    loop["axes"][0]["sent"]["led_cycle"] = loop["timing"]["cycle"] - missed
    period_s, limit = 0.005, loop["joints"][0]["max_acceleration_rad_s2"]
    found = np.array([0.05, *behind(loop, 400)])
    steps = np.diff(found) / period_s
    assert found[1] == pytest.approx(0.05, abs=1e-3)
    assert np.abs(np.diff([0.0, *steps])).max() <= limit * period_s * 1.001
    assert np.abs(steps).max() <= 0.25 * loop["joints"][0]["max_velocity_rad_s"] * 1.001
    assert found.min() > -0.005
    assert abs(found[-1]) < 1e-3


def test_a_cycle_or_two_without_a_frame_change_nothing(loop: np.void) -> None:
    loop["axes"][0]["sent"]["led_cycle"] = loop["timing"]["cycle"] - 2
    assert behind(loop, 5) == [0.0] * 5


@pytest.mark.parametrize("joint", [0, 3])
def test_a_set_point_is_that_of_the_middle_of_the_time_for_which_it_counts(loop: np.void, joint: int) -> None:
    """From the frame's arrival on for a period of 5 ms, along a line and a ramp of velocity; then up to a limit."""
    axis, row = loop["axes"][joint], loop["joints"][joint]
    row["command_delay_s"] = 0.001
    axis["commanded"]["position_rad"], axis["commanded"]["velocity_rad_s"] = 0.1, 0.4
    axis["commanded"]["next_position_rad"], axis["commanded"]["next_velocity_rad_s"] = 0.1 + 0.002, 0.4 + 0.05
    assert following.setpoint(loop, joint) == pytest.approx((0.1 + 0.002 * 0.7, 0.4 + 0.05 * 0.7))
    for limit, sign in (("upper_rad", 1.0), ("lower_rad", -1.0)):
        end_rad = row[limit] + sign * row["slack_rad"]
        axis["commanded"]["position_rad"], axis["commanded"]["next_position_rad"] = end_rad, end_rad + sign * 0.01
        assert following.setpoint(loop, joint)[0] == end_rad


def test_a_drive_in_motion_begins_at_the_speed_of_its_setpoint(loop: np.void) -> None:
    """It has stood: what it is told begins at rest, so what it is behind begins to grow at the speed of the plan."""
    axis, row = loop["axes"][0], loop["joints"][0]
    axis["sent"]["led_cycle"] = loop["timing"]["cycle"] - 100
    axis["commanded"]["next_velocity_rad_s"] = 0.2
    (found,) = behind(loop, 1)
    change = row["max_acceleration_rad_s2"] * 0.005
    assert axis["sent"]["behind_rad_s"] == pytest.approx(0.2 - change)
    assert found == pytest.approx(0.05 + 0.005 * (0.2 - change))


@pytest.mark.parametrize(("missed", "begins_anew"), [(3, False), (4, True)])
def test_it_stands_when_it_has_not_been_led_for_more_than_three_cycles(
    loop: np.void, missed: int, begins_anew: bool
) -> None:
    loop["axes"][0]["sent"]["led_cycle"] = loop["timing"]["cycle"] + 1 - missed
    assert (behind(loop, 1) != [0.0]) == begins_anew
