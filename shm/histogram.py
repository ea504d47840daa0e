"""Logarithmic histograms of durations: HdrHistogram's bucket layout, three values in a hundred wide at most.

Buckets below 2**SUB_BITS hold one nanosecond each; above, every power of two is cut into 2**(SUB_BITS-1)
equal buckets, so the relative width never exceeds 2**(1-SUB_BITS) = 3.1 %. Nothing is dropped: values beyond
the last bucket count there, and the true maximum is kept beside.
"""

from collections.abc import Sequence

import numpy as np

from shm.layout import HISTOGRAM_BUCKETS
from shm.layout import HISTOGRAM_SUB_BITS as SUB_BITS

_HALF = 1 << (SUB_BITS - 1)


def bucket(value_ns: int) -> int:
    """Index of the bucket of a value ≥ 0; a leaf function that numba compiles."""
    shift = 0
    reduced = value_ns
    while reduced >= 2 * _HALF:
        reduced >>= 1
        shift += 1
    index = shift * _HALF + reduced
    return min(index, HISTOGRAM_BUCKETS - 1)


def upper_ns(index: int) -> int:
    """Largest value that falls into a bucket."""
    if index < 2 * _HALF:
        return index
    shift = index // _HALF - 1
    return int(((index - shift * _HALF + 1) << shift) - 1)


def percentiles_ns(histogram: np.void, percents: Sequence[float]) -> list[int]:
    """Values below which the given percentages of the recorded ones lie (upper bucket edge, ≤ the maximum)."""
    counts = np.cumsum(histogram["buckets"])
    if counts[-1] == 0:
        return [0 for _ in percents]
    ranks = np.ceil(np.asarray(percents) / 100.0 * counts[-1]).clip(1)
    found = np.searchsorted(counts, ranks)
    return [min(upper_ns(int(i)), int(histogram["max_ns"])) for i in found]
