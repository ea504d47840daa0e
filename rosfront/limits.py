"""Checks a plan against the limits of its joints, along the whole path and not only at its points."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from config.schema import ArmConfig
from motion import bounds, stopping
from motion import limits as motion_limits
from rosfront.path import PlannedPath
from rosfront.plan import NS, REST_RAD_S, GoalPlan
from rosfront.refusals import AccelerationBeyondLimit, PositionBeyondLimit, VelocityBeyondLimit

SEGMENTS_A_CHUNK = 8192  # bounds the memory of a check, whatever the number of points
ROUNDING = 1.0 + motion_limits.ROUNDING_AHEAD
ROUGHEST = 8.0
"""A plan whose velocity changes within a cycle by more than so many times what is allowed is refused at once."""
MOST_LOOKS = 1_000_000  # number of segments examined; bounds the time of a check, whatever the points
HALVINGS = 8
"""An interval is halved so often at most. Where a velocity changes r times too much within a cycle, the check is then
stricter than the limit by at most (r - 1) / 256 of it."""


@dataclass(frozen=True)
class _Limits:
    """Limits of the goal's joints, those of velocity and acceleration with or without margins; arrays (joints,)."""

    names: list[str]
    lower: np.ndarray
    upper: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    """`lower` and `upper` are the arm file's; `lowest` and `highest` allow for rounding (`motion.limits.band`)."""
    velocity: np.ndarray
    acceleration: np.ndarray
    period_ns: int


def _limits_of(arm: ArmConfig, mask: np.ndarray, *, margins: bool) -> _Limits:
    """`margins`: whether the margins of velocity and acceleration apply."""
    joints = [joint for joint, chosen in zip(arm.joints, mask, strict=True) if chosen]
    velocity_margin, acceleration_margin = arm.limits.velocity_margin, arm.limits.acceleration_margin
    lower = np.array([joint.lower_rad for joint in joints])
    upper = np.array([joint.upper_rad for joint in joints])
    lowest, highest = motion_limits.band(lower, upper, np.array([joint.slack_rad for joint in joints]))
    return _Limits(
        names=[joint.name for joint in joints],
        lower=lower,
        upper=upper,
        lowest=lowest,
        highest=highest,
        velocity=np.array([joint.max_velocity_rad_s for joint in joints]) * (velocity_margin if margins else 1.0),
        acceleration=np.array([joint.max_acceleration_rad_s2 for joint in joints])
        * (acceleration_margin if margins else 1.0),
        period_ns=arm.control.period_ns,
    )


def check_positions(plan: GoalPlan, arm: ArmConfig) -> None:
    """Check the positions of the points only; raises PositionBeyondLimit for the first that is outside."""
    path = PlannedPath(plan)
    limits = _limits_of(arm, path.mask, margins=True)
    unlimited = np.full(len(limits.names), np.inf)
    _check_points(path, replace(limits, velocity=unlimited, acceleration=unlimited))


def check_limits(plan: GoalPlan, arm: ArmConfig, *, margins: bool = True) -> None:
    """Check position, velocity and acceleration of every joint of the goal, at the points and between them.

    `margins`: whether the margins of the arm file apply, or the joints' limits themselves. Raises PositionBeyondLimit,
    VelocityBeyondLimit or AccelerationBeyondLimit for the first violation found.
    """
    path = PlannedPath(plan)
    limits = _limits_of(arm, path.mask, margins=margins)
    _check_points(path, limits)
    if plan.stream:
        _check_line_beyond(path, limits)
    fast, bent = np.zeros(path.segments, dtype=bool), path.orders == 1
    for first in range(0, path.segments, SEGMENTS_A_CHUNK):
        index = np.arange(first, min(first + SEGMENTS_A_CHUNK, path.segments))
        coefficients, duration = path.coefficients(index)
        _check_positions(path, limits, index, coefficients, duration)
        velocity = bounds.derivative(coefficients)
        fast[index] |= _exceeds(velocity, duration, limits.velocity)
        bent[index] |= _exceeds(bounds.derivative(velocity), duration, limits.acceleration)
    if fast.any():
        _check_velocities(path, limits, _Cycles(path, limits.period_ns, fast, stream=plan.stream))
    if bent.any():
        _check_accelerations(path, limits, _Cycles(path, limits.period_ns, bent, stream=plan.stream))


