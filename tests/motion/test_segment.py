"""Segments and the clock's ramp: what they begin and end with, and that each is the derivative of the one before."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from motion import scaling, segment

number = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))
durations = st.floats(0.1, 3.0).map(lambda x: round(x, 3))
shares = st.floats(0.0, 1.0)
Motion = Callable[[float], tuple[float, float, float]]


def assert_each_is_the_derivative_of_the_one_before(motion: Motion, t: float, duration: float) -> None:
    """By central differences of polynomials, at a step that is some way above rounding."""
    h = 1e-4 * duration
    before, here, after = motion(t - h), motion(t), motion(t + h)
    for i in (0, 1):
        difference = (after[i] - before[i]) / (2.0 * h)
        assert here[i + 1] == pytest.approx(difference, abs=1e-4 * (1.0 + max(map(abs, here))) / duration**2)


@given(st.lists(number, min_size=6, max_size=6), st.floats(-2.0, 2.0))
def test_a_segment_is_the_polynomial_of_its_coefficients(coefficients: list[float], t: float) -> None:
    polynomial = Polynomial(coefficients)
    expected = (polynomial(t), polynomial.deriv()(t), polynomial.deriv(2)(t))
    assert segment.evaluate(*coefficients, t) == pytest.approx(expected, abs=1e-9)


@given(st.lists(number, min_size=6, max_size=6), durations)
def test_segments_begin_and_end_with_what_they_are_given(ends: list[float], duration: float) -> None:
    p0, v0, a0, p1, v1, a1 = ends
    line = segment.linear(p0, p1, duration)
    cubic = segment.cubic(p0, v0, p1, v1, duration)
    quintic = segment.quintic(p0, v0, a0, p1, v1, a1, duration)
    scale = 1e-9 / duration**2
    for coefficients, kept in ((line, 1), (cubic, 2), (quintic, 3)):
        assert segment.evaluate(*coefficients, 0.0)[:kept] == pytest.approx((p0, v0, a0)[:kept], abs=scale)
        assert segment.evaluate(*coefficients, duration)[:kept] == pytest.approx((p1, v1, a1)[:kept], abs=scale)
        assert coefficients[2 * kept :] == (0.0,) * (6 - 2 * kept)


@given(number, number, number, durations)
def test_a_decay_begins_with_the_offset_and_ends_with_nothing(p: float, v: float, a: float, duration: float) -> None:
    coefficients = segment.decay(p, v, a, duration)
    assert segment.evaluate(*coefficients, 0.0) == pytest.approx((p, v, a))
    assert segment.evaluate(*coefficients, duration) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9 / duration**2)


@given(number, durations, shares)
def test_a_fade_is_a_motion_whose_acceleration_goes_from_its_value_to_nothing(
    a: float, duration: float, share: float
) -> None:
    assert segment.fade(a, duration, 0.0)[2] == a
    assert segment.fade(a, duration, duration) == (0.0, 0.0, 0.0)
    assert segment.fade(a, duration, share * duration)[2] == pytest.approx(a * (1.0 - share) ** 2)
    assert_each_is_the_derivative_of_the_one_before(lambda t: segment.fade(a, duration, t), share * duration, duration)


@given(st.floats(0.0, 1.0), st.floats(-2.0, 2.0), st.floats(0.0, 1.0), durations, shares)
def test_a_ramp_leads_from_rate_and_slope_to_the_target(
    rate: float, slope: float, target: float, duration: float, share: float
) -> None:
    assert scaling.ramp(rate, slope, target, duration, 0.0) == pytest.approx((rate, slope, 0.0))
    end = scaling.ramp(rate, slope, target, duration, duration)
    assert end[:2] == pytest.approx((target, 0.0), abs=1e-9 / duration)

    def clock(t: float) -> tuple[float, float, float]:
        value, derivative, advance = scaling.ramp(rate, slope, target, duration, t)
        return advance, value, derivative

    assert_each_is_the_derivative_of_the_one_before(clock, share * duration, duration)


@given(st.lists(number, min_size=4, max_size=4), st.floats(0.0, 1.0), st.floats(-2.0, 2.0))
def test_along_is_the_chain_rule(path: list[float], rate: float, slope: float) -> None:
    """q(τ(t)) differenced in t, with a clock of that rate and slope."""
    q = Polynomial(path)
    velocity, acceleration = scaling.along(rate, slope, q.deriv()(0.0), q.deriv(2)(0.0))
    h = 1e-3
    before, here, after = (q(rate * t + 0.5 * slope * t * t) for t in (-h, 0.0, h))
    assert velocity == pytest.approx((after - before) / (2.0 * h), abs=1e-4)
    assert acceleration == pytest.approx((after - 2.0 * here + before) / (h * h), abs=1e-3)


def test_they_take_arrays_as_they_take_numbers() -> None:
    t = np.linspace(0.0, 1.0, 5)
    together = segment.evaluate(*segment.cubic(0.0, 1.0, 2.0, 0.5, 1.0), t)
    for i, each in enumerate(t):
        assert [row[i] for row in together] == list(segment.evaluate(*segment.cubic(0.0, 1.0, 2.0, 0.5, 1.0), each))
