"""Checking a plan against the limits of its joints, along the whole way and not only at its points."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from config.schema import ArmConfig
from motion import bounds, stopping
from rosfront.path import PlannedPath
from rosfront.plan import NS, GoalPlan
from rosfront.refusals import AccelerationBeyondLimit, PositionBeyondLimit, VelocityBeyondLimit

SEGMENTS_A_CHUNK = 8192  # bounds the memory of a check, whatever the number of points
ROUNDING = 1.0 + 1e-9


@dataclass(frozen=True)
class _Limits:
    """What the joints of the goal may do, margins included; arrays (joints,)."""

    names: list[str]
    lower: np.ndarray
    upper: np.ndarray
    slack: np.ndarray
    """What rounding may put a joint that stands at its limit beyond it: a pulse and a count."""
    velocity: np.ndarray
    acceleration: np.ndarray
    period_ns: int


def check_limits(plan: GoalPlan, arm: ArmConfig) -> None:
    """Position, velocity and acceleration of every joint of the goal, at the points and between them.

    Raises PositionBeyondLimit, VelocityBeyondLimit or AccelerationBeyondLimit for the first violation found.
    """
    path = PlannedPath(plan)
    joints = [joint for joint, chosen in zip(arm.joints, path.mask, strict=True) if chosen]
    limits = _Limits(
        names=[joint.name for joint in joints],
        lower=np.array([joint.lower_rad for joint in joints]),
        upper=np.array([joint.upper_rad for joint in joints]),
        slack=np.array([joint.command_pulse_rad + joint.encoder_count_rad for joint in joints]),
        velocity=np.array([joint.max_velocity_rad_s for joint in joints]) * arm.limits.velocity_margin,
        acceleration=np.array([joint.max_acceleration_rad_s2 for joint in joints]) * arm.limits.acceleration_margin,
        period_ns=arm.control.period_ns,
    )
    _check_points(path, limits)
    if plan.stream:
        _check_line_beyond(path, limits)
    suspicious = np.zeros(path.segments, dtype=bool)
    for first in range(0, path.segments, SEGMENTS_A_CHUNK):
        index = np.arange(first, min(first + SEGMENTS_A_CHUNK, path.segments))
        coefficients, duration = path.coefficients(index)
        _check_positions(path, limits, index, coefficients, duration)
        velocity = bounds.derivative(coefficients)
        _check_velocities(path, limits, index, velocity, duration)
        low, high = bounds.hull(bounds.derivative(velocity), duration)
        suspicious[index] = ~((low >= -limits.acceleration) & (high <= limits.acceleration)).all(axis=1)
    _check_cycles(path, limits, suspicious | (path.orders == 1), stream=plan.stream)


def _check_points(path: PlannedPath, limits: _Limits) -> None:
    points = path.knots[path.shift :]
    times_ns = path.times_ns[path.shift :]
    position, velocity, acceleration = np.moveaxis(points, 2, 0)
    if broken := _first(np.maximum(limits.lower - position, position - limits.upper) / limits.slack, 1.0):
        point, joint = broken
        raise _position(path, limits, times_ns[point], joint, position[point, joint])
    if broken := _first(np.abs(velocity) / limits.velocity, 1.0):
        point, joint = broken
        raise _velocity(path, limits, times_ns[point], joint, velocity[point, joint])
    if broken := _first(np.abs(acceleration) / limits.acceleration, 1.0):
        point, joint = broken
        raise _acceleration(path, limits, times_ns[point], joint, acceleration[point, joint])


def _check_line_beyond(path: PlannedPath, limits: _Limits) -> None:
    """The velocity with which a stream runs on past its last point, once the acceleration there has faded."""
    fade_s = stopping.fade_duration_s(limits.period_ns / NS)
    _, velocity = stopping.line_beyond(*_last_point(path), fade_s)
    if broken := _first(np.abs(velocity)[np.newaxis] / limits.velocity, 1.0):
        raise _velocity(path, limits, path.times_ns[-1], broken[1], velocity[broken[1]])


def _last_point(path: PlannedPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (joints,) of the last point."""
    position, velocity, acceleration = np.moveaxis(path.knots[-1], 1, 0)
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
    limit = float(limits.acceleration[joint])
    return AccelerationBeyondLimit(path.place(time_ns), limits.names[joint], abs(float(value)), limit)


