"""How far a trajectory goes between waypoints: hulls, exact extremes, and how much it changes within a window of time.

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
    control = (_BERNSTEIN[len(unit) - 1] @ unit.reshape(len(unit), -1)).reshape(unit.shape)
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
    while len(unit) > 2 and not unit[-1].any():
        unit = unit[:-1]
    ends = np.zeros((2, *unit.shape[1:]))
    ends[1] = 1.0
    if len(unit) <= 2:
        return ends
    slope = derivative(unit)
    if len(slope) == 2:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            zero = -slope[0] / slope[1]
        return np.stack([ends[0], np.where((zero > 0.0) & (zero < 1.0), zero, 1.0), ends[1]])
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
    times_s, values = turning_points(coefficients, duration_s)
    lowest, highest = values.argmin(axis=0)[np.newaxis], values.argmax(axis=0)[np.newaxis]
    return (
        np.take_along_axis(values, lowest, axis=0)[0],
        np.take_along_axis(times_s, lowest, axis=0)[0],
        np.take_along_axis(values, highest, axis=0)[0],
        np.take_along_axis(times_s, highest, axis=0)[0],
    )


def turning_points(coefficients: np.ndarray, duration_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times on [0, duration], rising along the first axis, and the values there: all the local extremes, both ends."""
    duration_s = np.broadcast_to(np.asarray(duration_s, dtype=float), coefficients.shape[1:])
    unit = _on_unit_interval(coefficients, duration_s)
    candidates = _turning_points(unit)
    return candidates * duration_s, value(unit[:, np.newaxis], candidates)


def shifted(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Coefficients of p(t + u) in u: the same polynomials with their time counted from t on (Taylor's expansion)."""
    result = np.array(coefficients, dtype=float)
    for done in range(len(result) - 1):
        for power in range(len(result) - 2, done - 1, -1):
            result[power] += t * result[power + 1]
    return result


def widest_range(times: np.ndarray, values: np.ndarray, window: float) -> np.ndarray:
    """Largest minus smallest of the values (n,) whose times lie in [t, t + window], for every t of the times (n,).

    The times rise. Ranges over 2, 4, 8 … neighbours are made of those over half as many, and two of them, which may
    overlap, make up any window: n log n operations.
    """
    first = np.arange(len(times))
    count = np.searchsorted(times, times + window, side="right") - first
    ranges = np.zeros(len(times))
    highest, lowest, width = values, values, 1
    while len(highest):
        chosen = np.flatnonzero((count >= width) & (count < 2 * width))
        second = first[chosen] + count[chosen] - width
        ranges[chosen] = np.maximum(highest[chosen], highest[second]) - np.minimum(lowest[chosen], lowest[second])
        if (count < 2 * width).all():
            break
        highest, lowest = np.maximum(highest[:-width], highest[width:]), np.minimum(lowest[:-width], lowest[width:])
        width *= 2
    return ranges
