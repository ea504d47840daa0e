"""The simple shapes that stand for the links of an arm, and how near two of them come.

A link is a chain of bones, straight ways of its frame, as thick as `radius_mm` says: a cylinder around each bone and a
sphere at each of its ends. So the surface is everything within the radius of a bone, and the distance of two links is
that of their bones, less both radii: exact, and quick for many poses at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from config.geometry import DhRow, KinematicsConfig
from config.gripper import LINK, GripperConfig
from config.kinematics import Poses, along_x, flange_origin, joint_origins

Points = NDArray[np.float64]
"""Points or directions (…, 3), metres."""

Xyz = tuple[float, float, float]

SHORTEST_M = 1e-6
"""A way that is shorter is a point: nobody has a cylinder of that length."""


@dataclass(frozen=True)
class Bone:
    """A straight way in a link's frame (m), and the roll, pitch and yaw that turn z into its direction."""

    start_m: Xyz
    end_m: Xyz
    rpy_rad: Xyz = (0.0, 0.0, 0.0)

    @property
    def length_m(self) -> float:
        """0 for a bone that is a single point."""
        return math.dist(self.start_m, self.end_m)

    @property
    def middle_m(self) -> Xyz:
        """Half way."""
        return _between(self.start_m, self.end_m, 0.5)


@dataclass(frozen=True)
class Link:
    """The shapes of a link: all within `radius_m` of its bones."""

    name: str
    radius_m: float
    bones: tuple[Bone, ...]

    @property
    def ends_m(self) -> list[Xyz]:
        """Where the bones end, each place once."""
        return list(dict.fromkeys(end for bone in self.bones for end in (bone.start_m, bone.end_m)))


def link_shapes(kinematics: KinematicsConfig) -> list[Link]:
    """The base and the moving links, in the order of `link_poses`.

    Link i reaches along a of its row and d of the next; the base along the first d. Nothing stands out where the arm
    is mounted or where a tool is: there, shapes end with their surface.
    """
    rows = kinematics.dh
    origins = [*joint_origins(kinematics), flange_origin(kinematics)]
    links = [Link(kinematics.base_link, rows[0].radius_m, (_base_bone(rows[0]),))]
    for index, row in enumerate(rows):
        after = origins[index + 1]
        end = (0.0, 0.0, 0.0) if after is None else after.xyz_m
        links.append(Link(kinematics.link_names[index], row.radius_m, _bones(row, end)))
    return _withdrawn_from_the_flange(links, rows[-1])


def gripper_shape(gripper: GripperConfig) -> Link:
    """The gripper in the frame of the flange: a capsule along its axis, in which the fingers stay however they open."""
    length_m = gripper.length_mm / 1000.0
    radius_m = min(gripper.radius_mm / 1000.0, length_m / 2.0)
    return Link(LINK, radius_m, (Bone((0.0, 0.0, radius_m), (0.0, 0.0, length_m - radius_m)),))


def distances_m(one: Link, other: Link, one_poses: Poses, other_poses: Poses) -> NDArray[np.float64]:
    """Distance of two links' surfaces for poses (…, 4, 4) of each (m); negative where they are in each other."""
    nearest = [
        segment_distances_m(
            _placed(bone.start_m, one_poses),
            _placed(bone.end_m, one_poses),
            _placed(other_bone.start_m, other_poses),
            _placed(other_bone.end_m, other_poses),
        )
        for bone in one.bones
        for other_bone in other.bones
    ]
    distances: NDArray[np.float64] = np.min(nearest, axis=0) - (one.radius_m + other.radius_m)
    return distances


def segment_distances_m(p0: Points, p1: Points, q0: Points, q1: Points) -> NDArray[np.float64]:
    """Distance of the segments p0 p1 and q0 q1, whose ends are points (…, 3).

    The nearest two points are either both inside, where the connection is normal to both, or one of them is an end.
    """
    along_p, along_q, offset = p1 - p0, q1 - q0, q0 - p0
    pp, qq, pq = _dot(along_p, along_p), _dot(along_q, along_q), _dot(along_p, along_q)
    determinant = pp * qq - pq * pq
    skew = determinant > 1e-9 * pp * qq  # parallel ones, and points, are nearest at an end
    safe = np.where(skew, determinant, 1.0)
    s = (qq * _dot(along_p, offset) - pq * _dot(along_q, offset)) / safe
    t = (pq * _dot(along_p, offset) - pp * _dot(along_q, offset)) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    connection = offset + t[..., None] * along_q - s[..., None] * along_p
    between = np.where(inside, _length(connection), np.inf)
    at_ends = [_to_segment(p0, q0, q1), _to_segment(p1, q0, q1), _to_segment(q0, p0, p1), _to_segment(q1, p0, p1)]
    nearest: NDArray[np.float64] = np.minimum(between, np.min(at_ends, axis=0))
    return nearest


def _base_bone(first: DhRow) -> Bone:
    foot = math.copysign(min(first.radius_m, abs(first.d_m)), first.d_m)
    return Bone((0.0, 0.0, foot), (0.0, 0.0, first.d_m))


def _bones(row: DhRow, end_m: Xyz) -> tuple[Bone, ...]:
    corner_m = along_x(row)
    across = Bone((0.0, 0.0, 0.0), corner_m, (0.0, math.pi / 2.0, row.offset_rad))
    along = Bone(corner_m, end_m, (row.alpha_rad, 0.0, row.offset_rad))
    return tuple(bone for bone in (across, along) if bone.length_m > SHORTEST_M) or (Bone(end_m, end_m),)


def _withdrawn_from_the_flange(links: list[Link], last: DhRow) -> list[Link]:
    """The shapes without what would stand out of the flange, where a tool is mounted."""
    *others, before, tip = links
    if abs(last.a_m) > SHORTEST_M:
        return [*others, before, _shortened(tip)]
    if abs(last.d_m) <= SHORTEST_M:
        return links
    back_m = math.copysign(min(last.radius_m, abs(last.d_m)), -last.d_m)
    ball = Bone((0.0, 0.0, back_m), (0.0, 0.0, back_m))
    before = before if not others else _shortened(before)  # the base of a single joint stays as it is
    return [*others, before, Link(tip.name, tip.radius_m, (ball,))]


def _shortened(link: Link) -> Link:
    *bones, last = link.bones
    kept = 1.0 - min(1.0, link.radius_m / last.length_m)
    end_m = _between(last.start_m, last.end_m, kept)
    return Link(link.name, link.radius_m, (*bones, Bone(last.start_m, end_m, last.rpy_rad)))


def _between(start_m: Xyz, end_m: Xyz, share: float) -> Xyz:
    x, y, z = (start + share * (end - start) for start, end in zip(start_m, end_m, strict=True))
    return (x, y, z)


def _placed(point_m: Xyz, poses: Poses) -> Points:
    placed: Points = poses[..., :3, :3] @ np.array(point_m) + poses[..., :3, 3]
    return placed


def _dot(one: Points, other: Points) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.einsum("...i,...i->...", one, other)
    return product


def _length(ways: Points) -> NDArray[np.float64]:
    """Three times as fast as `numpy.linalg.norm`."""
    length: NDArray[np.float64] = np.sqrt(_dot(ways, ways))
    return length


def _to_segment(point: Points, start: Points, end: Points) -> NDArray[np.float64]:
    along, offset = end - start, point - start
    squared = _dot(along, along)
    share = np.clip(_dot(along, offset) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    distance: NDArray[np.float64] = _length(offset - share[..., None] * along)
    return distance
