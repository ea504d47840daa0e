"""Shapes, their distances and the pairs that MoveIt need not check, against coal, which knows nothing of ours."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import combinations, pairwise

import coal
import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_models import Pinocchio, Positions, arm_of, arms, files_of, geometry

from config.kinematics import link_poses
from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.moveit.collisions import home_rad, unchecked_pairs
from rtarm.moveit.shapes import distances_m, link_shapes, segment_distances_m

Pairs = set[frozenset[str]]

coordinates = st.floats(-1.0, 1.0).map(lambda place: round(place, 3))
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def unchecked_in_srdf(arm: ArmConfig) -> dict[frozenset[str], str]:
    """Pair → reason, as the generated file says."""
    root = ET.fromstring(files_of(arm)[f"config/{arm.name}.srdf"])
    found = [
        (pair.attrib["link1"], pair.attrib["link2"], pair.attrib["reason"]) for pair in root.iter("disable_collisions")
    ]
    assert len({frozenset(pair[:2]) for pair in found}) == len(found)
    return {frozenset((one, other)): reason for one, other, reason in found}


def random_positions(arm: ArmConfig, count: int, seed: int) -> Positions:
    """Poses inside the limits; half of all angles are at a limit, where arms fold up."""
    generator = np.random.default_rng(seed)
    lower = np.array([joint.lower_rad for joint in arm.joints])
    upper = np.array([joint.upper_rad for joint in arm.joints])
    shares = np.clip(generator.uniform(-0.5, 1.5, (count, len(lower))), 0.0, 1.0)
    positions: Positions = lower + shares * (upper - lower)
    return positions


def as_capsule(start: Positions, end: Positions, radius_m: float) -> tuple[coal.Capsule, coal.Transform3s]:
    """A bone as coal has it: around z, in the middle."""
    way = end - start
    length = float(np.linalg.norm(way))
    turn = np.eye(3)
    if length > 0.0:
        z = way / length
        x = np.linalg.svd(z[None])[2][1]
        turn = np.column_stack([x, np.cross(z, x), z])
    return coal.Capsule(radius_m, length), coal.Transform3s(turn, (start + end) / 2.0)


@given(p0=points, p1=points, q0=points, q1=points)
def test_the_distance_of_segments_is_that_of_coals_capsules(
    p0: Positions, p1: Positions, q0: Positions, q1: Positions
) -> None:
    ours = float(segment_distances_m(p0, p1, q0, q1))
    result = coal.DistanceResult()
    coal.distance(*as_capsule(p0, p1, 0.01), *as_capsule(q0, q1, 0.01), coal.DistanceRequest(), result)
    if ours > 0.03:
        assert result.min_distance == pytest.approx(ours - 0.02, abs=1e-6)
    elif ours < 0.01:
        assert result.min_distance < 0.0


@given(p0=points, way=points, share=st.floats(0, 1), step=points)
def test_segments_that_meet_or_run_beside_each_other(
    p0: Positions, way: Positions, share: float, step: Positions
) -> None:
    """The cases in which the lines' nearest points say nothing: crossing, parallel, and of no length."""
    p1 = p0 + way
    on_it = p0 + share * way
    assert float(segment_distances_m(p0, p1, on_it, on_it + step)) == pytest.approx(0.0, abs=1e-7)
    assert float(segment_distances_m(p0, p0, on_it, on_it)) == pytest.approx(np.linalg.norm(share * way), abs=1e-12)
    beside = np.cross(way, step)
    expected = pytest.approx(np.linalg.norm(beside), abs=1e-7)
    assert float(segment_distances_m(p0, p1, p0 + beside, p1 + beside)) == expected


@settings(max_examples=examples(15), deadline=None)
@given(arm=arms(most_joints=5), seed=st.integers(0, 1000))
def test_links_touch_where_the_distance_says(arm: ArmConfig, seed: int) -> None:
    """Ours is computed from bones, coal's from the cylinders and spheres of the generated robot model."""
    links = link_shapes(geometry(arm))
    pinocchio = Pinocchio(arm)
    for positions in random_positions(arm, 5, seed):
        poses = link_poses(geometry(arm), positions)
        colliding = pinocchio.colliding(positions)
        for (i, one), (j, other) in combinations(enumerate(links), 2):
            distance_m = float(distances_m(one, other, poses[i], poses[j]))
            if abs(distance_m) > 1e-6:  # the file has lengths to the nanometre
                assert (frozenset((one.name, other.name)) in colliding) == (distance_m < 0.0)


def judge(arm: ArmConfig, poses: int, seed: int) -> None:
    """The pairs of the generated file hold in random poses, as coal sees them."""
    unchecked = unchecked_in_srdf(arm)
    names = [link.name for link in link_shapes(geometry(arm))]
    adjacent = {frozenset(pair) for pair in pairwise(names)}
    assert {pair for pair, reason in unchecked.items() if reason == "Adjacent"} == adjacent
    pinocchio = Pinocchio(arm)
    at_home = pinocchio.colliding(np.array(home_rad(arm)))
    assert at_home <= set(unchecked), "home collides with pairs that are checked"
    for positions in random_positions(arm, poses, seed):
        colliding = pinocchio.colliding(positions)
        for pair, reason in unchecked.items():
            assert reason != "Never" or pair not in colliding, (pair, positions)
            assert reason != "Always" or pair in colliding, (pair, positions)


def test_the_pairs_of_episode1_hold_in_thousands_of_poses() -> None:
    judge(load_arm("episode1"), poses=4000, seed=1)


@settings(max_examples=examples(10), deadline=None)
@given(arm=arms(), seed=st.integers(0, 1000))
def test_the_pairs_of_any_arm_hold(arm: ArmConfig, seed: int) -> None:
    judge(arm, poses=150, seed=seed)


def test_what_can_really_collide_on_episode1_is_checked() -> None:
    unchecked = unchecked_in_srdf(load_arm("episode1"))
    for pair in (("base_link", "link5"), ("base_link", "link6"), ("link1", "link6"), ("link2", "link6")):
        assert frozenset(pair) not in unchecked


def test_overlap_at_home_alone_is_called_default() -> None:
    """Three bones folded onto each other at home, which opens as soon as a joint turns."""
    row = {"a_mm": 200.0, "radius_mm": 20.0}
    arm = arm_of([row, {**row, "offset_deg": 180.0}, {**row, "offset_deg": 180.0}, row])
    reasons = {(pair.one, pair.other): pair.reason for pair in unchecked_pairs(arm, geometry(arm))}
    assert reasons["link1", "link3"] == "Default"


def test_the_pairs_are_the_same_every_time() -> None:
    arm = load_arm("episode1")
    assert unchecked_pairs(arm, geometry(arm)) == unchecked_pairs(arm, geometry(arm))


def test_nothing_stands_out_of_floor_and_flange() -> None:
    links = link_shapes(geometry(load_arm("episode1")))
    assert min(z - links[0].radius_m for _, _, z in links[0].ends_m) == pytest.approx(0.0, abs=1e-12)
    assert max(z + links[-1].radius_m for _, _, z in links[-1].ends_m) == pytest.approx(0.0, abs=1e-12)
    hand = links[-2]  # its bone runs along -y to the flange, 55 mm away
    assert min(y - hand.radius_m for _, y, _ in hand.ends_m) == pytest.approx(-0.055, abs=1e-12)
