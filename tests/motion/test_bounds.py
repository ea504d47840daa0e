"""Hulls and extremes of polynomial segments, against numpy's roots and dense sampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.interpolate import BPoly

from motion import bounds, segment

coefficient = st.floats(-50.0, 50.0).map(lambda x: round(x, 4))
polynomials = st.lists(coefficient, min_size=2, max_size=6)
durations = st.floats(1e-3, 5.0)


def stacked(coefficients) -> np.ndarray:
    return np.array(coefficients, dtype=float)[:, np.newaxis]


@settings(deadline=None)
@given(polynomials, durations)
def test_extremes_are_those_found_from_the_roots_of_the_derivative(coefficients, duration):
    polynomial = Polynomial(coefficients)
    roots = polynomial.deriv().roots() if len(coefficients) > 2 else np.array([])
    turning = [r.real for r in roots if abs(r.imag) < 1e-6 and 0.0 <= r.real <= duration]
    values = polynomial(np.array([0.0, duration, *turning]))
    low, low_at, high, high_at = (float(x[0]) for x in bounds.extremes(stacked(coefficients), np.array([duration])))
    scale = 1.0 + np.abs(Polynomial(np.abs(coefficients))(duration))
    assert low == pytest.approx(values.min(), abs=1e-9 * scale)
    assert high == pytest.approx(values.max(), abs=1e-9 * scale)
    assert polynomial(low_at) == pytest.approx(low, abs=1e-9 * scale)
    assert polynomial(high_at) == pytest.approx(high, abs=1e-9 * scale)


@settings(deadline=None)
@given(polynomials, durations)
def test_a_hull_contains_the_extremes(coefficients, duration):
    low, high = bounds.hull(stacked(coefficients), np.array([duration]))
    lowest, _, highest, _ = bounds.extremes(stacked(coefficients), np.array([duration]))
    rounding = 1e-9 * (1.0 + np.abs(Polynomial(np.abs(coefficients))(duration)))
    assert low[0] <= lowest[0] + rounding
    assert high[0] >= highest[0] - rounding


def test_a_touching_minimum_at_the_very_start_of_an_interval_is_found():
    # derivative zero exactly at 0.5, where a turning point of the derivative lies as well
    coefficients = Polynomial.fromroots([0.5, 0.5, 0.5, 0.5]).coef
    low, at, _, _ = bounds.extremes(stacked(coefficients), np.array([1.0]))
    assert low[0] == pytest.approx(0.0, abs=1e-15)
    assert at[0] == pytest.approx(0.5, abs=1e-3)


def test_one_polynomial_does_not_disturb_its_neighbours():
    rng = np.random.default_rng(1)
    many, duration = rng.normal(size=(6, 40, 3)), rng.uniform(0.1, 2.0, (40, 1))
    together = bounds.extremes(many, duration)
    for i in range(40):
        alone = bounds.extremes(many[:, [i]], duration[[i]])
        for a, b in zip(together, alone, strict=True):
            assert (a[i] == b[0]).all()


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_segments_agree_with_scipy(seed):
    rng = np.random.default_rng(seed)
    start, end, duration = rng.normal(size=3), rng.normal(size=3), rng.uniform(0.1, 2.0)
    t = np.linspace(0.0, duration, 20)
    quintic = np.array(segment.quintic(*start, *end, duration))
    reference = BPoly.from_derivatives([0.0, duration], [start, end])
    assert bounds.value(quintic, t) == pytest.approx(reference(t), abs=1e-9)
    velocity = bounds.value(bounds.derivative(quintic), t)
    assert velocity == pytest.approx(reference.derivative()(t), abs=1e-8)
    cubic = np.array(segment.cubic(*start[:2], *end[:2], duration))
    reference = BPoly.from_derivatives([0.0, duration], [start[:2], end[:2]])
    assert bounds.value(cubic, t) == pytest.approx(reference(t), abs=1e-9)


@settings(deadline=None)
@given(polynomials, durations, st.floats(-2.0, 2.0))
def test_a_shifted_polynomial_is_the_same_one_later(coefficients, duration, by):
    later = bounds.shifted(stacked(coefficients), np.array([by]))
    polynomial = Polynomial(coefficients)
    t = np.linspace(0.0, duration, 7)
    scale = 1.0 + np.abs(Polynomial(np.abs(coefficients))(duration + 2.0))
    assert bounds.value(later[:, 0], t) == pytest.approx(polynomial(by + t), abs=1e-9 * scale)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(-9, 9)), min_size=1, max_size=60), st.integers(0, 50))
def test_the_widest_range_is_that_of_the_values_in_the_window(pairs, window):
    pairs.sort(key=lambda pair: pair[0])
    times, values = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
    expected = []
    for i, t in enumerate(times):
        inside = values[i:][times[i:] <= t + window]
        expected.append(inside.max() - inside.min())
    assert bounds.widest_range(times, values, window).tolist() == expected
