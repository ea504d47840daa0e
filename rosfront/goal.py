"""From a FollowJointTrajectory goal to knots, or to the sentence that says why not.

Pure functions of the message (attribute access only, so anything shaped like it will do), the arm and where
the arm is commanded. A goal is checked completely before anything moves:

- effort is refused, as the drives are told positions and ignoring a wish for force would mislead;
- a last velocity up to `REST_RAD_S` counts as rest (planners leave residues); it stays in the plan, and the
  control process ends at rest all the same;
- position limits hold along the interpolant without margin, but for the rounding to pulses and counts that
  may put an arm standing at a limit just beyond it;
- velocity and acceleration hold with the configured margins as a drive sees them that is told one setpoint a
  cycle: a residual segment of 0.4 ms at the end of a MoveIt plan is not judged by its curvature;
- the way to a first point whose time is above 0 is checked as the control process would make it from the
  present commanded state;
- a header stamp in the past whose trajectory still has a part to come is started at once, from its beginning;
  one that lies in the past as a whole is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from config.schema import ArmConfig
from motion import slopes
from rosfront.limits import check_limits
from rosfront.plan import NS, GoalPlan, Present
from rosfront.refusals import (
    AccelerationsAlone,
    BadTolerance,
    DuplicateJoint,
    EmptyTrajectory,
    EndsInThePast,
    EndsMoving,
    NegativeTime,
    NoJoints,
    NotFinite,
    NotSupported,
    TimesNotRising,
    TooFar,
    TooManyPoints,
    UnknownJoint,
    Unparameterised,
    WrongSize,
)

REST_RAD_S = 1e-3
OFF = -1.0


def plan_goal(goal: Any, arm: ArmConfig, present: Present) -> GoalPlan:
    """Check a FollowJointTrajectory goal and translate it into knots; raises GoalRefused."""
    with np.errstate(over="ignore", invalid="ignore"):  # hostile numbers end up beyond a limit
        return _plan(goal, arm, present)


def _plan(goal: Any, arm: ArmConfig, present: Present) -> GoalPlan:
    names = [joint.name for joint in arm.joints]
    trajectory = goal.trajectory
    _refuse_unsupported(goal)
    columns = _columns(trajectory.joint_names, names)
    given = _read_points(trajectory.points, [str(name) for name in trajectory.joint_names], arm)
    start_ns = _start_ns(trajectory.header.stamp, int(given.times_ns[-1]), present)
    tolerances = _tolerances(goal, arm, names)
    goal_time_s = _goal_time_s(goal.goal_time_tolerance, arm.trajectory.goal_time_s)

    bridge = bool(given.times_ns[0] > 0)
    if not bridge and present.standing:
        _check_start(given.positions[0], columns, arm, present.commanded)
    plan = _complete(given, columns, arm, present, bridge, (start_ns, tolerances, goal_time_s))
    check_limits(plan, arm, present)
    return plan


@dataclass(frozen=True)
class _Points:
    """The points as they came, columns in the order of the message; derivatives NaN where not given."""

    times_ns: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    has_velocities: np.ndarray
    has_accelerations: np.ndarray


def _refuse_unsupported(goal: Any) -> None:
    if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
        raise NotSupported("The goal has a multi_dof_trajectory and this arm no such joints; leave it empty.")
    for field in ("component_path_tolerance", "component_goal_tolerance"):
        if getattr(goal, field):
            raise NotSupported(
                f"The goal has a {field}, which is for multi-dof joints, and this arm has none; empty it."
            )


def _columns(joint_names: Sequence[str], known: list[str]) -> np.ndarray:
    """Index in the configuration of each named joint."""
    if not joint_names:
        raise NoJoints(known)
    seen: set[str] = set()
    for name in joint_names:
        if name not in known:
            raise UnknownJoint(name, known)
        if name in seen:
            raise DuplicateJoint(name)
        seen.add(name)
    return np.array([known.index(name) for name in joint_names])


def _read_points(points: Sequence[Any], joint_names: list[str], arm: ArmConfig) -> _Points:
    count, width = len(points), len(joint_names)
    if count == 0:
        raise EmptyTrajectory()
    allowed = arm.trajectory.max_points
    if arm.trajectory.interpolation == "linear":
        allowed = 1 + (allowed - 1) // (arm.trajectory.interpolation_factor + 1)
    if count > allowed:
        raise TooManyPoints(count, allowed)
    for index, point in enumerate(points):
        if len(point.effort):
            raise NotSupported(
                f"Point {index} has effort, and this arm's drives are told positions; leave effort empty.",
                point=index,
            )
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
    if has_velocities[-1]:
        column = int(np.abs(velocities[-1]).argmax())
        if abs(velocities[-1, column]) > REST_RAD_S:
            raise EndsMoving(joint_names[column], float(velocities[-1, column]), REST_RAD_S)
    return _Points(times_ns, positions, velocities, accelerations, has_velocities, has_accelerations)


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


def _start_ns(stamp: Any, duration_ns: int, present: Present) -> int:
    stamp_ns = int(stamp.sec) * NS + int(stamp.nanosec)
    if stamp_ns == 0:
        return 0
    ahead_ns = stamp_ns - present.epoch_ns
    if ahead_ns + duration_ns < 0:
        raise EndsInThePast(-(ahead_ns + duration_ns) / NS)
    return present.monotonic_ns + ahead_ns if ahead_ns > 0 else 0


def _resolve(given: float, default: float, joint: str | None, field: str) -> float:
    """A tolerance: above 0 it replaces the default, 0 keeps it, -1 switches it off (0 in shared memory)."""
    if given == 0.0:
        return default
    if given == OFF:
        return 0.0
    if not np.isfinite(given) or given < 0.0:
        raise BadTolerance(joint, field, given)
    return given


def _tolerances(goal: Any, arm: ArmConfig, names: list[str]) -> np.ndarray:
    defaults = arm.trajectory
    row = (defaults.path_tolerance_rad, defaults.goal_tolerance_rad, defaults.stopped_velocity_rad_s)
    tolerances = np.tile(np.array(row), (len(names), 1))
    judged = {"path_tolerance": {"position": 0}, "goal_tolerance": {"position": 1, "velocity": 2}}
    for field, slots in judged.items():
        seen: set[str] = set()
        for entry in getattr(goal, field):
            if entry.name not in names:
                raise UnknownJoint(entry.name, names, field)
            if entry.name in seen:
                raise DuplicateJoint(entry.name, field)
            seen.add(entry.name)
            index = names.index(entry.name)
            for quantity in ("position", "velocity", "acceleration"):
                value = float(getattr(entry, quantity))
                if quantity in slots:
                    slot = slots[quantity]
                    tolerances[index, slot] = _resolve(value, row[slot], entry.name, f"{field} {quantity}")
                elif _resolve(value, 0.0, entry.name, f"{field} {quantity}") > 0.0:
                    raise NotSupported(
                        f"{field} of {entry.name} limits its {quantity} to {value:g}, which is not watched; "
                        f"give 0 there and limit its {' or '.join(slots)}.",
                        joint=entry.name,
                        value=value,
                    )
    return tolerances


def _goal_time_s(duration: Any, default_s: float) -> float:
    return _resolve(duration.sec + duration.nanosec / NS, default_s, None, "goal_time_tolerance (s)")


def _check_start(first: np.ndarray, columns: np.ndarray, arm: ArmConfig, commanded: np.ndarray) -> None:
    distances = np.abs(first - commanded[columns, 0])
    worst = int(distances.argmax())
    limit = arm.limits.start_tolerance_rad
    if distances[worst] > limit:
        raise TooFar(arm.joints[columns[worst]].name, float(distances[worst]), limit, float(first[worst]))


def _complete(
    given: _Points,
    columns: np.ndarray,
    arm: ArmConfig,
    present: Present,
    bridge: bool,
    terms: tuple[int, np.ndarray, float],
) -> GoalPlan:
    """Fill in what the points lack, and put the columns into the arm's order."""
    times_ns, positions = given.times_ns, given.positions
    if bridge:
        knots_s = np.concatenate([[0.0], times_ns / NS])
        derived = slopes.monotone(knots_s, np.vstack([present.commanded[columns, 0], positions]))[1:]
    else:
        derived = slopes.monotone(times_ns / NS, positions)
    velocities = np.where(given.has_velocities[:, np.newaxis], given.velocities, derived)
    accelerations = np.where(given.has_accelerations[:, np.newaxis], given.accelerations, 0.0)
    orders = np.where(given.has_accelerations, 5, 3)
    orders[1:] = np.where(given.has_accelerations[1:] & given.has_accelerations[:-1], 5, 3)

    knots = np.stack([positions, velocities, accelerations], axis=2)
    if arm.trajectory.interpolation == "linear":
        times_ns, knots = densify(times_ns, knots, arm.trajectory.interpolation_factor)
        orders = np.ones(len(times_ns), dtype=int)
    joints = np.zeros((len(times_ns), len(arm.joints), 3))
    joints[:, :, 0] = present.commanded[:, 0]
    joints[:, columns] = knots
    start_ns, tolerances, goal_time_s = terms
    mask = sum(1 << int(column) for column in columns)
    return GoalPlan(times_ns, orders, joints, mask, tolerances, goal_time_s, start_ns, bridge)


def densify(times_ns: np.ndarray, knots: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """`factor` linear points between each two knots, the way of the arm's tutorial: n to n + factor (n - 1).

    Times, positions and velocities are interpolated; accelerations mean nothing on straight lines and are 0.
    The path stays the polygon through the given points.
    """
    count = len(times_ns)
    at = np.arange((count - 1) * (factor + 1) + 1)
    index = np.minimum(at // (factor + 1), max(count - 2, 0))
    after = np.minimum(index + 1, count - 1)
    step = at - index * (factor + 1)
    times = times_ns[index] + step * (times_ns[after] - times_ns[index]) // (factor + 1)
    share = step / (factor + 1)
    dense = knots[index] + share[:, np.newaxis, np.newaxis] * (knots[after] - knots[index])
    dense[:, :, 2] = 0.0
    keep = np.concatenate([[True], np.diff(times) > 0])  # a gap of a few ns has no room for all of them
    return times[keep], dense[keep]
