"""What a gripper adds to the MoveIt configuration: a joint, a group, an end effector, a controller, no more."""

from __future__ import annotations

import math
import random
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_models import Pinocchio, arm_of, arms, content, files_of, robot_model

from config.errors import ConfigError
from config.kinematics import flange_pose, tip_link
from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.moveit import collisions
from rtarm.moveit.collisions import unchecked_pairs
from rtarm.moveit.shapes import distances_m

SERVO = {"hook": "servo", "servo": {"address": 7}, "lower_deg": 5.0, "closed_deg": 10.0, "speed_deg_s": 60.0}


def with_gripper(**fields: Any) -> ArmConfig:
    return load_arm("episode1", overrides={"gripper": {**SERVO, **fields}})


@pytest.fixture(scope="module")
def arm() -> ArmConfig:
    return with_gripper()


@pytest.fixture(scope="module")
def files(arm: ArmConfig) -> dict[str, str]:
    return files_of(arm)


def test_moveit_finds_its_action(files: dict[str, str]) -> None:
    manager = content(files, "moveit_controllers")["moveit_simple_controller_manager"]
    assert manager["controller_names"] == ["episode_arm_controller", "gripper_controller"]
    assert manager["gripper_controller"] == {
        "type": "GripperCommand",
        "action_ns": "gripper_cmd",
        "default": True,
        "joints": ["gripper_joint"],
    }
    assert manager["episode_arm_controller"]["joints"] == [f"joint{number}" for number in range(1, 7)]


def test_the_demo_has_a_controller_of_the_same_name_and_action(files: dict[str, str]) -> None:
    controllers = content(files, "ros2_controllers")
    kinds = controllers["controller_manager"]["ros__parameters"]
    assert kinds["gripper_controller"] == {"type": "position_controllers/GripperActionController"}
    assert controllers["gripper_controller"]["ros__parameters"] == {"joint": "gripper_joint", "allow_stalling": True}
    assert "<exec_depend>gripper_controllers</exec_depend>" in files["package.xml"]
    hardware = ET.fromstring(robot_model(with_gripper())).find("ros2_control")
    assert hardware is not None
    starts = {
        joint.attrib["name"]: float(str(joint.findtext("state_interface/param")))
        for joint in hardware.iterfind("joint")
    }
    assert starts["gripper_joint"] == math.radians(110.0)
    assert starts == content(files, "initial_positions")["initial_positions"]


def test_it_has_limits_for_planning_and_no_more(arm: ArmConfig, files: dict[str, str]) -> None:
    limits = content(files, "joint_limits")["joint_limits"]
    assert list(limits)[-1] == "gripper_joint"
    assert limits["gripper_joint"]["max_velocity"] == pytest.approx(math.radians(60.0), abs=1e-9)
    assert limits["gripper_joint"]["max_velocity"] <= math.radians(60.0)
    assert limits["gripper_joint"]["has_acceleration_limits"] is True
    assert limits["gripper_joint"]["max_acceleration"] > 0.0
    assert "gripper" not in content(files, "kinematics")
    assert content(files, "ompl_planning")["gripper"]["default_planner_config"] == "RRTConnect"


def test_its_semantics(arm: ArmConfig, files: dict[str, str]) -> None:
    root = ET.fromstring(files["config/episode1.srdf"])
    groups = {group.attrib["name"]: [part.attrib for part in group] for group in root.iterfind("group")}
    assert groups["gripper"] == [{"name": "gripper_joint"}]
    assert groups["episode_arm"] == [{"base_link": "base_link", "tip_link": "link6"}]
    states = {
        state.attrib["name"]: {joint.attrib["name"]: float(joint.attrib["value"]) for joint in state}
        for state in root.iterfind("group_state")
        if state.attrib["group"] == "gripper"
    }
    assert states == {"open": {"gripper_joint": math.radians(110)}, "closed": {"gripper_joint": math.radians(10)}}
    assert [effector.attrib for effector in root.iterfind("end_effector")] == [
        {"name": "gripper", "parent_link": "link6", "group": "gripper", "parent_group": "episode_arm"}
    ]


