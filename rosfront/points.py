"""Reads the points of a trajectory message as arrays, and refuses a message that is wrong for any arm.

Pure functions of the message: attribute access only, so any object of its shape will do.
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

Rows = tuple[np.ndarray, np.ndarray]
"""One field of all points: how many numbers each point has (n,), and all these numbers one after another."""


@dataclass(frozen=True)
class Columns:
    """The unchecked points of a message, field by field."""

    times_ns: np.ndarray
    positions: Rows
    velocities: Rows
    accelerations: Rows
    effort: Rows

    @classmethod
    def of(cls, points: Sequence[Any]) -> "Columns":
        """From messages, or any objects of their shape."""
        times_ns = np.fromiter(
            (point.time_from_start.sec * NS + point.time_from_start.nanosec for point in points), np.int64, len(points)
        )
        fields = ("positions", "velocities", "accelerations", "effort")
        return cls(times_ns, *(_rows([getattr(point, field) for point in points]) for field in fields))

    def __len__(self) -> int:
        return len(self.times_ns)


def _rows(rows: Sequence[Sequence[float]]) -> Rows:
    sizes = np.fromiter(map(len, rows), np.int64, len(rows))
    return sizes, np.fromiter(chain.from_iterable(rows), float, int(sizes.sum()))


@dataclass(frozen=True)
class Points:
    """The points as they came: times (n,), values (n, joints) in the order of the message, NaN where not given."""

    times_ns: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    has_velocities: np.ndarray
    has_accelerations: np.ndarray


def refuse_unsupported(goal: Any) -> None:
    """Raise NotSupported for a FollowJointTrajectory goal that asks something of multi-dof joints."""
    if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
        raise NotSupported("The goal has a multi_dof_trajectory and this arm no such joints; leave it empty.")
    for field in ("component_path_tolerance", "component_goal_tolerance"):
        if getattr(goal, field):
            raise NotSupported(
                f"The goal has a {field}, which is for multi-dof joints, and this arm has none; empty it."
            )


def columns_of(joint_names: Sequence[str], known: list[str], *, allow_partial: bool) -> np.ndarray:
    """The index of each named joint among the known ones; raises BadJoints."""
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


def read_points(given: Columns, joint_names: Sequence[str]) -> Points:
    """Check the points: positions for every joint, rising times and finite numbers only; raises GoalRefused."""
    width = len(joint_names)
    if len(given) == 0:
        raise EmptyTrajectory()
    positions, has_positions = _read_field("positions", given.positions, width, required=True)
    velocities, has_velocities = _read_field("velocities", given.velocities, width, required=False)
    accelerations, has_accelerations = _read_field("accelerations", given.accelerations, width, required=False)
    alone = np.flatnonzero(has_accelerations & ~has_velocities)
    if len(alone):
        raise AccelerationsAlone(int(alone[0]))
    for field, values, present in (
        ("position", positions, has_positions),
        ("velocity", velocities, has_velocities),
        ("acceleration", accelerations, has_accelerations),
    ):
        finite = np.isfinite(values)
        if finite.all():
            continue
        bad = np.argwhere(~finite & present[:, np.newaxis])
        if len(bad):
            point, column = (int(i) for i in bad[0])
            raise NotFinite(point, joint_names[column], field, float(values[point, column]))
    _check_times(given.times_ns)
    return Points(given.times_ns, positions, velocities, accelerations, has_velocities, has_accelerations)


def _read_field(field: str, rows: Rows, width: int, *, required: bool) -> tuple[np.ndarray, np.ndarray]:
    """One field of all points as (n, width), NaN where a point does not have it, and which points have it."""
    sizes, numbers = rows
    has = sizes == width
    if has.all():
        return numbers.reshape(-1, width), has
    wrong = np.flatnonzero(~has & ((sizes != 0) | required))
    if len(wrong):
        raise WrongSize(int(wrong[0]), field, int(sizes[wrong[0]]), width)
    values = np.full((len(sizes), width), np.nan)
    values[has] = numbers.reshape(-1, width)
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
