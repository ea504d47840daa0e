"""Translates a FollowJointTrajectory goal into waypoints, or refuses it with a sentence that says why.

Pure functions of the message (attribute access only, so any object of its shape will do), the arm and the arm's
commanded state. A goal is checked completely before anything moves:

- effort is refused, as the drives take positions and ignoring a wish for force would mislead;
- a last velocity up to `REST_RAD_S` counts as rest (planners leave residues); it stays in the plan, and the
  control process ends at rest all the same; a larger one is taken where the settings allow it;
- position limits are checked along the interpolant without margin, except for the rounding to pulses and counts that
  may put an arm standing at a limit just beyond it;
- velocity and acceleration are checked with their margins, as they are for a drive that gets setpoints a cycle apart,
  wherever the cycles fall: a residual segment of 0.4 ms at the end of a MoveIt plan is not judged by its curvature;
- the way to a first point whose time is above 0 is checked as the control process would make it from the
  present commanded state;
- a trajectory whose header stamp lies in the past is entered at the place that is due now, or at the latest earlier
  place that is near enough to the arm; one that lies in the past as a whole is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from config.schema import ArmConfig
from motion import slopes, stopping
from rosfront.limits import check_limits, check_positions
from rosfront.path import PlannedPath
from rosfront.plan import NS, REST_RAD_S, GoalPlan, Present, Terms
from rosfront.points import Columns, Points, columns_of, read_points, refuse_unsupported
from rosfront.refusals import (
    BadTolerance,
    DuplicateJoint,
    EndsInThePast,
    EndsMoving,
    NotSupported,
    TooDense,
    TooFar,
    TooManyPoints,
    UnknownJoint,
)
from rosfront.settings import Settings
from rosfront.shaper import shaped
from shm.words import Entry

OFF = -1.0
OFF_WITHIN = 1.2e-7  # the spacing of single-precision numbers near 1, which upstream allows
ENTER_WITHIN = 0.8
"""Share of the start tolerance within which an entry must lie, because the plan moves on until it is entered."""
LOOK_BACK_S = 60.0
"""How far back an earlier entry is searched for: no client still waits for a goal that is later than this."""
ENTRIES_A_CHUNK = 4096
WAYPOINTS_AHEAD = 4000
"""The control process sees 4096 waypoints ahead; this many must span the path time of the longest stop."""


def plan_goal(goal: Any, arm: ArmConfig, present: Present, settings: Settings) -> GoalPlan:
    """Check a FollowJointTrajectory goal and translate it into waypoints; raises GoalRefused."""
    with np.errstate(over="ignore", invalid="ignore"):  # hostile numbers end up beyond a limit
        refuse_unsupported(goal)
        names = [joint.name for joint in arm.joints]
        columns = columns_of(goal.trajectory.joint_names, names, allow_partial=settings.allow_partial_joints_goal)
        given = _read(goal.trajectory, arm)
        if not settings.allow_nonzero_end_velocity:
            _check_end(given, goal.trajectory.joint_names)
        terms = _terms(goal, settings, names)
        return _plan(goal.trajectory, given, columns, arm, present, terms, Entry(0))


def plan_stream(
    trajectory: Any, arm: ArmConfig, present: Present, settings: Settings, earlier: GoalPlan | None = None
) -> GoalPlan:
    """Check a message of `~/joint_trajectory` and translate it into waypoints; raises GoalRefused.

    Unlike for a goal, newer points are expected. So the last point may be in motion, the way to the first point is made
    gently, however near its time is, and a message that asks for more than the limits allow is followed as closely as
    they do (`rosfront.shaper`). `earlier` is the stream that the arm follows, or is about to follow.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        names = [joint.name for joint in arm.joints]
        columns = columns_of(trajectory.joint_names, names, allow_partial=settings.allow_partial_joints_goal)
        given = _read(trajectory, arm)
        terms = default_terms(settings)
        return _plan(trajectory, given, columns, arm, present, terms, Entry.STREAM, earlier=earlier)


def plan_move(trajectory: Any, arm: ArmConfig, present: Present, settings: Settings) -> GoalPlan:
    """Check a move planned by `rosfront.full_node.moves` and translate it into waypoints; raises GoalRefused.

    It is checked like a goal, with the default tolerances. Its points are joined by curves, whatever the arm file says
    about the interpolation of goals.
    """
    names = [joint.name for joint in arm.joints]
    columns = columns_of(trajectory.joint_names, names, allow_partial=False)
    given = _read(trajectory, arm)
    return _plan(trajectory, given, columns, arm, present, default_terms(settings), Entry(0), smooth=True)