def _check_points(path: PlannedPath, limits: _Limits) -> None:
    """Check the points by the control process' rule; raises for the first that breaks a limit and its worst joint."""
    position, velocity, acceleration = path.waypoints[path.shift :].transpose(2, 0, 1)
    allowed = limits.lowest, limits.highest, limits.velocity, limits.acceleration
    broken = motion_limits.first_broken(position, velocity, acceleration, *allowed)
    points = np.flatnonzero((broken != motion_limits.NONE).any(axis=1))
    if not len(points):
        return
    point = int(points[0])
    time_ns, first = path.times_ns[path.shift + point], broken[point].min()
    beyond = np.maximum(limits.lowest - position[point], position[point] - limits.highest)
    measures = beyond, np.abs(velocity[point]) / limits.velocity, np.abs(acceleration[point]) / limits.acceleration
    joint = int(np.where(broken[point] == first, measures[first], -np.inf).argmax())
    match first:
        case motion_limits.POSITION:
            raise _position(path, limits, time_ns, joint, position[point, joint])
        case motion_limits.VELOCITY:
            raise _velocity(path, limits, time_ns, joint, velocity[point, joint])
    raise _acceleration(path, limits, time_ns, joint, acceleration[point, joint])


def _check_line_beyond(path: PlannedPath, limits: _Limits) -> None:
    """Check the velocity with which a stream goes on past its last point, once the acceleration there has faded."""
    fade_s = stopping.fade_duration_s(limits.period_ns / NS)
    _, velocity = stopping.line_beyond(*_last_point(path), fade_s)
    if broken := _first(np.abs(velocity)[np.newaxis] / limits.velocity, 1.0):
        raise _velocity(path, limits, path.times_ns[-1], broken[1], velocity[broken[1]])


