"""Converts rotations: three angles with an axis order, as clients give them, and one rotation about one axis.

The angles are always those about x, y and z, in this order (roll, pitch, yaw), in degrees. The axis order is that of
the matrices in the product, so each rotation is about the axes as those before it have left them (intrinsic): `zyx` is
Rz(yaw) Ry(pitch) Rx(roll), the usual roll-pitch-yaw, and `xyz` is Rx(roll) Ry(pitch) Rz(yaw).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Matrices = NDArray[np.float64]
"""Rotation matrices (…, 3, 3)."""
Vectors = NDArray[np.float64]
"""Vectors (…, 3)."""

ORDERS = ("xyz", "zyx")
"""The allowed axis orders."""

_AXES = np.eye(3)
_LOCKED = 1e-9
"""Cosine of the middle angle below which the other two turn about one axis (gimbal lock)."""


def matrix_of(angles_deg: Vectors, order: str) -> Matrices:
    """The rotation (3, 3) of three angles about x, y and z in one of `ORDERS`."""
    angles_rad = np.radians(np.remainder(angles_deg, 360.0))  # the remainder is exact, so angles may have any size
    turns = dict(zip("xyz", turned(angles_rad[:, np.newaxis] * _AXES), strict=True))
    product: Matrices = turns[order[0]] @ turns[order[1]] @ turns[order[2]]
    return product


def angles_of(rotation: Matrices, order: str) -> Vectors:
    """The angles (3,) in degrees about x, y and z of a rotation (3, 3); where two of them share an axis, yaw is 0."""
    if order == "xyz":  # the transposed product has the other order and the angles' opposites
        return -angles_of(rotation.T, "zyx") + 0.0
    cosine = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], cosine)
    if cosine < _LOCKED:
        roll, yaw = np.arctan2(-rotation[1, 2], rotation[1, 1]), 0.0
    else:
        roll = np.arctan2(rotation[2, 1], rotation[2, 2])
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.degrees([roll, pitch, yaw])


def turned(vectors_rad: Vectors) -> Matrices:
    """Rotations (…, 3, 3) about the vectors' directions by their lengths in rad (Rodrigues)."""
    angle = np.linalg.norm(vectors_rad, axis=-1)[..., np.newaxis, np.newaxis]
    x, y, z = np.moveaxis(vectors_rad, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    # sin(a)/a and (1 - cos(a))/a² = sinc²(a/2)/2 are smooth at 0; numpy's sinc(x) is sin(πx)/(πx)
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    turn: Matrices = np.eye(3) + np.sinc(angle / np.pi) * cross + versine * (cross @ cross)
    return turn


def turn_of(rotation: Matrices) -> Vectors:
    """The rotation vector (3,) of a rotation (3, 3): axis times angle, at most π rad; the inverse of `turned`."""
    # The quaternion from its largest component, which keeps its precision at every angle (Shepperd 1978).
    trace = np.trace(rotation)
    squares = np.array([trace, *np.diag(rotation)])
    largest = int(squares.argmax())
    if largest == 0:
        skew = rotation - rotation.T
        quaternion = np.array([1.0 + trace, skew[2, 1], skew[0, 2], skew[1, 0]])
    else:
        i, j, k = (np.arange(3) + largest - 1) % 3
        quaternion = np.zeros(4)
        quaternion[0] = rotation[k, j] - rotation[j, k]
        quaternion[1 + i] = 1.0 + rotation[i, i] - rotation[j, j] - rotation[k, k]
        quaternion[1 + j] = rotation[j, i] + rotation[i, j]
        quaternion[1 + k] = rotation[k, i] + rotation[i, k]
    quaternion /= np.linalg.norm(quaternion)
    if quaternion[0] < 0.0:
        quaternion = -quaternion
    way = np.linalg.norm(quaternion[1:])
    if way == 0.0:
        return np.zeros(3)
    axis: Vectors = quaternion[1:] * (2.0 * np.arctan2(way, quaternion[0]) / way)
    return axis
