"""Damiao motors in an arm file: what is refused, with which sentence, and what follows from the rest."""

import math

import pytest

from config.budget import budget
from config.drives.damiao import MODELS, DamiaoDrive
from config.errors import ConfigError
from config.loader import load_arm

GOOD = {"family": "damiao", "model": "DM4310", "mode": "mit", "motor_id": 1, "master_id": 0x11, "kp": 50.0, "kd": 1.0}
PLANNING = {name: value for name, value in GOOD.items() if name not in ("kp", "kd")} | {"mode": "position_velocity"}


def with_drives(*drives: dict, **of_joint: object) -> dict:
    """damiao6 with other drives in its first joints."""
    joints = [joint.model_dump() for joint in load_arm("damiao6").joints]
    for joint, drive in zip(joints, drives, strict=False):
        joint["drive"] = drive
    joints[0].update(of_joint)
    return {"joints": joints}


@pytest.mark.parametrize(
    ("drive", "place", "sentence"),
    [
        (GOOD | {"kp": 501.0}, "kp", "kp of joint1 is 501"),
        (GOOD | {"kp": 0.0}, "kp", "kp of joint1 is 0"),
        (GOOD | {"kd": 5.1}, "kd", "kd of joint1 is 5.1"),
        (GOOD | {"kd": -0.1}, "kd", "kd of joint1 is -0.1"),
        (
            {name: value for name, value in GOOD.items() if name != "kp"},
            "kp",
            "kp of joint1 is missing, but in mode mit",
        ),
        (
            {name: value for name, value in GOOD.items() if name != "kd"},
            "kd",
            "kd of joint1 is missing, but in mode mit",
        ),
        (PLANNING | {"kp": 50.0}, "kp", "kp of joint1 is 50, but in mode position_velocity .* remove kp"),
        (GOOD | {"motor_id": 0}, "motor_id", "motor_id of joint1 is 0"),
        (
            GOOD | {"motor_id": 0x10},
            "motor_id",
            r"motor_id of joint1 is 16 \(0x10\), but must be at least 1 and at most 15: .* a limp motor for an enabled "
            r"one; give the motor another CAN ID with the maker's tool \(ESC_ID, register 8\), and motor_id the same",
        ),
        (GOOD | {"motor_id": 0x800}, "motor_id", "motor_id of joint1 is 2048, but must be at least 1 and at most 15"),
        (GOOD | {"master_id": 0}, "master_id", "master_id of joint1 is 0"),
        (GOOD | {"master_id": 0x7FF}, "master_id", "master_id of joint1 is 2047"),
        (
            GOOD | {"master_id": 1},
            "master_id",
            "master_id of joint1 is 0x1, on which the motor with motor_id 0x1 hears",
        ),
        (GOOD | {"master_id": 0x201}, "master_id", "master_id of joint1 is 0x201, on which .* such as 0x11"),
        (GOOD | {"model": "DM1"}, "model", "model of joint1 is the text 'DM1'"),
        (GOOD | {"model": "DM-J4310-2EC"}, "model", r"'DM-J4310-2EC' \(did you mean DM4310\?\), but must be 'DM3507'"),
        (
            GOOD | {"mode": "velocity"},
            "mode",
            "mode of joint1 is the text 'velocity' .*, but must be 'mit' or 'position_velocity'",
        ),
        (GOOD | {"position_range_rad": 0.0}, "position_range_rad", "position_range_rad of joint1 is 0"),
        (GOOD | {"torque_range_nm": "10"}, "torque_range_nm", "torque_range_nm"),
    ],
)
def test_what_cannot_be_is_refused(drive: dict, place: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence) as refused:
        load_arm("damiao6", overrides=with_drives(drive))
    assert refused.value.location == f"joints[0].drive.{place}" and "joint1" in refused.value.problem


@pytest.mark.parametrize("motor_id", [1, 15])
def test_an_id_that_leaves_the_status_alone_is_taken(motor_id: int) -> None:
    load_arm("damiao6", overrides=with_drives(GOOD | {"motor_id": motor_id, "master_id": 0x21}))


