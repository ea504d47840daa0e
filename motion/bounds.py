"""How far a trajectory goes between its knots: hulls, exact extremes, and samples at the cycle rate.

Segments are the coefficients of `motion.segment`, stacked along the first axis: (6, …), with durations that
broadcast against the rest. A hull is cheap and never too narrow, so it decides most segments; the exact
extremes decide the others. Vectorised numpy; units: rad, rad/s, rad/s², s.
"""

from math import comb

import numpy as np

BISECTIONS = 60  # halvings of [0, 1]: below the spacing of doubles near 1
_BERNSTEIN = [
    np.array([[comb(i, j) / comb(degree, j) for j in range(degree + 1)] for i in range(degree + 1)])
    for degree in range(6)
]
"""For each degree: what turns coefficients on [0, 1] into those of the Bernstein basis."""


def derivative(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients, one fewer, of the time derivative of polynomials stacked along the first axis."""
    powers = np.arange(1, len(coefficients), dtype=float).reshape(-1, *[1] * (coefficients.ndim - 1))
    lowered: np.ndarray = coefficients[1:] * powers
    return lowered


def _on_unit_interval(coefficients: np.ndarray, duration_s: np.ndarray) -> np.ndarray:
    """The same polynomials in u = t / duration, so that their domain is [0, 1]."""
    powers = np.arange(len(coefficients)).reshape(-1, *[1] * (coefficients.ndim - 1))
    scaled: np.ndarray = coefficients * np.power(np.asarray(duration_s, dtype=float)[np.newaxis], powers)
    return scaled


def hull(coefficients: np.ndarray, duration_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An interval sure to contain every value on [0, duration]: extremes of the Bernstein coefficients."""
    unit = _on_unit_interval(coefficients, duration_s)
    control = np.tensordot(_BERNSTEIN[len(unit) - 1], unit, axes=1)
    return control.min(axis=0), control.max(axis=0)


def value(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Polynomials stacked along the first axis at times t (Horner's rule)."""
    result = np.zeros(np.broadcast_shapes(coefficients.shape[1:], np.shape(t)))
    for coefficient in coefficients[::-1]:
        result = result * t + coefficient
    return result


def _turning_points(unit: np.ndarray) -> np.ndarray:
    """Points of [0, 1], rising along the first axis, between which the polynomials are monotone.

    A polynomial is monotone between the zeros of its derivative, and each of those lies in an interval in
    which the derivative is monotone itself: so down to the linear one, and up again by bisection. Where an
    interval holds no zero its upper end is returned, which does no harm.
    """
    ends = np.zeros((2, *unit.shape[1:]))
    ends[1] = 1.0
    if len(unit) <= 2:
        return ends
    slope = derivative(unit)
    between = _turning_points(slope)
    low, high = between[:-1], between[1:]
    at_low = value(slope[:, np.newaxis], low)
    crosses = at_low * value(slope[:, np.newaxis], high) < 0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        left = at_low * value(slope[:, np.newaxis], middle) > 0
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    zeros = np.where(crosses, low, between[1:])
    return np.concatenate([ends[:1], zeros, ends[1:]])


def extremes(coefficients: np.ndarray, duration_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Exact lowest value and its time, highest value and its time, of every polynomial on [0, duration]."""
    duration_s = np.broadcast_to(np.asarray(duration_s, dtype=float), coefficients.shape[1:])
    unit = _on_unit_interval(coefficients, duration_s)
    candidates = _turning_points(unit)
    values = value(unit[:, np.newaxis], candidates)
    lowest, highest = values.argmin(axis=0)[np.newaxis], values.argmax(axis=0)[np.newaxis]
    return (
        np.take_along_axis(values, lowest, axis=0)[0],
        np.take_along_axis(candidates, lowest, axis=0)[0] * duration_s,
        np.take_along_axis(values, highest, axis=0)[0],
        np.take_along_axis(candidates, highest, axis=0)[0] * duration_s,
    )


def cycle_differences(
    positions_rad: np.ndarray, velocities_rad_s: np.ndarray, period_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration as a drive that is told a setpoint a cycle gets to see them.

    From samples at consecutive cycles, (n, joints): the larger in magnitude of the planned velocity and the
    change of position a cycle (first row: the planned one); the larger of the change of velocity and the
    second difference of position a cycle (n - 2 rows, centred on rows 1 … n - 2).
    """
    steps = np.abs(np.diff(positions_rad, axis=0)) / period_s
    velocity = np.abs(velocities_rad_s)
    velocity[1:] = np.maximum(velocity[1:], steps)
    bend = np.abs(np.diff(positions_rad, n=2, axis=0)) / (period_s * period_s)
    change = np.abs(np.diff(velocities_rad_s, axis=0)) / period_s
    return velocity, np.maximum(bend, np.maximum(change[:-1], change[1:]))
