"""Where the links of an arm are: its robot model's joints, made from its Denavit–Hartenberg table, and their poses.

The standard table reaches a link's end by  Rz(q) Tz(d) Tx(a) Rx(alpha)  with  q = sign * u + offset  for joint angle
u. A joint of a robot model turns right at its origin, so each link's frame is taken between the two turns that q is
made of: behind Rz(sign * u) and Tz(d), which may change places, and before Rz(offset). What is left of row i, and the
d of the next, is the fixed way to the next joint, whose rotation Rz(offset) Rx(alpha) is just what roll, pitch and yaw
say: (alpha, 0, offset).

Frames: base, link1 … linkN; then the flange, where the last row leaves a way to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from config.geometry import DhRow, KinematicsConfig

Poses = NDArray[np.float64]
"""Homogeneous matrices (…, 4, 4), metres."""


@dataclass(frozen=True)
class Origin:
    """A frame as its parent sees it, in the form of a robot model: shift, then roll, pitch, yaw about fixed axes."""

    xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


def joint_origins(kinematics: KinematicsConfig) -> list[Origin]:
    """Where each joint sits in the frame of the link before it; joint i turns about its own z, times `sign`."""
    rows = kinematics.dh
    first = Origin((0.0, 0.0, rows[0].d_m))
    return [first, *(_way(row, following.d_m) for row, following in pairwise(rows))]


def flange_origin(kinematics: KinematicsConfig) -> Origin | None:
    """The flange in the frame of the last link; None where it is that frame: no a, alpha or offset in the last row."""
    last = kinematics.dh[-1]
    if last.a_mm == 0.0 and last.alpha_deg == 0.0 and last.offset_deg == 0.0:
        return None
    return _way(last, 0.0)


def tip_link(kinematics: KinematicsConfig) -> str:
    """Name of the link whose frame is the flange."""
    return kinematics.link_names[-1] if flange_origin(kinematics) is None else "flange"


def link_poses(kinematics: KinematicsConfig, positions_rad: NDArray[np.float64]) -> Poses:
    """Poses (…, 1 + joints, 4, 4) of the base and of every moving link for joint angles (…, joints)."""
    shape = positions_rad.shape[:-1]
    pose = np.broadcast_to(np.eye(4), (*shape, 4, 4))
    poses = [pose]
    for index, (row, origin) in enumerate(zip(kinematics.dh, joint_origins(kinematics), strict=True)):
        pose = pose @ matrix(origin) @ _turned(row.sign * positions_rad[..., index])
        poses.append(pose)
    return np.stack(poses, axis=-3)


def flange_pose(kinematics: KinematicsConfig, positions_rad: NDArray[np.float64]) -> Poses:
    """Pose (…, 4, 4) of the flange in the base for joint angles (…, joints)."""
    last: Poses = link_poses(kinematics, positions_rad)[..., -1, :, :]
    origin = flange_origin(kinematics)
    return last if origin is None else last @ matrix(origin)


def matrix(origin: Origin) -> Poses:
    """The homogeneous matrix (4, 4) of an origin: Rz(yaw) Ry(pitch) Rx(roll), then the shift."""
    roll, pitch, yaw = origin.rpy_rad
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
    x, y, z = origin.xyz_m
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def along_x(row: DhRow) -> tuple[float, float, float]:
    """The end of a row's way across, in the frame of its link (m)."""
    return (row.a_m * math.cos(row.offset_rad), row.a_m * math.sin(row.offset_rad), 0.0)


def _way(row: DhRow, next_d_m: float) -> Origin:
    """From a link's frame across its row and along the next joint's axis: Rz(offset) Tx(a) Rx(alpha) Tz(d)."""
    turn = Origin(along_x(row), (row.alpha_rad, 0.0, row.offset_rad))
    x, y, z = (matrix(turn) @ (0.0, 0.0, next_d_m, 1.0))[:3].tolist()
    return Origin((x, y, z), turn.rpy_rad)


def _turned(angle_rad: NDArray[np.float64]) -> Poses:
    pose = np.zeros((*angle_rad.shape, 4, 4))
    pose[..., 0, 0] = pose[..., 1, 1] = np.cos(angle_rad)
    pose[..., 1, 0] = np.sin(angle_rad)
    pose[..., 0, 1] = -pose[..., 1, 0]
    pose[..., 2, 2] = pose[..., 3, 3] = 1.0
    return pose