def _first(measure: np.ndarray, allowed: float) -> tuple[int, int] | None:
    """The first row in which `measure` (n, joints) is not at most `allowed`, and in it the worst column."""
    rows = np.flatnonzero(~(measure <= allowed).all(axis=1))
    if not len(rows):
        return None
    return int(rows[0]), int(np.nan_to_num(measure[rows[0]], nan=np.inf).argmax())


def _check_positions(
    path: PlannedPath, limits: _Limits, index: np.ndarray, coefficients: np.ndarray, duration: np.ndarray
) -> None:
    """Positions of the segments `index`: hulls first, exact extremes where a hull is not enough."""
    low, high = bounds.hull(coefficients, duration)
    doubtful = np.flatnonzero(
        ~((low >= limits.lower - limits.slack) & (high <= limits.upper + limits.slack)).all(axis=1)
    )
    if not len(doubtful):
        return
    lowest, lowest_s, highest, highest_s = bounds.extremes(coefficients[:, doubtful], duration[doubtful])
    below, above = limits.lower - lowest, highest - limits.upper
    if broken := _first(np.maximum(below, above) / limits.slack, 1.0):
        value, at_s = (highest, highest_s) if above[broken] > below[broken] else (lowest, lowest_s)
        time_ns = path.times_ns[index[doubtful[broken[0]]]] + at_s[broken] * NS
        raise _position(path, limits, time_ns, broken[1], value[broken])


def _check_velocities(
    path: PlannedPath, limits: _Limits, index: np.ndarray, velocity: np.ndarray, duration: np.ndarray
) -> None:
    """Velocities of the segments `index`, in the same way."""
    low, high = bounds.hull(velocity, duration)
    doubtful = np.flatnonzero(~((low >= -limits.velocity) & (high <= limits.velocity)).all(axis=1))
    if not len(doubtful):
        return
    lowest, lowest_s, highest, highest_s = bounds.extremes(velocity[:, doubtful], duration[doubtful])
    if broken := _first(np.maximum(-lowest, highest) / limits.velocity, ROUNDING):
        above = highest[broken] > -lowest[broken]
        value, at_s = (highest, highest_s) if above else (lowest, lowest_s)
        time_ns = path.times_ns[index[doubtful[broken[0]]]] + at_s[broken] * NS
        raise _velocity(path, limits, time_ns, broken[1], value[broken])


def _check_cycles(path: PlannedPath, limits: _Limits, suspicious: np.ndarray, *, stream: bool) -> None:
    """Accelerations around the suspicious segments, as an arm has them that is told one setpoint a cycle.

    A residual segment of 0.4 ms at the end of a plan may bend as it likes, if that changes little. What counts is how
    much the velocity v changes within a cycle P: for any two moments at most P apart the change must not exceed what
    the acceleration limit A makes in P. Where the cycles fall on the trajectory does not matter then: three setpoints
    that are h ≤ P of the trajectory apart have the second difference ∫ v(t + u) - v(t + u - h) du over 0 ≤ u ≤ h,
    which is at most h · A P, so it is at most A P², at any phase and at any rate of the trajectory clock up to 1. And
    the velocity of any moment, from which a newer trajectory goes on, differs by no more than A P from the mean of
    the cycle before.

    The largest change is found exactly. Of the two moments either each is a turning point of v (or a point of the
    trajectory), or they are P apart and v(t + P) - v(t) is at an extreme, which is a polynomial in t as long as
    neither moment passes a point. Segments that are not suspicious have no part in it unless one that is lies within
    a cycle: their acceleration is below the limit everywhere.
    """
    if not suspicious.any():
        return
    cycles = _Cycles(path, limits.period_ns, suspicious, stream=stream)
    allowed = limits.acceleration * limits.period_ns / NS
    for times_ns, change in chain(cycles.whole(allowed), cycles.shorter()):
        if broken := _first(change / allowed, ROUNDING):
            time_ns = min(max(times_ns[broken], path.times_ns[0]), path.times_ns[-1])
            raise _acceleration(path, limits, time_ns, broken[1], change[broken] * NS / limits.period_ns)


