"""How far a stopped stream reaches: the closed form against the law of the clock's rate and the candidates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.stopping import longest_stop_s
from motion import scaling, segment, stopping


@given(st.floats(0.05, 3.0))
def test_a_stop_takes_half_its_duration_of_path_and_is_steepest_in_the_middle(duration):
    rate, slope, advance = scaling.ramp(1.0, 0.0, 0.0, duration, np.linspace(0.0, duration, 1001))
    assert advance[-1] == pytest.approx(0.5 * duration)
    assert (rate[0], rate[-1]) == pytest.approx((1.0, 0.0))
    assert stopping.way_s(duration) == pytest.approx(advance[-1])
    assert -slope.min() == pytest.approx(1.5 / duration)


@given(st.floats(0.0, 2.0), st.floats(0.1, 5.0), st.floats(1e-3, 0.02))
def test_the_candidate_that_is_taken_stops_within_the_reach(to_brake, longest, period):
    shortest = 1.5 * to_brake
    candidates = [share * longest for share in stopping.STOP_FRACTIONS]
    taken = next((duration for duration in candidates if duration >= shortest), None)
    reach = stopping.reach_s(to_brake, longest, period)
    if taken is not None:
        assert reach >= 0.5 * taken + period
    assert reach <= 0.5 * max(1.6 * shortest, candidates[0]) + 2.0 * period


def hardest_share(plan_share, duration, slowest):
    """Largest acceleration along a stop, as a share of what is allowed, amid a plan of that share at full velocity."""
    rate, slope, _ = scaling.ramp(1.0, 0.0, 0.0, duration, np.linspace(0.0, duration, 1001))
    pushed = np.abs(scaling.along(rate, slope, slowest, -plan_share)[1])
    return pushed.max() / max(stopping.ORDERLY, plan_share + stopping.PLAN_SHARE)


@given(st.floats(0.1, 10.0), st.floats(0.0, 1.7))
def test_the_longest_stop_fits_beside_any_plan(slowest, plan_share):
    """In the direction in which both brake, at the velocity margin of 1.05."""
    assert hardest_share(plan_share, longest_stop_s(slowest), 1.05 * slowest) <= 1.0


@given(st.floats(-1.0, 1.0), st.floats(-5.0, 5.0), st.floats(-40.0, 40.0), st.floats(0.0, 2.0))
def test_a_stream_ends_on_the_line_on_which_its_acceleration_has_faded(position, velocity, acceleration, after):
    fade = stopping.fade_duration_s(0.01)
    p0, v0 = stopping.line_beyond(position, velocity, acceleration, fade)
    p, v, a = segment.fade(acceleration, fade, 0.0)
    assert (p0 + p, v0 + v, a) == pytest.approx((position, velocity, acceleration))  # leaves smoothly
    p, v, a = segment.fade(acceleration, fade, fade)
    assert (p, v, a) == (0.0, 0.0, 0.0)
    assert p0 + v0 * (fade + after) == pytest.approx(
        position + velocity * (fade + after) + acceleration * (fade * fade / 4.0 + fade * after / 3.0), abs=1e-9
    )


@pytest.mark.parametrize(("period", "expected"), [(0.001, 0.02), (0.01, 0.03), (0.02, 0.06)])
def test_a_fade_lasts_some_cycles(period, expected):
    assert stopping.fade_duration_s(period) == pytest.approx(expected)


@pytest.mark.parametrize("slowest", [0.5, 10.0])
def test_the_longest_stop_is_not_longer_than_it_must_be(slowest):
    """A sixth less breaks the limit amid the hardest plan that leaves PLAN_SHARE of it."""
    assert longest_stop_s(slowest) == pytest.approx(5.83 * slowest)
    shorter = longest_stop_s(slowest) * 5.0 / 6.0
    assert hardest_share(1.0 - stopping.PLAN_SHARE, shorter, 1.05 * slowest) > 1.0
