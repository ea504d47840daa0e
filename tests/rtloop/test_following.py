"""Set-points for drives that follow them, after they were not led for a while."""

import numpy as np
import pytest

from config.loader import load_arm
from rtloop import following
from rtloop.beginning import new_loop
from rtloop.state import NOT_LED


@pytest.fixture
def loop() -> np.void:
    """ODrives at 200 Hz, the first joint commanded to 0 and standing 0.05 rad beside that."""
    loop = new_loop(load_arm("odrive6"), 0, 0)[0]
    loop["core"]["cycle"] = 1000
    loop["axes"][0]["measured_rad"] = -0.05
    return loop


def behind(loop: np.void, cycles: int) -> list[float]:
    """What is still to be made good in each of the next cycles, at a setpoint that stands at 0."""
    found = []
    for _ in range(cycles):
        loop["core"]["cycle"] += 1
        found.append(following.still_behind_rad(loop, 0, 0.0))
    return found


def test_a_drive_that_was_adopted_goes_on_holding_what_it_holds(loop: np.void) -> None:
    """Its load may keep it off its target: the first set-point is no step to where it is measured."""
    loop["axes"][0]["led_cycle"] = NOT_LED
    assert behind(loop, 5) == [0.0] * 5


@pytest.mark.parametrize("missed", [4, 100])
def test_a_drive_that_stood_begins_where_it_is_and_makes_it_good(loop: np.void, missed: int) -> None:
    loop["axes"][0]["led_cycle"] = loop["core"]["cycle"] - missed
    period_s, limit = 0.005, loop["joints"][0]["max_acceleration_rad_s2"]
    found = np.array([0.05, *behind(loop, 400)])
    steps = np.diff(found) / period_s
    assert found[1] == pytest.approx(0.05, abs=1e-3)
    assert np.abs(np.diff([0.0, *steps])).max() <= limit * period_s * 1.001
    assert np.abs(steps).max() <= 0.25 * loop["joints"][0]["max_velocity_rad_s"] * 1.001
    assert found.min() > -0.005
    assert abs(found[-1]) < 1e-3


def test_a_cycle_or_two_without_a_frame_change_nothing(loop: np.void) -> None:
    loop["axes"][0]["led_cycle"] = loop["core"]["cycle"] - 2
    assert behind(loop, 5) == [0.0] * 5
