"""MyActuator frames beyond `tests/golden/myactuator.yaml`: questions, ramps, costs, and what is refused."""

import math

import pytest
from codec_rig import Rig, arm_of, golden

from config.budget import budget
from config.loader import load_arm
from rtloop.drives.errors import error_words
from rtloop.drives.myactuator_protocol import ERRORS
from rtloop.drives.myactuator_setup import ramp_dps_s

DRIVE = golden("myactuator")["joints"]["usual"]["drive"]


def test_errors_in_words():
    assert error_words(0x0016, ERRORS) == "stall, low voltage, over-current"
    assert error_words(0x8002, ERRORS) == "stall, 0x8000"
    assert error_words(0, ERRORS) == "none"


def test_a_motor_that_is_led_is_asked_for_its_errors_alone():
    rig = Rig.named("myactuator").stands(0.0)
    for _ in range(4):
        rig.record["timing"]["cycle"] += 1
        rig.sends("lead")
        assert rig.sends("ask_status") == ["141# 9A 00 00 00 00 00 00 00"]


def test_one_with_an_error_is_asked_for_it_alone():
    rig = Rig.named("myactuator")
    rig.hears("241# 9A 32 00 01 E5 01 02 00")
    for _ in range(2):
        rig.record["timing"]["cycle"] += 1
        assert rig.sends("ask_status") == ["141# 9A 00 00 00 00 00 00 00"]


def test_the_ramp_of_silence_is_that_of_the_arm_file():
    for joint in load_arm("myactuator6").joints:
        factor = math.radians(ramp_dps_s(joint, load_arm("myactuator6"))) / joint.max_acceleration_rad_s2
        assert 1.5 <= factor <= 2.0


def test_what_a_cycle_costs():
    """Two exchanges a motor and one in turn: the angle stands beside the target, whose answer has whole degrees."""
    found = budget(load_arm("myactuator6"))
    assert found.bits_per_cycle == 6 * 4 * 135 + 2 * 135
    assert found.bus_highest_rate_hz == pytest.approx(0.85e6 / 3510)


# --- what the arm file refuses --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drives", "joint", "said"),
    [
        ((DRIVE, DRIVE), {}, "motor_id 1 is used by joint1 and joint2"),
        ((DRIVE, {"family": "odrive", "node_id": 32}), {}, "CAN identifiers"),  # 401 is motion mode of motor 1
        ((DRIVE,), {"max_acceleration_rad_s2": 0.5}, "nearest limit that has one is 0.8727"),
        ((DRIVE,), {"max_acceleration_rad_s2": 800.0}, "nearest limit that has one is 698.1"),
        ((DRIVE,), {"motor_rpm": 5600}, "at most 5461"),
    ],
)
def test_arms_that_are_refused(drives, joint, said):
    with pytest.raises(ValueError, match=said):
        arm_of(*drives, **joint)


def test_a_gear_behind_the_motor_makes_a_slow_joint_possible():
    assert arm_of(DRIVE, max_acceleration_rad_s2=0.5, ratio=5).joints[0].ratio == 5
