"""Inverse kinematics: what it finds is the pose, what it does not find is not there; rotations as people give them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from depth import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robot_models import Pinocchio, Positions, arm_of
from scipy.spatial.transform import Rotation

from config.kinematics import flange_pose
from config.loader import load_arm
from config.schema import ArmConfig
from rosfront.full_node.inverse import Inverse, OtherGeometry, OutOfReach, OutsideLimits
from rosfront.full_node.rotations import ORDERS, angles_of, matrix_of, turn_of, turned

EPISODE1 = load_arm("episode1")
LOWER = np.array([joint.lower_rad for joint in EPISODE1.joints])
UPPER = np.array([joint.upper_rad for joint in EPISODE1.joints])
shares = st.lists(st.floats(0, 1), min_size=6, max_size=6).map(np.array)
angles_deg = st.lists(st.floats(-360, 360), min_size=3, max_size=3).map(np.array)


def inverse_of(arm: ArmConfig) -> Inverse:
    assert arm.kinematics is not None
    return Inverse(arm.kinematics, arm.joints)


def flange(arm: ArmConfig, angles_rad: Positions) -> Positions:
    assert arm.kinematics is not None
    return flange_pose(arm.kinematics, angles_rad)


def pose_of(position_mm: list[float], rotation_deg: list[float], order: str = "xyz") -> Positions:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix_of(np.array(rotation_deg), order), np.array(position_mm) / 1e3
    return pose


EPISODE1_INVERSE = inverse_of(EPISODE1)


@st.composite
def wrist_arms(draw: st.DrawFn) -> ArmConfig:
    """Arms of the geometry that has a closed solution, of any size and with any joint zero."""
    way = st.floats(-300, 300).map(lambda mm: round(mm, 1))
    long = st.floats(20, 300).map(lambda mm: round(mm, 1))
    square = st.sampled_from([90.0, -90.0])
    rows = [
        {"d_mm": draw(way), "a_mm": draw(way), "alpha_deg": draw(square)},
        {
            "d_mm": draw(way),
            "a_mm": draw(long) * draw(st.sampled_from([1, -1])),
            "alpha_deg": draw(st.sampled_from([0, 180])),
        },
        {"d_mm": draw(way), "a_mm": draw(long), "alpha_deg": draw(st.sampled_from([90.0, -90.0, 0.0, 30.0]))},
        {"d_mm": draw(way), "alpha_deg": draw(square)},
        {"alpha_deg": draw(square)},
        {"d_mm": draw(way), "a_mm": draw(way), "alpha_deg": draw(st.floats(-180, 180))},
    ]
    for row in rows:
        row |= {"sign": draw(st.sampled_from([1, -1])), "offset_deg": draw(st.floats(-180, 180))}
    return arm_of(rows)


@settings(deadline=None, max_examples=examples(150))
@given(arm=wrist_arms(), share=shares)
def test_every_way_that_is_found_leads_to_the_pose(arm: ArmConfig, share: Positions) -> None:
    """And the one the pose was made with is among them."""
    angles = math.pi * (2.0 * share - 1.0)
    pose = flange(arm, angles)
    inverse = inverse_of(arm)
    found = inverse.solutions(pose[np.newaxis], angles)
    room = found.room[:, :, 0]
    assume(np.nanmin(room) > 1e-4)  # where ways meet, the angles are as inexact as a square root is at 0
    ways = found.angles_rad[:, 0]
    ways = ways[np.isfinite(ways).all(axis=-1)]
    assert flange(arm, ways) == pytest.approx(np.broadcast_to(pose, (len(ways), 4, 4)), abs=1e-8)
    assert np.abs(ways - angles).max(axis=1).min() < 1e-6


@settings(deadline=None, max_examples=examples(150))
@given(share=shares, seed_share=shares)
def test_forward_after_inverse_is_the_pose_and_inside_the_limits(share: Positions, seed_share: Positions) -> None:
    pose = flange(EPISODE1, LOWER + share * (UPPER - LOWER))
    seed = LOWER + seed_share * (UPPER - LOWER)
    angles = EPISODE1_INVERSE.nearest(pose, seed)
    assert flange(EPISODE1, angles) == pytest.approx(pose, abs=1e-7)
    slack = EPISODE1_INVERSE.slack_rad
    assert (angles >= LOWER - slack).all() and (angles <= UPPER + slack).all()


@settings(deadline=None, max_examples=examples(60))
@given(share=shares)
def test_from_where_the_arm_stands_it_need_not_move(share: Positions) -> None:
    angles = LOWER + share * (UPPER - LOWER)
    # Within a millionth of a fully stretched arm two ways are one, and their angles as inexact as a root of rounding.
    assert EPISODE1_INVERSE.nearest(flange(EPISODE1, angles), angles) == pytest.approx(angles, abs=1e-6)


def test_no_solution_is_nearer() -> None:
    """Beside every way, each turned by whole turns, tried one after the other."""
    random = np.random.default_rng(1)
    for _ in range(50):
        pose = flange(EPISODE1, random.uniform(LOWER, UPPER))
        seed = random.uniform(LOWER, UPPER)
        ways = EPISODE1_INVERSE.solutions(pose[np.newaxis], seed).angles_rad[:, 0]
        costs = []
        for way in ways[np.isfinite(ways).all(axis=-1)]:
            for turns in itertools.product((-1, 0, 1), repeat=6):
                angles = way + 2.0 * math.pi * np.array(turns)
                if (angles >= LOWER).all() and (angles <= UPPER).all():
                    costs.append(((angles - seed) ** 2).sum())
        chosen = EPISODE1_INVERSE.nearest(pose, seed)
        assert ((chosen - seed) ** 2).sum() == pytest.approx(min(costs), abs=1e-9)


def test_pinocchio_agrees_with_poses_and_jacobian() -> None:
    """The generated robot model in an independent library brings the flange where it was wanted."""
    pinocchio = Pinocchio(EPISODE1)
    random = np.random.default_rng(2)
    for _ in range(100):
        pose = pinocchio.pose("link6", random.uniform(LOWER, UPPER))
        angles = EPISODE1_INVERSE.nearest(pose, random.uniform(LOWER, UPPER))
        assert pinocchio.pose("link6", angles) == pytest.approx(pose, abs=1e-7)
        assert EPISODE1_INVERSE.jacobian(angles) == pytest.approx(pinocchio.jacobian("link6", angles), abs=1e-7)


@pytest.mark.parametrize("order", ORDERS)
def test_the_pose_of_the_demo_client_is_in_reach(order: str) -> None:
    pose = pose_of([260, 0, 200], [180, 0, 90], order)
    angles = EPISODE1_INVERSE.nearest(pose, np.zeros(6))
    assert flange(EPISODE1, angles) == pytest.approx(pose, abs=1e-9)
    assert pose[:3, 2] == pytest.approx([0, 0, -1])


def test_the_pose_of_the_demo_client_takes_no_turn_of_the_wrist_from_home() -> None:
    """Facts: the pose is the demo's first; read the other way round it would need 270° of joint 6."""
    angles = EPISODE1_INVERSE.nearest(pose_of([260, 0, 200], [180, 0, 90]), np.zeros(6))
    assert np.degrees(angles[[0, 3, 5]]) == pytest.approx([0, 0, 90], abs=1e-6)