@pytest.mark.parametrize("other", [{"motor_id": 1}, {"master_id": 0x11}, {"master_id": 0x101}, {"master_id": 0x301}])
def test_two_motors_that_could_be_taken_for_each_other_are_refused(other: dict) -> None:
    second = GOOD | {"motor_id": 2, "master_id": 0x12} | other
    with pytest.raises(ConfigError, match=r"joint1.*(needs a motor_id of its own|could be told from the other)"):
        load_arm("damiao6", overrides=with_drives(GOOD, second))


def test_it_is_said_which_identifier_two_motors_have_in_common() -> None:
    """Whoever gave two motors one master ID is told of that, and not of their motor IDs, which differ."""
    second = GOOD | {"motor_id": 2, "master_id": 0x11}
    with pytest.raises(ConfigError, match=r"master_id 0x11 of joint2 .* that master_id 0x11 of joint1 .* so neither"):
        load_arm("damiao6", overrides=with_drives(GOOD, second))


def test_everybodys_registers_are_shared_by_damiao_motors_alone() -> None:
    odrive = {"family": "odrive", "node_id": 1}
    load_arm("damiao6", overrides=with_drives(GOOD, odrive))
    odrive = {"family": "odrive", "node_id": 0x3F}  # 7E0 to 7FF
    with pytest.raises(ConfigError, match=r"node_id 63 of joint2 \(an ODrive axis\) uses CAN identifiers"):
        load_arm("damiao6", overrides=with_drives(GOOD, odrive))


def test_a_complaint_names_a_joint_whose_name_is_a_word_of_it() -> None:
    joints = with_drives(GOOD | {"motor_id": 16})["joints"]
    named = [joint | {"name": "a" if number == 0 else joint["name"]} for number, joint in enumerate(joints)]
    with pytest.raises(ConfigError, match=r"motor_id of a is 16 \(0x10\), but must be"):
        load_arm("damiao6", overrides={"joints": named, "kinematics": None})


def test_a_range_that_the_position_field_does_not_reach_is_refused() -> None:
    """±12.5 rad are 716°, and a joint behind a gear of 5 needs more for 160°."""
    with pytest.raises(ConfigError, match=r"lower_deg of joint1 is -180, 2.2 motor turns .* commanded within 1\.989"):
        load_arm("damiao6", overrides=with_drives(ratio=5.0))
    wider = GOOD | {"position_range_rad": 25.0}
    assert load_arm("damiao6", overrides=with_drives(wider, ratio=5.0)).joints[0].drive.highest_turns > 3.9


def test_a_speed_that_the_velocity_field_does_not_reach_is_refused() -> None:
    """10 rad/s of a DM4340 are 95.5 rpm."""
    with pytest.raises(ConfigError, match=r"motor_rpm of joint1 is 96, but must be at least 0.01 and at most 95\.493"):
        load_arm("damiao6", overrides=with_drives(motor_rpm=96.0))


def test_ranges_are_those_of_the_model_where_nothing_else_is_said() -> None:
    assert DamiaoDrive.model_validate(GOOD).ranges == MODELS["DM4310"] == (12.5, 30.0, 10.0)
    given = GOOD | {"velocity_range_rad_s": 45.0, "torque_range_nm": 12.0, "position_range_rad": 12.566}
    assert DamiaoDrive.model_validate(given).ranges == (12.566, 45.0, 12.0)
    assert set(DamiaoDrive.model_fields["model"].annotation.__args__) == set(MODELS)


@pytest.mark.parametrize("arm", ["damiao6", "damiao6_pv"])
def test_a_cycle_is_a_command_and_its_answer(arm: str) -> None:
    """1620 bits for six axes (other-drives.md), 493 Hz at 80 % of 1 Mbit/s."""
    found = budget(load_arm(arm, overrides={"bus": {"load_limit": 0.8}}))
    assert (found.frames_per_cycle, found.bits_per_cycle) == (12, 1620)
    assert math.floor(found.bus_highest_rate_hz) == 493
