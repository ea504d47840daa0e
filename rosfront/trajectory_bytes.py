"""A serialised trajectory_msgs/JointTrajectory as arrays, without making a message of it.

rclpy makes several objects a point, which costs as much as judging them. Streams come in one plain shape: little-endian
CDR whose points all have the same fields. There every point is laid out like the first from its positions on, because
behind a row of doubles the alignment is always the same; so the points are one array of records. Whatever has another
shape is left to rclpy.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rosfront.plan import NS
from rosfront.points import Columns, Rows

_LITTLE_ENDIAN_CDR = b"\x00\x01"
_ENCAPSULATION = 4  # bytes; offsets and alignment count from behind them
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")


class Stamp(NamedTuple):
    sec: int
    nanosec: int


class Header(NamedTuple):
    stamp: Stamp


class Trajectory(NamedTuple):
    """What of a trajectory message its checks look at."""

    header: Header
    joint_names: list[str]
    points: Columns


def parse(data: bytes) -> Trajectory | None:
    """The message, or None when it is not of the plain shape, or broken."""
    if data[:2] != _LITTLE_ENDIAN_CDR:
        return None
    body = memoryview(data)[_ENCAPSULATION:]
    try:
        stamp = Stamp(*_STAMP.unpack_from(body))
        _, at = _string(body, _STAMP.size)
        joints, at = _count(body, at)
        names = []
        for _ in range(min(joints, len(body))):
            name, at = _string(body, at)
            names.append(str(name, "utf-8"))
        points, at = _count(body, at)
        width, at = _count(body, at)
        at = _aligned(at, 8)
        velocities, behind = _row_length(body, at + 8 * width)
        accelerations, _ = _row_length(body, behind)
    except (struct.error, UnicodeDecodeError):
        return None
    if not (points and width) or {velocities, accelerations} - {0, width}:
        return None
    record, used = _record(width, bool(velocities), bool(accelerations))
    if at + (points - 1) * record.itemsize + used > len(body):
        return None
    padding = bytes(record.itemsize - used)  # the last point has no next one
    found = np.frombuffer(data + padding, record, points, _ENCAPSULATION + at)
    if (
        (found["next"][:-1] != width).any()
        or (found["velocity_count"] != velocities).any()
        or (found["acceleration_count"] != accelerations).any()
        or found["effort_count"].any()
    ):
        return None

    def rows(field: str, length: int) -> Rows:
        return np.full(points, length), found[field].ravel() if length else np.empty(0)

    return Trajectory(
        Header(stamp),
        names,
        Columns(
            times_ns=found["sec"].astype(np.int64) * NS + found["nanosec"],
            positions=rows("positions", width),
            velocities=rows("velocities", velocities),
            accelerations=rows("accelerations", accelerations),
            effort=rows("effort", 0),
        ),
    )


def _aligned(at: int, to: int) -> int:
    return at + -at % to


def _count(body: memoryview, at: int) -> tuple[int, int]:
    """A number of elements, and where they begin if they need no more than its alignment."""
    at = _aligned(at, _COUNT.size)
    return _COUNT.unpack_from(body, at)[0], at + _COUNT.size


def _string(body: memoryview, at: int) -> tuple[memoryview, int]:
    """A string, without the zero at its end, and where it ends."""
    length, at = _count(body, at)
    return body[at : at + max(length - 1, 0)], at + length


def _row_length(body: memoryview, at: int) -> tuple[int, int]:
    """How many doubles a row has, and where it ends."""
    length, at = _count(body, at)
    return length, _aligned(at, 8) + 8 * length if length else at


@lru_cache(16)  # senders say as many widths as they like
def _record(width: int, has_velocities: bool, has_accelerations: bool) -> tuple[np.dtype, int]:
    """A point from its positions to the next one's, and how many of its bytes the last one has."""
    names, formats, offsets = ["positions"], [f"({width},)<f8"], [0]
    at = 8 * width
    for name, given in (("velocity", has_velocities), ("acceleration", has_accelerations), ("effort", False)):
        names.append(f"{name}_count")
        formats.append("<u4")
        offsets.append(at)
        at += 4
        if given:
            at = _aligned(at, 8)
            names.append("velocities" if name == "velocity" else "accelerations")
            formats.append(f"({width},)<f8")
            offsets.append(at)
            at += 8 * width
    for name, form in (("sec", "<i4"), ("nanosec", "<u4"), ("next", "<u4")):
        names.append(name)
        formats.append(form)
        offsets.append(at)
        at += 4
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": _aligned(at, 8)})
    return record, at - 4
