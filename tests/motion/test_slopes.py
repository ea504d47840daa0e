"""Derived velocities, against scipy's monotone interpolation and by their defining property."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from motion import slopes

positions = st.lists(st.floats(-3.0, 3.0).map(lambda x: round(x, 3)), min_size=2, max_size=12)


def times_for(seed: int, count: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.5, count))


@settings(deadline=None)
@given(positions, st.integers(0, 1000))
def test_inner_slopes_are_those_of_scipy(values, seed):
    times, p = times_for(seed, len(values)), np.array(values)
    ours = slopes.monotone(times, p[:, np.newaxis])[:, 0]
    theirs = PchipInterpolator(times, p).derivative()(times)
    assert ours[1:-1] == pytest.approx(theirs[1:-1], abs=1e-9)
    assert ours[0] == ours[-1] == 0.0


@settings(deadline=None)
@given(positions, st.integers(0, 1000))
def test_a_cubic_through_them_never_leaves_the_interval_of_its_waypoints(values, seed):
    times, p = times_for(seed, len(values)), np.array(values)
    spline = CubicHermiteSpline(times, p, slopes.monotone(times, p[:, np.newaxis])[:, 0])
    for i in range(len(p) - 1):
        inside = spline(np.linspace(times[i], times[i + 1], 50))
        assert inside.min() >= min(p[i], p[i + 1]) - 1e-9
        assert inside.max() <= max(p[i], p[i + 1]) + 1e-9


def test_joints_are_independent():
    times = np.array([0.0, 0.1, 0.3, 0.4])
    both = np.array([[0.0, 1.0], [0.1, 1.0], [0.4, 0.5], [0.6, 0.7]])
    together = slopes.monotone(times, both)
    for joint in range(2):
        assert (together[:, [joint]] == slopes.monotone(times, both[:, [joint]])).all()
