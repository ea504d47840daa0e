"""Paths: where in its window of knots a path time lies."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from config.loader import load_arm
from rtloop import path
from rtloop.beginning import new_loop
from rtloop.state import WINDOW_KNOTS

LOOP = new_loop(load_arm("mock"), 0, 0)
KNOTS = st.lists(st.integers(1, 10**9), min_size=1, max_size=40).map(np.cumsum)


def knot_of(times_ns: NDArray[np.int64], clock_s: float, first: int) -> int:
    """The last knot that is not after clock_s, or the first one."""
    return max(first, int(np.searchsorted(times_ns * 1e-9, clock_s, side="right")) - 1)


@settings(deadline=None, max_examples=300)
@given(KNOTS, st.integers(0, 10**7), st.integers(0, 1), st.data())
def test_the_segment_that_contains_a_path_time_is_found(
    times_ns: NDArray[np.int64], dropped: int, index: int, data: st.DataObject
) -> None:
    """Wherever in the window, whose older knots are gone, and also exactly at a knot."""
    numbers = dropped + np.arange(len(times_ns))
    LOOP[0]["knots"]["time_ns"][index * WINDOW_KNOTS + numbers % WINDOW_KNOTS] = times_ns
    LOOP[0]["paths"][index]["taken"] = numbers[-1] + 1
    first = data.draw(st.integers(0, len(times_ns) - 1))
    clock_s = data.draw(st.sampled_from(list(times_ns * 1e-9)) | st.floats(0.0, 50.0))
    found = path.find_knot(LOOP[0], index, clock_s, int(numbers[first]))
    assert found - dropped == knot_of(times_ns, clock_s, first)
