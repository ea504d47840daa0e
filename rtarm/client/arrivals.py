"""How messages with a header arrive: their rate, the intervals between them, and how old they are."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

STAMP_AT = 4
"""Offset of header.stamp in a serialised message: after the CDR encapsulation header."""


class Arrivals:
    """When messages arrived, and how old their stamps were."""

    def __init__(self) -> None:
        self._monotonic_ns: list[int] = []
        self._age_ns: list[int] = []

    def take(self, message: bytes) -> None:
        """Called with each serialised message; decodes nothing but the stamp."""
        self._monotonic_ns.append(time.monotonic_ns())
        sec = int.from_bytes(message[STAMP_AT : STAMP_AT + 4], "little", signed=True)
        nanosec = int.from_bytes(message[STAMP_AT + 4 : STAMP_AT + 8], "little")
        self._age_ns.append(time.time_ns() - sec * 1_000_000_000 - nanosec)

    def between(self, first_ns: int, last_ns: int) -> dict[str, Any]:
        """Rate, interval and age percentiles of what arrived between two instants (CLOCK_MONOTONIC)."""
        arrived = np.asarray(self._monotonic_ns, np.int64)
        ages = np.asarray(self._age_ns[: len(arrived)], np.int64)
        inside = (arrived >= first_ns) & (arrived <= last_ns)
        arrived, ages = arrived[inside], ages[inside]
        if len(arrived) < 2:
            return {"count": len(arrived), "rate_hz": 0.0, "interval_ms": None, "age_ms": None}
        return {
            "count": len(arrived),
            "rate_hz": (len(arrived) - 1) / (int(arrived[-1] - arrived[0]) * 1e-9),
            "interval_ms": percentiles(np.diff(arrived) * 1e-6),
            "age_ms": percentiles(ages * 1e-6),
        }


def percentiles(values: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and maximum."""
    return {
        "p50": float(np.percentile(values, 50)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }
