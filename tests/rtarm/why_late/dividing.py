"""One interval of a thread divided by events of its own."""

from __future__ import annotations

from collections.abc import Sequence

from rtarm.why_late.divide import NEVER_NS, Divider, Segment
from rtarm.why_late.events import Event


def divide(
    events: Sequence[Event], tid: int, start_ns: int, end_ns: int, *, runs: bool = False, slept_by_ns: int | None = None
) -> list[Segment]:
    """The causes of the interval, at whose start the thread is due, unless it runs there."""
    if slept_by_ns is None:
        slept_by_ns = NEVER_NS if runs else start_ns
    return Divider(events, tid).divide(start_ns, end_ns, runs=runs, slept_by_ns=slept_by_ns)