def _plan(
    trajectory: Any,
    given: Points,
    columns: np.ndarray,
    arm: ArmConfig,
    present: Present,
    terms: Terms,
    entry: Entry,
    *,
    smooth: bool = False,
    earlier: GoalPlan | None = None,
) -> GoalPlan:
    start_ns, elapsed_ns = _start(trajectory.header.stamp, int(given.times_ns[-1]), present)
    if elapsed_ns < given.times_ns[0]:
        entry |= Entry.APPROACH
    mask = sum(1 << int(column) for column in columns)
    times_ns, orders, joints = _complete(given, columns, arm, present, entry, smooth=smooth)
    _check_density(given, times_ns, arm)
    whole = GoalPlan(times_ns, orders, joints, mask, terms, start_ns, elapsed_ns, entry, present.commanded)
    plan = _from_its_entry(whole, arm, present)
    if plan.stream:
        check_positions(plan, arm)
        return shaped(plan, arm, present, earlier)
    check_limits(plan, arm)
    return plan


def most_points(arm: ArmConfig) -> int:
    """How many points a received trajectory may have."""
    trajectory = arm.trajectory
    if trajectory.interpolation == "linear":
        return 1 + (trajectory.max_points - 1) // (trajectory.interpolation_factor + 1)
    return trajectory.max_points


def _read(trajectory: Any, arm: ArmConfig) -> Points:
    """The checked points of a trajectory; raises GoalRefused, also for too many points and for effort."""
    count = len(trajectory.points)
    if count > (allowed := most_points(arm)):
        raise TooManyPoints(count, allowed)
    given = trajectory.points if isinstance(trajectory.points, Columns) else Columns.of(trajectory.points)
    pushed = np.flatnonzero(given.effort[0])
    if len(pushed):
        index = int(pushed[0])
        raise NotSupported(
            f"Point {index} has effort, and this arm's drives are told positions; leave effort empty.", point=index
        )
    return read_points(given, trajectory.joint_names)


def _check_density(given: Points, times_ns: np.ndarray, arm: ArmConfig) -> None:
    """Raise TooDense unless `WAYPOINTS_AHEAD` of the waypoints always last long enough for the longest stop."""
    allowed_s = stopping.way_s(arm.longest_stop_s)
    spans_ns = times_ns[WAYPOINTS_AHEAD:] - times_ns[:-WAYPOINTS_AHEAD]
    dense = np.flatnonzero(spans_ns < allowed_s * NS)
    if len(dense):
        ends_ns = times_ns[dense[0]], times_ns[dense[0] + WAYPOINTS_AHEAD]
        first, last = np.searchsorted(given.times_ns, ends_ns)
        raise TooDense(int(first), int(last - first), float(spans_ns[dense[0]]) / NS, allowed_s)


def _check_end(given: Points, joint_names: Sequence[str]) -> None:
    """Raise EndsMoving unless the last point is at rest, apart from the residues that planners leave."""
    if given.has_velocities[-1]:
        column = int(np.abs(given.velocities[-1]).argmax())
        if abs(given.velocities[-1, column]) > REST_RAD_S:
            raise EndsMoving(joint_names[column], float(given.velocities[-1, column]), REST_RAD_S)


def _start(stamp: Any, duration_ns: int, present: Present) -> tuple[int, int]:
    """The trajectory's start (CLOCK_MONOTONIC, ns; 0 = at once) and how much of it has passed by now (ns)."""
    stamp_ns = int(stamp.sec) * NS + int(stamp.nanosec)
    if stamp_ns == 0:
        return 0, 0
    ahead_ns = stamp_ns - present.epoch_ns
    if ahead_ns + duration_ns < 0:
        raise EndsInThePast(-(ahead_ns + duration_ns) / NS)
    return present.monotonic_ns + ahead_ns or 1, max(-ahead_ns, 0)


def _resolve(given: float, default: float, joint: str | None, field: str) -> float:
    """A tolerance: above 0 it replaces the default, 0 keeps it, -1 and infinity switch it off (0 in the result)."""
    if given == 0.0:
        return default
    if abs(given - OFF) <= OFF_WITHIN or given == math.inf:
        return 0.0
    if not given > 0.0:
        raise BadTolerance(joint, field, given)
    return given


def default_terms(settings: Settings) -> Terms:
    """The tolerances of a goal that names none."""
    count = len(settings.path_tolerance_rad)
    way, arrival = np.zeros((count, 3)), np.zeros((count, 3))
    way[:, 0] = settings.path_tolerance_rad
    arrival[:, 0] = settings.goal_tolerance_rad
    arrival[:, 1] = settings.stopped_velocity_rad_s
    return Terms(way, arrival, settings.goal_time_s)


def _terms(goal: Any, settings: Settings, names: list[str]) -> Terms:
    defaults = default_terms(settings)
    for field, rows in (("path_tolerance", defaults.path_tolerances), ("goal_tolerance", defaults.goal_tolerances)):
        seen: set[str] = set()
        for entry in getattr(goal, field):
            if entry.name not in names:
                raise UnknownJoint(entry.name, names, field)
            if entry.name in seen:
                raise DuplicateJoint(entry.name, field)
            seen.add(entry.name)
            row = rows[names.index(entry.name)]
            for column, quantity in enumerate(("position", "velocity", "acceleration")):
                value = float(getattr(entry, quantity))
                row[column] = _resolve(value, row[column], entry.name, f"{field} {quantity}")
    duration = goal.goal_time_tolerance
    goal_time_s = _resolve(duration.sec + duration.nanosec / NS, settings.goal_time_s, None, "goal_time_tolerance (s)")
    return Terms(defaults.path_tolerances, defaults.goal_tolerances, goal_time_s)


