"""The gripper's section: its defaults, what it refuses, and what it costs the bus."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.budget import budget, check_budget
from config.errors import ConfigError
from config.frames import frame_bits
from config.loader import load_arm
from config.ramp import ramp_rpm_s
from config.schema import ArmConfig

SERVO = {"hook": "servo", "servo": {"address": 7}}


def episode1(gripper: dict[str, Any], **sections: Any) -> ArmConfig:
    return load_arm("episode1", overrides={"gripper": gripper, **sections})


@pytest.mark.parametrize("name", ["episode1", "mock"])
def test_the_arms_that_come_along_have_none(name: str) -> None:
    assert load_arm(name).gripper is None


def test_the_range_is_the_full_nodes() -> None:
    gripper = episode1({"hook": "simulated"}).gripper
    assert gripper is not None
    assert (gripper.lower_deg, gripper.upper_deg) == (0.0, 110.0)
    assert (gripper.closed_rad, gripper.open_rad) == (0.0, math.radians(110.0))
    higher = episode1({"hook": "simulated", "lower_deg": 20.0}).gripper
    assert higher is not None and higher.closed_rad == math.radians(20.0)


@pytest.mark.parametrize(
    ("gripper", "said"),
    [
        ({}, "hook is missing"),
        ({"hook": "servo"}, "nothing says which drive that is; add servo with at least its address"),
        ({"hook": "simulated", "servo": {"address": 7}}, "servo describes a drive, but hook is simulated"),
        ({"hook": "servo", "servo": {"address": 3}}, "address 3 is used by joint3 and the gripper"),
        ({"hook": "servo", "servo": {"address": 0}}, "address is 0, but must be at least 1 and at most 255"),
        ({**SERVO, "lower_deg": 120.0}, "lower_deg is 120, not below upper_deg 110"),
        ({**SERVO, "open_deg": 111.0}, "open_deg is 111, but the gripper goes from 0 to 110 degrees"),
        ({**SERVO, "open_deg": 5.0, "closed_deg": 5.0}, "closed_deg and open_deg are both 5"),
        ({**SERVO, "joint": "joint1"}, "a joint of the arm already"),
        ({**SERVO, "stall_time_s": 0.0}, "stall_time_s is 0, but must be at least 0.1"),
        ({**SERVO, "speed_deg_s": 9000.0, "servo": {"address": 7, "ratio": 10.0}}, "would have to turn at 15000 rpm"),
        ({"hook": "simulated", "open_deg": math.nan}, "open_deg"),
        ({**SERVO, "servo": {"address": 7, "nm_per_ampere": 0.0}}, "nm_per_ampere is 0, but must be above 0"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(gripper: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        episode1(gripper)
    assert said in str(caught.value)


def test_a_servo_needs_a_bus() -> None:
    with pytest.raises(ConfigError, match="interface mock reaches no drive"):
        load_arm("mock", overrides={"gripper": SERVO})


def test_episode1_has_room_for_a_servo_at_its_rate() -> None:
    found = check_budget(episode1(SERVO))
    # position (36) and status (3A), twenty times a second; zdt-emm-v5.md section 8
    assert found.bits_beside_s == 20 * (100 + 150 + 100 + 110) == 20 * (2 * frame_bits(True, 2) + 150 + 110)
    assert found.bus_load == pytest.approx((3450 * 120 + 9200) / 500_000)
    assert found.bus_load < 0.85
    assert found.serial_load == pytest.approx((393 * 120 + 20 * (25 + 17 + 2 * 2)) * 10 / 1_000_000)
    assert check_budget(episode1({**SERVO, "servo": {"address": 7, "nm_per_ampere": 0.5}})).fits


def test_a_rate_that_leaves_it_no_room_is_refused_with_its_share() -> None:
    with pytest.raises(ConfigError) as caught:
        check_budget(episode1(SERVO, control={"rate_hz": 122.0}))
    assert "3450 bits a cycle × 122 Hz + 9200 bit/s for the gripper = 430100 bit/s is 86.0%" in caught.value.problem
    assert "the highest rate that fits is 120.5 Hz" in caught.value.problem
    assert check_budget(load_arm("episode1", overrides={"control": {"rate_hz": 122.0}})).fits


@given(rate_hz=st.floats(10.0, 2000.0))
def test_the_highest_rate_fits_and_no_higher(rate_hz: float) -> None:
    found = budget(episode1(SERVO, control={"rate_hz": rate_hz}))
    assert found.fits == (rate_hz <= found.highest_rate_hz)
    assert found.fits == (found.bus_load <= 0.85 + 1e-12 and (found.serial_load or 0.0) <= 0.95 + 1e-12)


def test_other_hooks_cost_the_bus_nothing() -> None:
    assert budget(episode1({"hook": "simulated"})) == budget(load_arm("episode1"))


@given(speed=st.floats(1.0, 1000.0), ratio=st.floats(0.1, 15.0))
def test_its_ramp_reaches_its_speed_in_time_where_the_drive_has_one(speed: float, ratio: float) -> None:
    gripper = episode1({"hook": "servo", "speed_deg_s": speed, "servo": {"address": 7, "ratio": ratio}}).gripper
    assert gripper is not None
    assert abs(gripper.motor_rpm - speed / 6.0 * ratio) <= 0.5 or gripper.motor_rpm == 1
    assert gripper.motor_rpm / ramp_rpm_s(gripper.acc_byte) <= 0.25 + 0.5 / ramp_rpm_s(gripper.acc_byte) + 1e-9