@pytest.mark.parametrize(
    ("position_mm", "says"),
    [([600, 0, 200], "reaches from 0.0 to 400.0 mm"), ([0, 0, 800], "mm from joint 2's axis"), ([1e6, 0, 0], "choose")],
)
def test_a_pose_out_of_reach_is_refused_with_the_distance(position_mm: list[float], says: str) -> None:
    with pytest.raises(OutOfReach, match="out of reach") as refused:
        EPISODE1_INVERSE.nearest(pose_of(position_mm, [180, 0, 90]), np.zeros(6))
    assert says in str(refused.value)


def test_a_pose_too_near_to_the_first_axis_is_refused() -> None:
    rows = [row.model_dump() for row in EPISODE1.kinematics.dh]  # type: ignore[union-attr]
    rows[1]["d_mm"] = 80.0
    arm = arm_of(rows)
    with pytest.raises(OutOfReach, match=r"cannot come nearer than 80\.0 mm"):
        inverse_of(arm).nearest(pose_of([0, 0, 300], [180, 0, 0]), np.zeros(6))


def test_a_pose_outside_the_limits_names_the_joint() -> None:
    behind = flange(EPISODE1, np.radians([160, 20, 30, 40, 50, 60]))  # joint1 turns from -180° to 140°
    with pytest.raises(OutsideLimits, match=r"joint1 outside its limits, at -200\.0°, and allowed are -180° to 140°"):
        EPISODE1_INVERSE.nearest(behind, np.radians([130, 20, 30, 40, 50, 60]))


def test_a_free_angle_stays_where_it_is() -> None:
    """With joint 5 straight only the sum of joints 4 and 6 counts: joint 4 stays with the seed."""
    seed = np.radians([0, 0, 0, 100, 0, 20])
    angles = EPISODE1_INVERSE.nearest(flange(EPISODE1, np.radians([0, 0, 0, 60, 0, 60])), seed)
    assert np.degrees(angles) == pytest.approx([0, 0, 0, 100, 0, 20], abs=1e-5)


def test_a_straight_wrist_shares_its_turn_within_the_limits() -> None:
    """Joint 6 would have to go to 320° if joint 4 stayed."""
    seed = np.radians([0, 0, 0, -30, 10, 290])
    angles = EPISODE1_INVERSE.nearest(flange(EPISODE1, np.radians([0, 0, 0, 100, 0, 190])), seed)
    assert np.degrees(angles) == pytest.approx([0, 0, 0, 0, 0, 290], abs=1e-5)
    seed = np.radians([0, 0, 0, 40, 10, 20])
    angles = EPISODE1_INVERSE.nearest(flange(EPISODE1, np.radians([0, 0, 0, 100, 0, 0])), seed)
    assert np.degrees(angles) == pytest.approx([0, 0, 0, 40, 0, 60], abs=1e-5)


