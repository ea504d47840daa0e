"""Histograms of durations: buckets that cover everything, and percentiles that numpy agrees with."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compilation.jit import jit
from shm import histogram, layout

WIDTH = 0.032
"""Relative width of a bucket at most, as the module says."""

jitted_bucket = jit(histogram.bucket)
durations = st.one_of(st.integers(0, 5000), st.integers(0, 2**62), st.integers(0, 62).map(lambda n: 1 << n))


@given(durations)
def test_a_value_lies_between_the_edges_of_its_bucket(value):
    index = histogram.bucket(value)
    assert 0 <= index < layout.HISTOGRAM_BUCKETS
    assert value <= histogram.upper_ns(index)
    if index > 0:
        assert value > histogram.upper_ns(index - 1)
    assert histogram.upper_ns(index) - value <= WIDTH * value


@settings(deadline=None)  # the first call compiles
@given(durations)
def test_compiled_and_plain_agree(value):
    assert jitted_bucket(value) == histogram.bucket(value)


@given(st.integers(0, layout.HISTOGRAM_BUCKETS - 2))
def test_the_upper_edge_is_the_last_value_of_its_bucket(index):
    assert histogram.bucket(histogram.upper_ns(index)) == index
    assert histogram.bucket(histogram.upper_ns(index) + 1) == index + 1


def test_the_largest_duration_there_is_has_a_bucket():
    assert histogram.bucket(2**63 - 1) == jitted_bucket(2**63 - 1) < layout.HISTOGRAM_BUCKETS


def filled(values):
    record = np.zeros(1, layout.Histogram.dtype)[0]
    for value in values:
        record["buckets"][histogram.bucket(value)] += 1
    record["max_ns"], record["count"], record["sum_ns"] = max(values), len(values), sum(values)
    return record


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=200), st.floats(0, 100))
def test_percentiles_agree_with_numpy(values, percent):
    exact = np.percentile(values, percent, method="inverted_cdf")
    (found,) = histogram.percentiles_ns(filled(values), [percent])
    assert exact <= found <= exact * (1 + WIDTH)


def test_the_tail_of_a_large_sample():
    values = np.random.default_rng(3).lognormal(10, 1, 20_000).astype(int).tolist()
    percents = [50, 90, 99, 99.9, 99.99, 100]
    found = histogram.percentiles_ns(filled(values), percents)
    exact = np.percentile(values, percents, method="inverted_cdf")
    assert found == pytest.approx(exact, rel=WIDTH)
    assert found[-1] == max(values)
    assert found == sorted(found)


def test_nothing_recorded_is_zero():
    assert histogram.percentiles_ns(np.zeros(1, layout.Histogram.dtype)[0], [50, 99]) == [0, 0]
