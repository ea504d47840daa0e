"""Reads what goal checks need from a serialised request of follow_joint_trajectory, without making a message of it.

Multi-dof joints and component tolerances, which no arm here has, are only counted, and nothing behind them is read: a
goal that has any is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rosfront.refusals import TooMuchBeside, Unreadable
from rosfront.trajectory_bytes import (
    ENCAPSULATION,
    LITTLE_ENDIAN_CDR,
    MOST_BESIDE,
    Trajectory,
    aligned,
    count_at,
    string_at,
    trajectory_at,
)

_ID_SIZE = 16
_STAMP_SIZE = 8
_DURATION = struct.Struct("<iI")
_TOLERANCE = struct.Struct("<3d")


class MultiDof(NamedTuple):
    """A multi_dof_trajectory of which only the lengths are known."""

    joint_names: Sequence[object] = ()
    points: Sequence[object] = ()


class Tolerance(NamedTuple):
    name: str
    position: float
    velocity: float
    acceleration: float


class Duration(NamedTuple):
    sec: int = 0
    nanosec: int = 0


class Goal(NamedTuple):
    """The parts of a FollowJointTrajectory goal that its checks read."""

    trajectory: Trajectory
    multi_dof_trajectory: MultiDof = MultiDof()
    path_tolerance: Sequence[Tolerance] = ()
    component_path_tolerance: Sequence[object] = ()
    goal_tolerance: Sequence[Tolerance] = ()
    component_goal_tolerance: Sequence[object] = ()
    goal_time_tolerance: Duration = Duration()


def goal_id(data: np.ndarray) -> bytes:
    """The goal id (16 bytes) in a serialised request, (n,) bytes."""
    return data[ENCAPSULATION : ENCAPSULATION + _ID_SIZE].tobytes()


def read_goal(data: np.ndarray, most_points: int) -> Goal:
    """The goal in a serialised request, (n,) bytes; raises TooManyPoints, TooMuchBeside, Unreadable."""
    body = memoryview(data)[ENCAPSULATION:]  # type: ignore[arg-type]  # an array is a buffer
    found = None
    if data[:2].tobytes() == LITTLE_ENDIAN_CDR:
        found = trajectory_at(body, _ID_SIZE, most_points)
    try:
        if found is not None:
            return _with_rest(body, *found)
    except (struct.error, UnicodeDecodeError):
        pass
    raise Unreadable(len(data), "request for control_msgs/action/FollowJointTrajectory")


def _with_rest(body: memoryview, trajectory: Trajectory, at: int) -> Goal:
    """The goal whose trajectory ends at `at`; raises TooMuchBeside, struct.error, UnicodeDecodeError."""
    _, at = string_at(body, at + _STAMP_SIZE)
    names, at = count_at(body, at)
    if names:
        return Goal(trajectory, MultiDof(joint_names=range(names)))
    points, at = count_at(body, at)
    if points:
        return Goal(trajectory, MultiDof(points=range(points)))
    path, at = _tolerances(body, at)
    components, at = count_at(body, at)
    if components:
        return Goal(trajectory, component_path_tolerance=range(components))
    end, at = _tolerances(body, at)
    components, at = count_at(body, at)
    if components:
        return Goal(trajectory, component_goal_tolerance=range(components))
    time = Duration(*_DURATION.unpack_from(body, at))
    return Goal(trajectory, path_tolerance=path, goal_tolerance=end, goal_time_tolerance=time)


def _tolerances(body: memoryview, at: int) -> tuple[list[Tolerance], int]:
    """The joint tolerances at `at`, and where they end; raises TooMuchBeside, struct.error, UnicodeDecodeError."""
    found: list[Tolerance] = []
    count, at = count_at(body, at)
    begun = at
    while len(found) < count:
        name, at = string_at(body, at)
        if at - begun > MOST_BESIDE:
            raise TooMuchBeside(MOST_BESIDE)
        at = aligned(at, 8)
        found.append(Tolerance(str(name, "utf-8"), *_TOLERANCE.unpack_from(body, at)))
        at += _TOLERANCE.size
    return found, at
