"""Checking a plan against the limits of its joints, along the whole way and not only at its points."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from config.schema import ArmConfig
from motion import bounds
from rosfront.path import PlannedPath
from rosfront.plan import NS, GoalPlan
from rosfront.refusals import AccelerationBeyondLimit, PositionBeyondLimit, VelocityBeyondLimit

LONG_SEGMENT_CYCLES = 64  # beyond, the exact extremes of a segment say the same as its samples
SEGMENTS_A_CHUNK = 8192  # bounds the memory of a check, whatever the number of points
SAMPLES_A_CHUNK = 16384


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
    suspicious = np.zeros(path.segments, dtype=bool)
    for first in range(0, path.segments, SEGMENTS_A_CHUNK):
        index = np.arange(first, min(first + SEGMENTS_A_CHUNK, path.segments))
        coefficients, duration = path.coefficients(index)
        _check_positions(path, limits, index, coefficients, duration)
        suspicious[index] = _check_derivatives(path, limits, index, coefficients, duration)
    _check_samples(path, limits, suspicious)


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


def _check_derivatives(
    path: PlannedPath, limits: _Limits, index: np.ndarray, coefficients: np.ndarray, duration: np.ndarray
) -> np.ndarray:
    """Which of the segments `index` must be sampled; long ones are judged here, by their exact extremes."""
    first = bounds.derivative(coefficients)
    second = bounds.derivative(first)
    kinds = ((first, limits.velocity, _velocity), (second, limits.acceleration, _acceleration))
    suspicious = np.zeros(len(index), dtype=bool)
    for polynomial, limit, _ in kinds:
        low, high = bounds.hull(polynomial, duration)
        suspicious |= ~((low >= -limit) & (high <= limit)).all(axis=1)
    long = np.flatnonzero(suspicious & (duration[:, 0] * NS > LONG_SEGMENT_CYCLES * limits.period_ns))
    if len(long):
        for polynomial, limit, refusal in kinds:
            lowest, lowest_s, highest, highest_s = bounds.extremes(polynomial[:, long], duration[long])
            if broken := _first(np.maximum(-lowest, highest) / limit, 1.0):
                above = highest[broken] > -lowest[broken]
                value, at_s = (highest, highest_s) if above else (lowest, lowest_s)
                time_ns = path.times_ns[index[long[broken[0]]]] + at_s[broken] * NS
                raise refusal(path, limits, time_ns, broken[1], value[broken])
        suspicious[long] = False
    return suspicious


def _check_samples(path: PlannedPath, limits: _Limits, suspicious: np.ndarray) -> None:
    """Judge what a drive sees that is told one setpoint a cycle, around the segments in question."""
    for cycles in _cycles_around(path, suspicious, limits.period_ns):
        times_ns = cycles * limits.period_ns
        position, speed, _ = path.at(times_ns)
        velocity, acceleration = bounds.cycle_differences(position, speed, limits.period_ns / NS)
        if broken := _first(velocity / limits.velocity, 1.0):
            raise _velocity(path, limits, times_ns[broken[0]], broken[1], velocity[broken])
        if broken := _first(acceleration / limits.acceleration, 1.0):
            raise _acceleration(path, limits, times_ns[broken[0] + 1], broken[1], acceleration[broken])


def _cycles_around(path: PlannedPath, suspicious: np.ndarray, period_ns: int) -> Iterator[np.ndarray]:
    """Runs of cycle numbers, two cycles wider on either side, in bounded pieces: the suspicious segments, and
    both ends of straight ones, which meet in corners that no segment shows by itself."""
    segments, straight = np.flatnonzero(suspicious), np.flatnonzero(path.orders == 1)
    first = np.concatenate([segments, straight, straight + 1])
    last = np.concatenate([segments + 1, straight, straight + 1])
    ranking = np.argsort(first, kind="stable")
    begin = np.maximum(path.times_ns[first[ranking]] // period_ns - 2, 0)
    end = -(-path.times_ns[last[ranking]] // period_ns) + 2
    run_first = run_last = -1
    for low, high in zip(begin.tolist(), end.tolist(), strict=True):
        if run_first >= 0 and low <= run_last:
            run_last = max(run_last, high)
        else:
            yield from _pieces(run_first, run_last)
            run_first, run_last = low, high
    yield from _pieces(run_first, run_last)


def _pieces(first: int, last: int) -> Iterator[np.ndarray]:
    while 0 <= first <= last:
        stop = min(first + SAMPLES_A_CHUNK, last)
        yield np.arange(first, stop + 1)
        if stop == last:
            return
        first = stop - 2  # so that no second difference is missed at the seam
