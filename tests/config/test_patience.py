"""How long an arm takes to stop at most, and that who ends another is the more patient of the two."""

from __future__ import annotations

import math
from typing import Any

import pytest
from arm_files import known_arm
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from config.derived import derived_table
from config.loader import load_arm
from config.schema import ArmConfig
from config.stopping import LONGEST_ALLOWED_S, Patience, longest_stop_s


def slow_values(slowness_s: float, **limits: float) -> dict[str, Any]:
    """Mock drives, of which the third takes so long to its highest velocity, and the others a second."""
    values = known_arm("mock") | {"limits": limits}
    for index, joint in enumerate(values["joints"]):
        velocity_rad_s = joint["motor_rpm"] / joint["ratio"] * math.pi / 30.0
        joint["max_acceleration_rad_s2"] = velocity_rad_s / (slowness_s if index == 2 else min(slowness_s, 1.0))
    return values


@given(st.floats(0.1, 10.2))
def test_an_arm_stops_no_sooner_than_its_slowest_joint(slowness_s: float) -> None:
    arm = ArmConfig.model_validate(slow_values(slowness_s))
    assert arm.longest_stop_s == pytest.approx(longest_stop_s(slowness_s))
    assert arm.patience == Patience(arm.longest_stop_s)


def test_no_drive_brakes_by_itself_for_longer() -> None:
    arm = load_arm("episode1", overrides={"limits": {"acceleration_margin": 5.0, "braking_factor": 5.0}})
    assert max(joint.silence.stop_time_s for joint in derived_table(arm) if joint.silence) < arm.patience.drives_s


def test_an_arm_that_would_take_longer_than_a_minute_is_refused_with_what_would_do() -> None:
    longest_s = LONGEST_ALLOWED_S / longest_stop_s(1.0)
    ArmConfig.model_validate(slow_values(0.999 * longest_s))
    values = slow_values(1.5 * longest_s)
    with pytest.raises(ValidationError, match=r"of joint3 is .* may take 90\.0 s, and at most 60 s") as refused:
        ArmConfig.model_validate(values)
    least = float(str(refused.value).partition("raise it above ")[2].split()[0])
    values["joints"][2]["max_acceleration_rad_s2"] = 1.001 * least
    ArmConfig.model_validate(values)


@given(st.floats(0.0, LONGEST_ALLOWED_S))
def test_who_ends_another_is_more_patient_and_nobody_is_less_than_the_arm_needs(stop_s: float) -> None:
    arm = Patience(stop_s)
    # the ROS process keeps results, and lets its gripper stop, for a second each
    assert stop_s < arm.goals_s < arm.ros_process_s - 2.0
    # the control process waits 5 s more for a drive to end its homing run
    assert stop_s < arm.shutdown_s < arm.control_process_s - 5.0
    assert stop_s < arm.canceled_s and stop_s < arm.person_s and stop_s < arm.drives_s < arm.bring_up_s
