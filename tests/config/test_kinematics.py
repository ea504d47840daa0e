"""Where links are: the facts of Episode1, the Denavit–Hartenberg product written out, and pinocchio."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_models import Pinocchio, Positions, arm_of, arms, geometry

from config.geometry import KinematicsConfig
from config.kinematics import flange_pose, joint_origins, link_poses, matrix, tip_link
from config.loader import load_arm
from config.schema import ArmConfig

# Facts of the Episode1 arm: joint angles in degrees, flange in mm.
FLANGE = [
    ((0, 0, 0, 0, 0, 0), (302, 0, 422)),
    ((90, 0, 0, 0, 0, 0), (0, 302, 422)),
    ((0, 30, 0, 0, 0, 0), (396.908, 0, 264.203)),
    ((0, 0, 30, 0, 0, 0), (296.908, 0, 290.997)),
    ((0, 0, 0, 0, 90, 0), (247, 0, 367)),
    ((10, 20, 30, 40, 50, 60), (278.644, 76.633, 195.026)),
]


def denavit_hartenberg(kinematics: KinematicsConfig, positions_rad: Positions) -> Positions:
    """The textbook's product Rz(q) Tz(d) Tx(a) Rx(alpha) of every row."""
    pose = np.eye(4)
    for row, position_rad in zip(kinematics.dh, positions_rad, strict=True):
        q = row.sign * position_rad + math.radians(row.offset_deg)
        ca, sa = math.cos(math.radians(row.alpha_deg)), math.sin(math.radians(row.alpha_deg))
        cq, sq, a, d = math.cos(q), math.sin(q), row.a_mm / 1e3, row.d_mm / 1e3
        pose = pose @ [[cq, -sq * ca, sq * sa, a * cq], [sq, cq * ca, -cq * sa, a * sq], [0, sa, ca, d], [0, 0, 0, 1]]
    return pose


def positions_of(arm: ArmConfig, share: float) -> Positions:
    """A pose inside the limits, another share of the range for every joint."""
    shares = (share + 0.37 * np.arange(len(arm.joints))) % 1.0
    lower, upper = ([getattr(joint, limit) for joint in arm.joints] for limit in ("lower_rad", "upper_rad"))
    pose: Positions = np.array(lower) + shares * (np.array(upper) - np.array(lower))
    return pose


@pytest.mark.parametrize(("angles_deg", "flange_mm"), FLANGE)
def test_the_flange_of_episode1_is_where_the_facts_say(
    angles_deg: tuple[int, ...], flange_mm: tuple[float, ...]
) -> None:
    arm = load_arm("episode1")
    angles_rad = np.radians(angles_deg)
    pinocchio = Pinocchio(arm)
    for pose in (flange_pose(geometry(arm), angles_rad), pinocchio.pose("link6", angles_rad)):
        assert pose[:3, 3] * 1000 == pytest.approx(flange_mm, abs=1.1e-3)
    if not any(angles_deg):
        assert pose[:3, :3] == pytest.approx(np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]]), abs=1e-12)


@given(arm=arms(), share=st.floats(0, 1))
def test_the_flange_is_the_product_of_the_table(arm: ArmConfig, share: float) -> None:
    positions = positions_of(arm, share)
    expected = denavit_hartenberg(geometry(arm), positions)
    assert flange_pose(geometry(arm), positions) == pytest.approx(expected, abs=1e-12)


@settings(max_examples=examples(25), deadline=None)
@given(arm=arms(most_joints=4), share=st.floats(0, 1))
def test_pinocchio_sees_the_same_arm(arm: ArmConfig, share: float) -> None:
    """Through the generated files and the real xacro; lengths are written to the nanometre."""
    pinocchio = Pinocchio(arm)
    positions = positions_of(arm, share)
    poses = link_poses(geometry(arm), positions)
    for link, pose in zip([geometry(arm).base_link, *geometry(arm).link_names], poses, strict=True):
        assert pinocchio.pose(link, positions) == pytest.approx(pose, abs=1e-8)
    expected = denavit_hartenberg(geometry(arm), positions)
    assert pinocchio.pose(tip_link(geometry(arm)), positions) == pytest.approx(expected, abs=1e-8)


def test_many_poses_at_once_are_the_poses_one_by_one() -> None:
    arm = load_arm("episode1")
    positions = np.stack([positions_of(arm, share) for share in (0.0, 0.3, 0.8)])
    one_by_one = np.stack([flange_pose(geometry(arm), pose) for pose in positions])
    assert flange_pose(geometry(arm), positions) == pytest.approx(one_by_one, abs=1e-15)


@pytest.mark.parametrize(
    ("last", "tip"),
    [
        ({"d_mm": 55.0}, "link2"),
        ({"a_mm": 1.0}, "flange"),
        ({"alpha_deg": 90.0}, "flange"),
        ({"offset_deg": 5.0}, "flange"),
    ],
)
def test_the_tip_is_the_last_link_where_its_frame_is_the_flange(last: dict[str, Any], tip: str) -> None:
    assert tip_link(geometry(arm_of([{"d_mm": 100.0}, last]))) == tip


def test_a_joint_turns_at_its_origin() -> None:
    """The origins alone, without turns, are the chain at joint angles 0."""
    kinematics = geometry(load_arm("episode1"))
    pose = np.eye(4)
    for origin, expected in zip(joint_origins(kinematics), link_poses(kinematics, np.zeros(6))[1:], strict=True):
        pose = pose @ matrix(origin)
        assert pose == pytest.approx(expected, abs=1e-15)