def _last_point(path: PlannedPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (joints,) of the last point."""
    position, velocity, acceleration = path.waypoints[-1].T
    return position, velocity, acceleration


def _position(path: PlannedPath, limits: _Limits, time_ns: float, joint: int, value: float) -> PositionBeyondLimit:
    lower, upper = float(limits.lower[joint]), float(limits.upper[joint])
    return PositionBeyondLimit(path.place(time_ns), limits.names[joint], float(value), lower, upper)


def _velocity(path: PlannedPath, limits: _Limits, time_ns: float, joint: int, value: float) -> VelocityBeyondLimit:
    limit = float(limits.velocity[joint])
    return VelocityBeyondLimit(path.place(time_ns), limits.names[joint], abs(float(value)), limit)


def _acceleration(
    path: PlannedPath, limits: _Limits, time_ns: float, joint: int, value: float
) -> AccelerationBeyondLimit:
    limit, cycle_s = float(limits.acceleration[joint]), limits.period_ns / NS
    first, last = np.searchsorted(path.times_ns, [time_ns - limits.period_ns, time_ns + limits.period_ns])
    gaps_ns = np.diff(path.times_ns[max(first - 1, 0) : last + 1])
    gap_s = float(np.median(gaps_ns)) / NS if len(gaps_ns) else cycle_s
    return AccelerationBeyondLimit(path.place(time_ns), limits.names[joint], abs(float(value)), limit, gap_s, cycle_s)


def _first(measure: np.ndarray, allowed: float) -> tuple[int, int] | None:
    """The first row of `measure` (n, joints) with a value not at most `allowed`, and its worst column; else None."""
    inside = measure <= allowed
    if inside.all():
        return None
    rows = np.flatnonzero(~inside.all(axis=1))
    return int(rows[0]), int(np.nan_to_num(measure[rows[0]], nan=np.inf).argmax())


def _check_positions(
    path: PlannedPath, limits: _Limits, index: np.ndarray, coefficients: np.ndarray, duration: np.ndarray
) -> None:
    """Check positions on the segments `index`: hulls first, exact extremes where a hull is not enough."""
    low, high = bounds.hull(coefficients, duration)
    inside = (low >= limits.lowest) & (high <= limits.highest)
    if inside.all():
        return
    doubtful = np.flatnonzero(~inside.all(axis=1))
    lowest, lowest_s, highest, highest_s = bounds.extremes(coefficients[:, doubtful], duration[doubtful])
    below, above = limits.lowest - lowest, highest - limits.highest
    if broken := _first(np.maximum(below, above), 0.0):
        value, at_s = (highest, highest_s) if above[broken] > below[broken] else (lowest, lowest_s)
        time_ns = path.times_ns[index[doubtful[broken[0]]]] + at_s[broken] * NS
        raise _position(path, limits, time_ns, broken[1], value[broken])


def _exceeds(polynomials: np.ndarray, duration: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Which of the segments (m,) may exceed a limit (joints,), by their hulls."""
    low, high = bounds.hull(polynomials, duration)
    inside = (low >= -limit) & (high <= limit)
    return np.logical_not(inside.all(axis=1))


def _check_velocities(path: PlannedPath, limits: _Limits, cycles: "_Cycles") -> None:
    """Check velocities around some segments, as they are for a drive that gets one setpoint a cycle.

    What counts is how far the path goes within a cycle P: between any two moments at most P apart, no farther than the
    velocity limit allows in P. Then the limit holds wherever the cycles fall, at any rate of the trajectory clock up
    to 1.
    """
    allowed = limits.velocity * limits.period_ns / NS
    for _, times_ns, change in cycles.changes(cycles.position, allowed):
        if broken := _first(change / allowed, ROUNDING):
            time_ns = _within(path, times_ns[broken] + limits.period_ns / 2)
            raise _velocity(path, limits, time_ns, broken[1], change[broken] * NS / limits.period_ns)


def _check_accelerations(path: PlannedPath, limits: _Limits, cycles: "_Cycles") -> None:
    """Check accelerations around some segments, as they are for a drive that gets one setpoint a cycle.

    A residual segment of 0.4 ms at the end of a plan may have any curvature, if that changes little. What counts are
    the setpoints. P is the cycle. With the trajectory clock at a rate s, two setpoints are h = s P apart on the path,
    and the drive accelerates with D(t, h) / P², where D(t, h) = p(t + h) - 2 p(t) + p(t - h) is the second difference.
    This must keep the limit A at every t, because cycles fall anywhere, and for every h with 0 < h ≤ P, because an
    operator may set any rate up to 1 and a stop passes through all rates below. A lower rate is not safe by itself: on
    a smooth path the acceleration falls with s², but a ripple that cancels out over P need not do so over a shorter h.

    For most paths the velocity v is enough. D(t, h) is the integral of v(t + u) - v(t + u - h) over 0 ≤ u ≤ h, so
    |D| ≤ h w with the largest change w of v between two moments at most P apart, which is enough where w ≤ A P.

    Noise of points that are close together makes w large but averages out in D. Where w exceeds A P, D itself is
    checked: for h from A P² / w on (shorter ones are safe by the same estimate), and at any t between two moments
    whose velocities differ too much (no other D can exceed the limit). For one h the extremes over t are exact. With
    h, D changes by at most |∂D/∂h| = |v(t + h) - v(t - h)| ≤ 2 w. So the value in the middle of an interval of h
    decides the interval, or it is halved. Full speed is checked first, because a refusal names it. Whether a blend onto
    the path, or a change of the rate, keeps the limits is checked where it is chosen, in the control process.
    """
    period_ns, period_s = limits.period_ns, limits.period_ns / NS
    allowed = limits.acceleration * period_s
    widest, rough = np.zeros_like(allowed), cycles.nowhere()
    for ends, times_ns, change in cycles.changes(cycles.velocity, allowed):
        if broken := _first(change / allowed, ROUGHEST):
            raise _acceleration(path, limits, _within(path, times_ns[broken]), broken[1], change[broken] / period_s)
        widest = np.maximum(widest, change.max(axis=0, initial=0.0))
        rough |= cycles.between(ends[:, ~(change <= allowed * ROUNDING).all(axis=1)])
    if not rough.any():
        return
    roughness = float((widest / allowed).max())
    columns = np.flatnonzero(~(widest <= allowed))
    widest, allowed = widest[columns], allowed[columns] * period_s
    intervals = [(period_ns, period_ns, rough), (round(period_ns / roughness), period_ns, rough)]
    looks = 0
    for halvings in range(1 + HALVINGS):
        undecided = []
        for shortest_ns, longest_ns, where in intervals:
            middle_ns = (shortest_ns + longest_ns) // 2
            astray = widest * ((longest_ns - shortest_ns) / NS)
            doubtful = cycles.nowhere()
            looks += int(where.sum())
            added = astray if halvings == HALVINGS or looks > MOST_LOOKS else 0.0
            for segments, times_ns, bend in cycles.bends(middle_ns, where, columns, allowed - added):
                if broken := _first((bend + added) / allowed, ROUNDING):
                    time_ns, value = _within(path, times_ns[broken]), (bend + added)[broken] / period_s**2
                    raise _acceleration(path, limits, time_ns, int(columns[broken[1]]), value)
                doubtful[segments[~(bend + astray <= allowed * ROUNDING).all(axis=1)]] = True
            if doubtful.any():
                undecided += [(shortest_ns, middle_ns, doubtful), (middle_ns, longest_ns, doubtful)]
        intervals = undecided


def _within(path: PlannedPath, time_ns: float) -> float:
    """A time (ns), clipped to the duration of the path."""
    return float(min(max(time_ns, path.times_ns[0]), path.times_ns[-1]))


class _Cycles:
    """How a path and its velocity change within a cycle, around some of its segments.

    Before its first point the path is extended by a straight line, since the control process makes the way there.
    After its last point the acceleration of a stream fades (`motion.segment.fade`). A goal is at rest there. If a goal
    ends in motion, the control process brings the clock to rest at its end. Nothing behind counts then, so the path is
    extended by a straight line.
    """

    def __init__(self, path: PlannedPath, period_ns: int, around: np.ndarray, *, stream: bool) -> None:
        self._path, self._period_ns = path, period_ns
        position, velocity, acceleration = _last_point(path)
        self._behind = np.zeros((6, len(position)))
        self._behind[0] = position
        if stream or (np.abs(velocity) > REST_RAD_S).any():
            self._behind[1] = velocity
        if stream:
            fade_s = stopping.fade_duration_s(period_ns / NS)
            for power, share in ((2, 0.5), (3, -1.0 / (3.0 * fade_s)), (4, 1.0 / (12.0 * fade_s * fade_s))):
                self._behind[power] = share * acceleration
        times_ns = path.times_ns
        self._times_ns = np.concatenate([[times_ns[0] - 2 * period_ns], times_ns, [times_ns[-1] + 2 * period_ns]])
        self._near = self._widened(np.concatenate([[False], around, [False]]), period_ns)

    def nowhere(self) -> np.ndarray:
        """A mask that selects no segment; the first segment is the one before the path, the last the one behind it."""
        return np.zeros(len(self._times_ns) - 1, dtype=bool)

    def between(self, ends: np.ndarray) -> np.ndarray:
        """A mask of the segments from `ends[0]` to `ends[1]`, both included, for n pairs (2, n)."""
        nesting = np.zeros(len(self._times_ns), dtype=int)
        np.add.at(nesting, ends[0], 1)
        np.add.at(nesting, ends[1] + 1, -1)
        return np.cumsum(nesting)[:-1] > 0

    def _segment(self, times_ns: np.ndarray) -> np.ndarray:
        """Indices of the segments in which some times (ns) lie."""
        return np.clip(np.searchsorted(self._times_ns, times_ns, side="right") - 1, 0, len(self._times_ns) - 2)

    def _widened(self, chosen: np.ndarray, by_ns: int) -> np.ndarray:
        """A mask of the chosen segments and those less than `by_ns` away."""
        index = np.flatnonzero(chosen)
        first = self._segment(self._times_ns[index] - by_ns)
        last = self._segment(self._times_ns[index + 1] + by_ns - 1)
        return self.between(np.stack([first, last]))

    def position(self, index: np.ndarray) -> np.ndarray:
        """Coefficients (6, m, joints) of the positions on the segments `index` (m,)."""
        path = self._path
        coefficients, _ = path.coefficients(np.clip(index - 1, 0, path.segments - 1))
        before, after = index == 0, index == path.segments + 1
        position, velocity = path.waypoints[0, :, 0], path.waypoints[0, :, 1]
        coefficients[:, before] = 0.0
        coefficients[0, before] = position - velocity * (2 * self._period_ns / NS)
        coefficients[1, before] = velocity
        coefficients[:, after] = self._behind[:, np.newaxis]
        return coefficients

    def velocity(self, index: np.ndarray) -> np.ndarray:
        """Coefficients (5, m, joints) of the velocities on the segments `index` (m,)."""
        return bounds.derivative(self.position(index))

    def changes(self, curve: "_Curve", allowed: np.ndarray) -> Iterator["_Findings"]:
        """The largest changes of a curve between two moments at most a cycle apart.

        Yields the segments (2, m) of both moments, the earlier moments (ns) and the changes. Either the two moments are
        a cycle apart, or each of them is a turning point of the curve or a point of the trajectory.
        """
        return chain(self._whole(curve, allowed), self._shorter(curve))

    def _whole(self, curve: "_Curve", allowed: np.ndarray) -> Iterator["_Findings"]:
        """The largest changes over a whole cycle; only an upper bound of them where that bound is within `allowed`."""
        shifts = ((0, -1.0), (self._period_ns, 1.0))
        for times_ns, at_ns, change in self._combined(curve, shifts, self._near, allowed):
            yield np.stack([self._segment(times_ns), self._segment(times_ns + self._period_ns)]), at_ns, change

    def bends(
        self, apart_ns: int, where: np.ndarray, columns: np.ndarray, allowed: np.ndarray
    ) -> Iterator["_Findings"]:
        """The largest second differences of positions `apart_ns` (at most a cycle) apart, with the middle in `where`.

        Yields the segments (m,) of the middle moments, those moments (ns) and the differences, for the joints
        `columns`; only an upper bound of the differences where that bound is within `allowed`.
        """
        shifts = ((0, -2.0), (-apart_ns, 1.0), (apart_ns, 1.0))
        for times_ns, at_ns, bend in self._combined(
            lambda index: self.position(index)[:, :, columns], shifts, where, allowed
        ):
            yield self._segment(times_ns), at_ns, bend

    def _combined(
        self, curve: "_Curve", shifts: tuple[tuple[int, float], ...], where: np.ndarray, allowed: np.ndarray
    ) -> Iterator["_Findings"]:
        """Extremes of the sum of the curve at shifted times, each with its factor, for times in the segments `where`.

        The sum is a polynomial as long as none of the times passes a point. Yields the beginnings (m,) of such pieces
        (ns), and the time and size (m, joints) of the largest absolute value in each, or of an upper bound where that
        is within `allowed`.
        """
        times_ns = self._times_ns
        widest_ns = max(abs(shift_ns) for shift_ns, _ in shifts)
        concerned = self._widened(where, widest_ns)
        points_ns = times_ns[np.append(concerned, False) | np.append(False, concerned)]
        begin = np.sort(np.concatenate([points_ns - shift_ns for shift_ns, _ in shifts]), kind="stable")
        begin = begin[np.append(np.diff(begin) > 0, True)]
        begin, end = begin[:-1], begin[1:]
        lowest_ns, highest_ns = (f(shift_ns for shift_ns, _ in shifts) for f in (min, max))
        inside = (begin + lowest_ns >= times_ns[0]) & (begin + highest_ns < times_ns[-1])
        inside = np.flatnonzero(inside & where[self._segment(begin)])
        for low in range(0, len(inside), SEGMENTS_A_CHUNK):
            piece = inside[low : low + SEGMENTS_A_CHUNK]
            start = begin[piece]
            duration_s = ((end[piece] - start) / NS)[:, np.newaxis]
            at = [self._segment(start + shift_ns) for shift_ns, _ in shifts]
            segments, at_segments = np.unique(at, return_inverse=True)
            coefficients = curve(segments)
            while len(coefficients) > 1 and not coefficients[-1].any():
                coefficients = coefficients[:-1]
            parts = []
            for (shift_ns, factor), segment, chosen in zip(shifts, at, at_segments, strict=True):
                local_s = ((start + shift_ns - times_ns[segment]) / NS)[:, np.newaxis]
                parts.append(factor * bounds.shifted(coefficients[:, chosen], local_s))
            total = np.sum(parts, axis=0)
            smallest, largest = bounds.hull(total, duration_s)
            most = np.maximum(-smallest, largest)
            at_ns = np.repeat(start[:, np.newaxis], most.shape[1], axis=1).astype(float)
            doubtful = np.flatnonzero(~(most <= allowed).all(axis=1))
            if len(doubtful):
                smallest, smallest_s, largest, largest_s = bounds.extremes(total[:, doubtful], duration_s[doubtful])
                most[doubtful] = np.maximum(-smallest, largest)
                at_ns[doubtful] += np.where(largest > -smallest, largest_s, smallest_s) * NS
            yield start, at_ns, most

    def _shorter(self, curve: "_Curve") -> Iterator["_Findings"]:
        """The times (m, joints) at which the curve turns, and the range of its values within a cycle from there."""
        times_ns, near = self._times_ns, np.flatnonzero(self._near)
        for low in range(0, len(near), SEGMENTS_A_CHUNK):
            last = near[min(low + SEGMENTS_A_CHUNK, len(near)) - 1]
            high = np.searchsorted(near, np.searchsorted(times_ns, times_ns[last + 1] + self._period_ns))
            index = near[low:high]
            start_ns = times_ns[index]
            duration_s = ((times_ns[index + 1] - start_ns) / NS)[:, np.newaxis]
            times_s, values = bounds.turning_points(curve(index), duration_s)
            times_s += ((start_ns - start_ns[0]) / NS)[:, np.newaxis]
            ends = np.stack([index, self._segment(times_ns[index + 1] + self._period_ns)])
            ends = np.repeat(ends, len(times_s), axis=1)
            times_s, values = (np.swapaxes(a, 0, 1).reshape(-1, a.shape[2]) for a in (times_s, values))
            window_s = self._period_ns / NS
            ranges = [bounds.widest_range(t, v, window_s) for t, v in zip(times_s.T, values.T, strict=True)]
            yield ends, times_s * NS + start_ns[0], np.stack(ranges, axis=1)


_Curve = Callable[[np.ndarray], np.ndarray]
_Findings = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Segments or times that were examined, the times (ns) of the largest values there, and those values."""