@settings(max_examples=5, deadline=None)
@given(arm=arms(most_joints=4), lower=st.floats(-90.0, 50.0), way=st.floats(1.0, 200.0))
def test_the_robot_model_has_it_at_the_flange(arm: ArmConfig, lower: float, way: float) -> None:
    fields = {"hook": "simulated", "lower_deg": lower, "upper_deg": lower + way}
    arm = ArmConfig.model_validate({**arm.model_dump(), "gripper": fields})
    assert arm.gripper is not None and arm.kinematics is not None
    model = ET.fromstring(robot_model(arm))
    (joint,) = [joint for joint in model.iterfind("joint") if joint.attrib["name"] == "gripper_joint"]
    assert joint.attrib["type"] == "revolute"
    parent, child, limit = joint.find("parent"), joint.find("child"), joint.find("limit")
    assert parent is not None and child is not None and limit is not None
    assert (parent.attrib["link"], child.attrib["link"]) == (tip_link(arm.kinematics), "gripper_link")
    assert (float(limit.attrib["lower"]), float(limit.attrib["upper"])) == (
        arm.gripper.lower_rad,
        arm.gripper.upper_rad,
    )
    chance = random.Random(1)
    positions = np.array([chance.uniform(joint.lower_rad, joint.upper_rad) for joint in arm.joints])
    pose = Pinocchio(arm).pose("gripper_link", positions)
    assert pose == pytest.approx(flange_pose(arm.kinematics, positions), abs=2e-6)


def test_moveit_looks_for_its_collisions_but_not_for_those_that_cannot_be(arm: ArmConfig) -> None:
    assert arm.kinematics is not None
    pairs = {(pair.one, pair.other): pair.reason for pair in unchecked_pairs(arm, arm.kinematics)}
    assert pairs["link6", "gripper_link"] == "Adjacent"
    looked_at = {f"link{n}" for n in range(1, 7)} - {one for one, other in pairs if other == "gripper_link"}
    assert {"link1", "link2"} <= looked_at, "it can touch the arm itself"
    model = Pinocchio(arm)
    chance = random.Random(0)
    for _ in range(300):
        positions = np.array([chance.uniform(joint.lower_rad, joint.upper_rad) for joint in arm.joints])
        for pair in model.colliding(positions):
            assert pairs.get(tuple(sorted(pair)), pairs.get(tuple(sorted(pair, reverse=True)), "")) != "Never"
    without = load_arm("episode1")
    assert without.kinematics is not None
    assert set(unchecked_pairs(without, without.kinematics)) <= set(unchecked_pairs(arm, arm.kinematics))


def test_its_collisions_are_looked_for_at_the_flange(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where that is not the frame of the last link."""
    plain = arm_of([{"d_mm": 100.0}, {"a_mm": 200.0}, {"a_mm": 150.0, "alpha_deg": 90.0}])
    arm = ArmConfig.model_validate({**plain.model_dump(), "gripper": {"hook": "simulated"}})
    assert arm.kinematics is not None and tip_link(arm.kinematics) == "flange"
    places: list[Any] = []

    def seen(one: Any, other: Any, one_poses: Any, other_poses: Any) -> Any:
        if other.name == "gripper_link" and not places:
            places.append(other_poses[0])
        return distances_m(one, other, one_poses, other_poses)

    monkeypatch.setattr(collisions, "distances_m", seen)
    unchecked_pairs(arm, arm.kinematics)
    assert places[0] == pytest.approx(Pinocchio(arm).pose("gripper_link", np.zeros(3)), abs=2e-6)


@pytest.mark.parametrize(("length", "radius"), [(80.0, 30.0), (20.0, 30.0), (60.0, 30.0)])
def test_its_shape_stays_between_the_flange_and_its_length(length: float, radius: float) -> None:
    arm = with_gripper(length_mm=length, radius_mm=radius)
    model = ET.fromstring(robot_model(arm))
    (link,) = [link for link in model.iterfind("link") if link.attrib["name"] == "gripper_link"]
    reach = []
    for ball in link.iterfind("collision"):
        sphere, origin = ball.find("geometry/sphere"), ball.find("origin")
        if sphere is not None and origin is not None:
            z = float(origin.attrib["xyz"].split()[2])
            reach += [z - float(sphere.attrib["radius"]), z + float(sphere.attrib["radius"])]
    assert (min(reach), max(reach)) == pytest.approx((0.0, length / 1000.0))


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ({"gripper": {**SERVO, "joint": "flange_joint"}}, "a joint of the arm already"),
        ({"gripper": {**SERVO, "controller_name": "episode_arm_controller"}}, "the arm's own controller"),
        ({"gripper": {**SERVO, "controller_name": "joint_state_broadcaster"}}, "a meaning of its own"),
        ({"gripper": SERVO, "kinematics": {"group": "gripper"}}, "group is gripper"),
        ({"gripper": SERVO, "kinematics": {"base_link": "gripper_link"}}, "base_link is gripper_link"),
        ({"gripper": {**SERVO, "joint": "no"}}, "joint is no"),
    ],
)
def test_names_that_would_meet_others_are_refused(overrides: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_arm("episode1", overrides=overrides)