def _from_its_entry(plan: GoalPlan, arm: ArmConfig, present: Present) -> GoalPlan:
    """The part of a plan that is still to come, from an entry near the arm on; raises TooFar.

    The entry is the place that is due now. Where that is too far away, it is the latest earlier place that is not,
    so that a goal that took long to arrive is carried out late instead of with a jump. While the arm moves, the
    control process checks the distance itself at the time of entry.
    """
    if plan.approach:
        return plan
    if present.standing:
        plan = _entered_near(plan, arm, present)
    first = max(int(np.searchsorted(plan.times_ns, plan.entry_ns, side="right")) - 1, 0)
    return replace(plan, times_ns=plan.times_ns[first:], orders=plan.orders[first:], joints=plan.joints[first:])


def _entered_near(plan: GoalPlan, arm: ArmConfig, present: Present) -> GoalPlan:
    path = PlannedPath(plan)
    commanded, limit = present.commanded[path.mask, 0], arm.limits.start_tolerance_rad

    def distances(times_ns: np.ndarray) -> np.ndarray:
        away: np.ndarray = np.abs(path.at(times_ns)[0] - commanded)
        return away

    due = distances(np.array([plan.entry_ns]))[0]
    if due.max() <= limit * (ENTER_WITHIN if plan.entry_ns > plan.times_ns[0] else 1.0):
        return plan
    earliest_ns = max(int(plan.times_ns[0]), plan.entry_ns - round(LOOK_BACK_S * NS))
    for first in range(plan.entry_ns, earliest_ns - 1, -ENTRIES_A_CHUNK * arm.control.period_ns):
        times_ns = first - arm.control.period_ns * np.arange(ENTRIES_A_CHUNK)
        times_ns = np.unique(np.maximum(times_ns, earliest_ns))
        near = np.flatnonzero(distances(times_ns).max(axis=1) <= limit * ENTER_WITHIN)
        if len(near):
            entry_ns = int(times_ns[near[-1]])
            return replace(plan, entry_ns=entry_ns, start_ns=present.monotonic_ns - entry_ns or 1)
    worst = int(due.argmax())
    joint = int(np.flatnonzero(path.mask)[worst])
    place = "The first point"
    if plan.entry_ns > plan.times_ns[0]:
        place = f"The trajectory, by now {plan.entry_ns / NS:.3f} s after its start and nowhere nearer before,"
    planned = float(path.at(np.array([plan.entry_ns]))[0][0, worst])
    raise TooFar(place, arm.joints[joint].name, float(due[worst]), limit, planned)


def _complete(
    given: Points, columns: np.ndarray, arm: ArmConfig, present: Present, entry: Entry, *, smooth: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fill in what the points lack and put the columns into the arm's order; returns times, orders and waypoints.

    `smooth`: join the points by curves, even if the arm file says `interpolation: linear`.
    """
    times_ns, positions = given.times_ns, given.positions
    if Entry.APPROACH in entry and Entry.STREAM not in entry:
        waypoints_s = np.concatenate([[0.0], times_ns / NS])
        derived = slopes.monotone(waypoints_s, np.vstack([present.commanded[columns, 0], positions]))[1:]
    else:
        derived = slopes.monotone(times_ns / NS, positions)
    velocities = np.where(given.has_velocities[:, np.newaxis], given.velocities, derived)
    accelerations = np.where(given.has_accelerations[:, np.newaxis], given.accelerations, 0.0)
    orders = np.where(given.has_accelerations, 5, 3)
    orders[1:] = np.where(given.has_accelerations[1:] & given.has_accelerations[:-1], 5, 3)
    if Entry.STREAM in entry:
        orders[0] = 3  # not a quintic, which would swing out on the way there to end with the point's acceleration

    waypoints = np.stack([positions, velocities, accelerations], axis=2)
    if arm.trajectory.interpolation == "linear" and Entry.STREAM not in entry and not smooth:
        times_ns, waypoints = densify(times_ns, waypoints, arm.trajectory.interpolation_factor)
        orders = np.ones(len(times_ns), dtype=int)
    joints = np.zeros((len(times_ns), len(arm.joints), 3))
    joints[:, :, 0] = present.commanded[:, 0]
    joints[:, columns] = waypoints
    return times_ns, orders, joints


def densify(times_ns: np.ndarray, waypoints: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Put `factor` linear points between each two waypoints, as the arm's tutorial does: n become n + factor (n - 1).

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
    dense = waypoints[index] + share[:, np.newaxis, np.newaxis] * (waypoints[after] - waypoints[index])
    dense[:, :, 2] = 0.0
    keep = np.concatenate([[True], np.diff(times) > 0])  # a gap of a few ns has no room for all of them
    return times[keep], dense[keep]