@settings(deadline=None, max_examples=examples(100))
@given(arm=st.one_of(st.just(EPISODE1), wrist_arms()), share=shares, seed_share=shares, over=st.booleans())
def test_a_pose_of_a_straight_wrist_is_in_reach_from_everywhere(
    arm: ArmConfig, share: Positions, seed_share: Positions, over: bool
) -> None:
    """`over` is a wrist folded back onto itself."""
    inverse = inverse_of(arm)
    assert arm.kinematics is not None
    row = arm.kinematics.dh[4]
    straight = row.sign * ((math.pi if over else 0.0) - row.offset_rad)
    angles = inverse.lower_rad + share * (inverse.upper_rad - inverse.lower_rad)
    angles[4] = (straight + math.pi) % (2.0 * math.pi) - math.pi
    assume(inverse.lower_rad[4] <= angles[4] <= inverse.upper_rad[4])
    pose = flange(arm, angles)
    room = inverse.solutions(pose[np.newaxis], angles).room[:2, :, 0]
    assume(np.nanmin(room) > 1e-4)  # where ways meet, the angles are as inexact as a square root is at 0
    seed = inverse.lower_rad + seed_share * (inverse.upper_rad - inverse.lower_rad)
    found = inverse.nearest(pose, seed)
    assert flange(arm, found) == pytest.approx(pose, abs=1e-6)
    assert (found >= inverse.lower_rad - inverse.slack_rad).all() and (
        found <= inverse.upper_rad + inverse.slack_rad
    ).all()


@pytest.mark.parametrize(
    ("row", "change", "says"),
    [
        (0, {"alpha_deg": 80.0}, "Row 1 .*alpha_deg must be 90 or -90"),
        (1, {"alpha_deg": 1.0}, "Row 2 .*alpha_deg must be 0 or 180"),
        (1, {"a_mm": 0.0}, "Row 2 .*a_mm must not be 0"),
        (3, {"a_mm": 1.0}, "Row 4 .*a_mm must be 0"),
        (3, {"alpha_deg": 0.0}, "Row 4 .*alpha_deg must be 90 or -90"),
        (4, {"d_mm": 1.0}, "Row 5 .*a_mm and d_mm must be 0"),
        (4, {"alpha_deg": 60.0}, "Row 5 .*alpha_deg must be 90 or -90"),
        (None, {}, "has 5 joints"),
    ],
)
def test_an_arm_of_another_geometry_is_told_why(row: int | None, change: dict[str, float], says: str) -> None:
    rows = [row.model_dump() for row in EPISODE1.kinematics.dh]  # type: ignore[union-attr]
    if row is None:
        rows = rows[:5]
    else:
        rows[row] |= change
    with pytest.raises(OtherGeometry, match=says) as refused:
        inverse_of(arm_of(rows))
    assert "MoveIt" in str(refused.value)


def test_a_forearm_without_length_is_no_arm() -> None:
    rows = [row.model_dump() for row in EPISODE1.kinematics.dh]  # type: ignore[union-attr]
    rows[2]["a_mm"] = rows[3]["d_mm"] = 0.0
    with pytest.raises(OtherGeometry, match="no length"):
        inverse_of(arm_of(rows))


@given(angles=angles_deg)
def test_rotations_are_scipys_intrinsic_ones(angles: Positions) -> None:
    """An independent library, which takes the angles in the order of its word."""
    assert matrix_of(angles, "xyz") == pytest.approx(
        Rotation.from_euler("XYZ", angles, degrees=True).as_matrix(), abs=1e-12
    )
    zyx = Rotation.from_euler("ZYX", angles[::-1], degrees=True)
    assert matrix_of(angles, "zyx") == pytest.approx(zyx.as_matrix(), abs=1e-12)
    # The usual roll, pitch, yaw about fixed axes.
    assert matrix_of(angles, "zyx") == pytest.approx(
        Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), abs=1e-12
    )


@given(angles=angles_deg, order=st.sampled_from(ORDERS), locked=st.sampled_from([None, 90.0, -90.0]))
def test_angles_of_a_rotation_make_it_again(angles: Positions, order: str, locked: float | None) -> None:
    if locked is not None:
        angles = np.array([angles[0], locked, angles[2]])
    rotation = matrix_of(angles, order)
    assert matrix_of(angles_of(rotation, order), order) == pytest.approx(rotation, abs=1e-7)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array), st.floats(0, math.pi))
def test_a_turn_is_the_rotation_vector(axis: Positions, angle: float) -> None:
    assume(np.linalg.norm(axis) > 1e-3)
    vector = axis / np.linalg.norm(axis) * angle
    rotation = turned(vector)
    assert rotation == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-12)
    assert turned(turn_of(rotation)) == pytest.approx(rotation, abs=1e-12)
    assert np.linalg.norm(turn_of(rotation)) == pytest.approx(angle, abs=1e-7)
