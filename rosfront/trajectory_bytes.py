"""A serialised trajectory_msgs/JointTrajectory as arrays, without making a message of it.

rclpy makes several objects per point, with the interpreter locked. For 200,000 points that takes a second or more, in
which this process sends no heartbeat. Usually all points of a message have the same fields. Then every point is laid
out like the first from its positions on, because behind a row of doubles the alignment is always the same; so the
points are read as one array of records. Points that differ are parsed one by one.
"""

from __future__ import annotations

import struct
from array import array
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rosfront.plan import NS
from rosfront.points import Columns, Rows
from rosfront.refusals import TooManyPoints, TooMuchBeside

LITTLE_ENDIAN_CDR = b"\x00\x01"
ENCAPSULATION = 4  # bytes; offsets and alignment count from their end
MOST_BESIDE = 65_536
"""Bytes that a message may have besides its points: fifty times what the names of 32 joints take."""
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_DURATION = struct.Struct("<iI")
_FIELDS = ("positions", "velocities", "accelerations", "effort")
_SHORTEST_POINT = len(_FIELDS) * _COUNT.size + _DURATION.size


class Stamp(NamedTuple):
    sec: int
    nanosec: int


class Header(NamedTuple):
    stamp: Stamp


class Trajectory(NamedTuple):
    """The parts of a trajectory message that its checks read."""

    header: Header
    joint_names: list[str]
    points: Columns


def parse(data: bytes, most_points: int) -> Trajectory | None:
    """The message, or None when it is not little-endian, or broken; raises TooManyPoints, TooMuchBeside."""
    if data[:2] != LITTLE_ENDIAN_CDR:
        return None
    found = trajectory_at(memoryview(data)[ENCAPSULATION:], 0, most_points)
    return None if found is None else found[0]


def trajectory_at(body: memoryview, at: int, most_points: int) -> tuple[Trajectory, int] | None:
    """The trajectory at offset `at`, a multiple of 8, and the offset where it ends; None when it is broken.

    Raises TooManyPoints, TooMuchBeside before any point is read, as reading takes time.
    """
    try:
        stamp = Stamp(*_STAMP.unpack_from(body, at))
        _, behind = string_at(body, at + _STAMP.size)
        joints, behind = count_at(body, behind)
        names: list[str] = []
        while len(names) < joints:
            name, behind = string_at(body, behind)
            if behind - at > MOST_BESIDE:
                raise TooMuchBeside(MOST_BESIDE)
            names.append(str(name, "utf-8"))
        points, behind = count_at(body, behind)
        if points > most_points:
            raise TooManyPoints(points, most_points)
        if points * _SHORTEST_POINT > len(body) - behind:
            return None
        columns, behind = _even_points(body, behind, points) or _any_points(body, behind, points)
    except (struct.error, UnicodeDecodeError):
        return None
    return Trajectory(Header(stamp), names, columns), behind


def aligned(at: int, to: int) -> int:
    """The first multiple of `to` from `at` on."""
    return at + -at % to


def count_at(body: memoryview, at: int) -> tuple[int, int]:
    """The number of elements at `at`, and where it ends; raises struct.error when the body ends before."""
    at = aligned(at, _COUNT.size)
    return _COUNT.unpack_from(body, at)[0], at + _COUNT.size


def string_at(body: memoryview, at: int) -> tuple[memoryview, int]:
    """The string at `at`, without the zero at its end, and where it ends; raises struct.error."""
    length, at = count_at(body, at)
    return body[at : at + max(length - 1, 0)], at + length


def _row(body: memoryview, at: int) -> tuple[int, int, int]:
    """How many doubles the row at `at` has, where they begin and where they end."""
    length, at = count_at(body, at)
    first = aligned(at, 8) if length else at
    return length, first, first + 8 * length


def _even_points(body: memoryview, at: int, points: int) -> tuple[Columns, int] | None:
    """Points that all have the fields of the first, and where they end; None when they differ."""
    if not points:
        return None
    width, first, behind = _row(body, at)
    velocities, _, behind = _row(body, behind)
    accelerations, _, _ = _row(body, behind)
    if not width or {velocities, accelerations} - {0, width}:
        return None
    record, stride = _record(width, bool(velocities), bool(accelerations))
    last = first + (points - 1) * stride
    if last + record.itemsize > len(body):
        return None
    found = np.ndarray(points, record, body, first, (stride,))
    next_widths = np.ndarray(points - 1, "<u4", body, first + record.itemsize, (stride,))
    if (
        (next_widths != width).any()
        or (found["velocity_count"] != velocities).any()
        or (found["acceleration_count"] != accelerations).any()
        or found["effort_count"].any()
    ):
        return None

    def rows(field: str, length: int) -> Rows:
        return np.full(points, length), found[field].ravel() if length else np.empty(0)

    columns = Columns(
        times_ns=found["sec"].astype(np.int64) * NS + found["nanosec"],
        positions=rows("positions", width),
        velocities=rows("velocities", velocities),
        accelerations=rows("accelerations", accelerations),
        effort=rows("effort", 0),
    )
    return columns, last + record.itemsize


@lru_cache(16)  # bounded, since senders may use any number of widths
def _record(width: int, has_velocities: bool, has_accelerations: bool) -> tuple[np.dtype, int]:
    """The type of a point from its positions to its time, and how many bytes later the next one's positions begin."""
    names, formats, offsets = ["positions"], [f"({width},)<f8"], [0]
    at = 8 * width
    for name, given in (("velocity", has_velocities), ("acceleration", has_accelerations), ("effort", False)):
        names.append(f"{name}_count")
        formats.append("<u4")
        offsets.append(at)
        at += 4
        if given:
            at = aligned(at, 8)
            names.append("velocities" if name == "velocity" else "accelerations")
            formats.append(f"({width},)<f8")
            offsets.append(at)
            at += 8 * width
    for name, form in (("sec", "<i4"), ("nanosec", "<u4")):
        names.append(name)
        formats.append(form)
        offsets.append(at)
        at += 4
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
    return record, aligned(at + _COUNT.size, 8)


def _any_points(body: memoryview, at: int, points: int) -> tuple[Columns, int]:
    """Points of any lengths, and where they end; raises struct.error when the body ends before."""
    rows, durations = array("q"), array("q")  # objects would keep the garbage collector busy
    for _ in range(points):
        for _ in _FIELDS:
            length, first, at = _row(body, at)
            rows.append(length)
            rows.append(first)
        durations.extend(_DURATION.unpack_from(body, at := aligned(at, 4)))
        at += _DURATION.size
    lengths, firsts = np.array(rows).reshape(points, len(_FIELDS), 2).transpose(2, 1, 0)
    seconds, nanoseconds = np.array(durations).reshape(points, 2).T
    doubles = np.frombuffer(body, "<f8", len(body) // 8)
    fields = [_gathered(doubles, *field) for field in zip(lengths, firsts // 8, strict=True)]
    return Columns(seconds * NS + nanoseconds, *fields), at


def _gathered(doubles: np.ndarray, lengths: np.ndarray, firsts: np.ndarray) -> Rows:
    """The rows of these lengths that begin at these indices of `doubles`."""
    before = np.cumsum(lengths) - lengths
    return lengths, doubles[np.arange(lengths.sum()) + np.repeat(firsts - before, lengths)]
