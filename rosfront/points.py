"""The points of a trajectory message as arrays, and what is wrong with a message whatever the arm may do.

Pure functions of the message: attribute access only, so anything shaped like it will do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from rosfront.plan import NS
from rosfront.refusals import (
    AccelerationsAlone,
    DuplicateJoint,
    EmptyTrajectory,
    NegativeTime,
    NoJoints,
    NotFinite,
    NotSupported,
    PartialGoal,
    TimesNotRising,
    UnknownJoint,
    Unparameterised,
    WrongSize,
)


@dataclass(frozen=True)
class Points:
    """The points as they came, columns in the order of the message; derivatives NaN where not given."""

    times_ns: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    has_velocities: np.ndarray
    has_accelerations: np.ndarray


def refuse_unsupported(goal: Any) -> None:
    """Refuse a FollowJointTrajectory goal with wishes for joints that are none of an arm's; raises NotSupported."""
    if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
        raise NotSupported("The goal has a multi_dof_trajectory and this arm no such joints; leave it empty.")
    for field in ("component_path_tolerance", "component_goal_tolerance"):
        if getattr(goal, field):
            raise NotSupported(
                f"The goal has a {field}, which is for multi-dof joints, and this arm has none; empty it."
            )


def columns_of(joint_names: Sequence[str], known: list[str], *, allow_partial: bool) -> np.ndarray:
    """Index among the known joints of each named one; raises BadJoints."""
    if not joint_names:
        raise NoJoints(known)
    seen: set[str] = set()
    for name in joint_names:
        if name not in known:
            raise UnknownJoint(name, known)
        if name in seen:
            raise DuplicateJoint(name)
        seen.add(name)
    if len(seen) < len(known) and not allow_partial:
        raise PartialGoal([name for name in known if name not in seen])
    return np.array([known.index(name) for name in joint_names])


def read_points(trajectory: Any) -> Points:
    """Positions for every joint at rising times, and finite numbers only; raises GoalRefused."""
    points, joint_names = trajectory.points, trajectory.joint_names
    count, width = len(points), len(joint_names)
    if count == 0:
        raise EmptyTrajectory()
    positions, _ = _read_field(points, "positions", width, required=True)
    velocities, has_velocities = _read_field(points, "velocities", width, required=False)
    accelerations, has_accelerations = _read_field(points, "accelerations", width, required=False)
    alone = np.flatnonzero(has_accelerations & ~has_velocities)
    if len(alone):
        raise AccelerationsAlone(int(alone[0]))
    for field, values, present in (
        ("position", positions, np.ones(count, dtype=bool)),
        ("velocity", velocities, has_velocities),
        ("acceleration", accelerations, has_accelerations),
    ):
        bad = np.argwhere(~np.isfinite(values) & present[:, np.newaxis])
        if len(bad):
            point, column = (int(i) for i in bad[0])
            raise NotFinite(point, joint_names[column], field, float(values[point, column]))
    times_ns = np.fromiter(
        (point.time_from_start.sec * NS + point.time_from_start.nanosec for point in points), np.int64, count
    )
    _check_times(times_ns)
    return Points(times_ns, positions, velocities, accelerations, has_velocities, has_accelerations)


def _read_field(points: Sequence[Any], field: str, width: int, *, required: bool) -> tuple[np.ndarray, np.ndarray]:
    """One field of all points as (n, width), NaN where a point does not have it, and which points have it."""
    rows = [getattr(point, field) for point in points]
    sizes = np.fromiter(map(len, rows), np.int64, len(rows))
    wrong = np.flatnonzero((sizes != width) & ((sizes != 0) | required))
    if len(wrong):
        raise WrongSize(int(wrong[0]), field, int(sizes[wrong[0]]), width)
    has = sizes == width
    values = np.full((len(rows), width), np.nan)
    values[has] = np.fromiter(chain.from_iterable(rows), float, int(sizes.sum())).reshape(-1, width)
    return values, has


def _check_times(times_ns: np.ndarray) -> None:
    if times_ns[0] < 0:
        raise NegativeTime(float(times_ns[0]) / NS)
    if len(times_ns) > 1 and not times_ns.any():
        raise Unparameterised(len(times_ns))
    stuck = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(stuck):
        point = int(stuck[0]) + 1
        raise TimesNotRising(point, float(times_ns[point - 1]) / NS, float(times_ns[point]) / NS)
