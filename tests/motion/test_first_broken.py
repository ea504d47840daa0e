"""The rule of a joint's limits: just inside and just outside of each, for one state and for arrays, compiled or not."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from compilation.jit import jit
from motion.limits import ACCELERATION, NONE, POSITION, VELOCITY, band, first_broken

LOWEST, HIGHEST, FASTEST, HARDEST = -1.0, 2.0, 0.5, 4.0
BELOW, ABOVE = math.nextafter(LOWEST, -math.inf), math.nextafter(HIGHEST, math.inf)
TOO_FAST, TOO_HARD = math.nextafter(FASTEST, math.inf), math.nextafter(HARDEST, math.inf)
compiled = jit(first_broken)

STATES = [
    ((0.0, 0.0, 0.0), NONE),
    ((LOWEST, -FASTEST, -HARDEST), NONE),
    ((HIGHEST, FASTEST, HARDEST), NONE),
    ((BELOW, 0.0, 0.0), POSITION),
    ((ABOVE, 0.0, 0.0), POSITION),
    ((0.0, TOO_FAST, 0.0), VELOCITY),
    ((0.0, -TOO_FAST, 0.0), VELOCITY),
    ((0.0, 0.0, TOO_HARD), ACCELERATION),
    ((0.0, 0.0, -TOO_HARD), ACCELERATION),
    ((ABOVE, TOO_FAST, TOO_HARD), POSITION),
    ((0.0, TOO_FAST, TOO_HARD), VELOCITY),
    *(((wrong, 0.0, 0.0), POSITION) for wrong in (math.nan, math.inf, -math.inf)),
    *(((0.0, wrong, 0.0), VELOCITY) for wrong in (math.nan, math.inf, -math.inf)),
    *(((0.0, 0.0, wrong), ACCELERATION) for wrong in (math.nan, math.inf, -math.inf)),
]


@pytest.mark.parametrize("rule", [first_broken, compiled], ids=["plain", "compiled"])
@pytest.mark.parametrize(("state", "broken"), STATES)
def test_one_state(rule, state, broken):
    assert rule(*state, LOWEST, HIGHEST, FASTEST, HARDEST) == broken


def test_arrays_are_judged_as_their_elements_are():
    states, broken = zip(*STATES, strict=True)
    judged = first_broken(*np.array(states).T, LOWEST, HIGHEST, FASTEST, HARDEST)
    assert judged.tolist() == list(broken)


numbers = st.floats(width=64)


@given(st.tuples(*[numbers] * 3), st.tuples(*[numbers] * 4))
def test_what_breaks_nothing_is_finite_and_within_whatever_limits_are_finite(state, limits):
    lowest, highest, fastest, hardest = limits
    broken = compiled(*state, *limits)
    position, velocity, acceleration = state
    allowed = (
        lowest <= position <= highest,
        -fastest <= velocity <= fastest,
        -hardest <= acceleration <= hardest,
    )
    assert broken == (allowed.index(False) if False in allowed else NONE)


def test_a_band_is_wider_than_the_limits_by_the_slack():
    assert band(-1.0, 2.0, 0.25) == (-1.25, 2.25)