class _Cycles:
    """The velocity of a path and how it changes within a cycle, around some of its segments.

    Before its first point the path goes in a straight line, since the way there is the control process' matter; after
    the last one a goal is at rest, and the acceleration of a stream fades (`motion.segment.fade`).
    """

    def __init__(self, path: PlannedPath, period_ns: int, around: np.ndarray, *, stream: bool) -> None:
        self._path, self._period_ns = path, period_ns
        self._behind = np.zeros((5, path.knots.shape[1]))
        if stream:
            _, velocity, acceleration = _last_point(path)
            fade_s = stopping.fade_duration_s(period_ns / NS)
            self._behind[:2] = velocity, acceleration
            self._behind[2:4] = -acceleration / fade_s, acceleration / (3.0 * fade_s * fade_s)
        times_ns = path.times_ns
        self._times_ns = np.concatenate([[times_ns[0] - 2 * period_ns], times_ns, [times_ns[-1] + 2 * period_ns]])
        chosen = np.flatnonzero(around)
        first = np.searchsorted(self._times_ns, times_ns[chosen] - period_ns, side="right") - 1
        last = np.searchsorted(self._times_ns, times_ns[chosen + 1] + period_ns, side="left")
        nesting = np.zeros(len(self._times_ns), dtype=int)
        np.add.at(nesting, first, 1)
        np.add.at(nesting, last, -1)
        self._near = np.cumsum(nesting)[:-1] > 0

    def _velocity(self, index: np.ndarray) -> np.ndarray:
        """Coefficients (5, m, joints) of the velocity on the segments `index` (m,), 0 and the last those outside."""
        path = self._path
        coefficients, _ = path.coefficients(np.clip(index - 1, 0, path.segments - 1))
        velocity = bounds.derivative(coefficients)
        before, after = index == 0, index == path.segments + 1
        velocity[:, before] = 0.0
        velocity[0, before] = path.knots[0, :, 1]
        velocity[:, after] = self._behind[:, np.newaxis]
        return velocity

    def whole(self, allowed: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Moments (m, joints) and the changes of velocity in the whole cycle from there.

        The largest change between two moments; no more than a bound on it where that is allowed.
        """
        times_ns, period_ns = self._times_ns, self._period_ns
        begin = np.unique(np.concatenate([times_ns, times_ns - period_ns]))
        begin, end = begin[:-1], begin[1:]
        here, there = (np.searchsorted(times_ns, at, side="right") - 1 for at in (begin, begin + period_ns))
        inside = np.flatnonzero((here >= 0) & (there < len(self._near)))
        inside = inside[self._near[here[inside]] & self._near[there[inside]]]
        for low in range(0, len(inside), SEGMENTS_A_CHUNK):
            piece = inside[low : low + SEGMENTS_A_CHUNK]
            first, second = here[piece], there[piece]
            duration_s = ((end[piece] - begin[piece]) / NS)[:, np.newaxis]
            first_s = ((begin[piece] - times_ns[first]) / NS)[:, np.newaxis]
            second_s = ((begin[piece] + period_ns - times_ns[second]) / NS)[:, np.newaxis]
            change = bounds.shifted(self._velocity(second), second_s) - bounds.shifted(self._velocity(first), first_s)
            smallest, largest = bounds.hull(change, duration_s)
            most = np.maximum(-smallest, largest)
            at_ns = np.repeat(begin[piece, np.newaxis], most.shape[1], axis=1).astype(float)
            doubtful = np.flatnonzero(~(most <= allowed).all(axis=1))
            if len(doubtful):
                smallest, smallest_s, largest, largest_s = bounds.extremes(change[:, doubtful], duration_s[doubtful])
                most[doubtful] = np.maximum(-smallest, largest)
                at_ns[doubtful] += np.where(largest > -smallest, largest_s, smallest_s) * NS
            yield at_ns, most

    def shorter(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Moments (m, joints) at which a velocity turns, and the range of it within a cycle from there."""
        times_ns, near = self._times_ns, np.flatnonzero(self._near)
        for low in range(0, len(near), SEGMENTS_A_CHUNK):
            last = near[min(low + SEGMENTS_A_CHUNK, len(near)) - 1]
            high = np.searchsorted(near, np.searchsorted(times_ns, times_ns[last + 1] + self._period_ns))
            index = near[low:high]
            start_ns = times_ns[index]
            duration_s = ((times_ns[index + 1] - start_ns) / NS)[:, np.newaxis]
            times_s, velocity = bounds.turning_points(self._velocity(index), duration_s)
            times_s += ((start_ns - start_ns[0]) / NS)[:, np.newaxis]
            times_s, velocity = (np.swapaxes(a, 0, 1).reshape(-1, a.shape[2]) for a in (times_s, velocity))
            window_s = self._period_ns / NS
            ranges = [bounds.widest_range(t, v, window_s) for t, v in zip(times_s.T, velocity.T, strict=True)]
            yield times_s * NS + start_ns[0], np.stack(ranges, axis=1)
