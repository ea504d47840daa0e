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


@settings(deadline=None, max_examples=20)
@given(st.floats(0.5, 5.0), st.floats(0.1, 3.0))
def test_what_a_drive_sees_of_a_smooth_motion_is_its_velocity_and_acceleration(omega, amplitude):
    period = 1e-3
    t = np.arange(2000)[:, np.newaxis] * period
    velocity, acceleration = bounds.cycle_differences(
        amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t), period
    )
    assert velocity == pytest.approx(np.abs(amplitude * omega * np.cos(omega * t)), abs=0.01 * amplitude * omega**2)
    expected = np.abs(amplitude * omega**2 * np.sin(omega * t[1:-1]))
    assert acceleration == pytest.approx(expected, abs=0.01 * amplitude * omega**3)


def test_a_jump_that_no_sample_falls_into_is_seen():
    position = np.array([[0.0], [0.0], [0.1], [0.1]])  # a step between two cycles, at rest in both
    velocity, acceleration = bounds.cycle_differences(position, np.zeros((4, 1)), 0.01)
    assert velocity.max() == pytest.approx(10.0)
    assert acceleration.max() == pytest.approx(1000.0)
