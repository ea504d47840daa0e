"""What a recording says once a second: how late the cycles were and how long they took, what the bus carried."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from rtarm.running.status import PERCENTS, key
from shm.layout import BUS_TROUBLE, CycleRecord
from shm.words import BusState

NS = 1_000_000_000
TIMED = {"lateness": "lateness_ns", "cycle_time": "cycle_time_ns"}
"""What percentiles are told of, and the word of a cycle's record that it stands in."""
RATES = {"frames_sent_per_s": "frames_sent", "frames_received_per_s": "frames_received"}
TOTALS = ("overruns", *BUS_TROUBLE)
"""Counters of which the rise within the second is told, and how far they have come."""
_WORDS = ["number", "monotonic_ns", "epoch_ns", "bits_on_bus", "bus_state", *TIMED.values(), *RATES.values(), *TOTALS]
_SLIM = np.dtype([(name, CycleRecord.dtype[name]) for name in _WORDS])


class Figures(NamedTuple):
    """A second's figures, and when its last cycle was."""

    monotonic_ns: int
    epoch_ns: int
    content: dict[str, Any]


class Seconds:
    """Sums up an arm's cycles second by second, however many of them come at a time."""

    def __init__(self, bitrate: int) -> None:
        """`bitrate` of all buses together (bit/s), 0 where there is none."""
        self._bitrate = bitrate
        self._pending = np.zeros(0, _SLIM)
        self._before: np.void | None = None

    def add(self, records: np.ndarray) -> Iterator[Figures]:
        """Take cycles, and tell of the seconds that are complete with them."""
        slim = np.zeros(len(records), _SLIM)
        for name in _WORDS:
            slim[name] = records[name]
        known = np.concatenate([self._pending, slim])
        borders = np.flatnonzero(np.diff(known["monotonic_ns"] // NS)) + 1
        *complete, self._pending = np.split(known, borders)
        for cycles in complete:
            yield self._figures(cycles)

    def rest(self) -> Iterator[Figures]:
        """The second that is not complete."""
        pending, self._pending = self._pending, self._pending[:0]
        if len(pending):
            yield self._figures(pending)

    def _figures(self, cycles: np.ndarray) -> Figures:
        last = cycles[-1]
        before = cycles[0] if self._before is None else self._before
        self._before = last
        span_s = float(last["monotonic_ns"] - before["monotonic_ns"]) / NS
        risen = {name: int(last[name] - before[name]) for name in ("number", "bits_on_bus", *RATES.values(), *TOTALS)}
        content: dict[str, Any] = {
            "monotonic_ns": int(last["monotonic_ns"]),
            "number": int(last["number"]),
            "cycles": len(cycles),
            "cycles_not_recorded": max(int(last["number"] - cycles[0]["number"]) + 1 - len(cycles), 0),
            "cycles_per_s": _per_s(risen["number"], span_s),
        }
        for what, name in TIMED.items():
            values = np.maximum(cycles[name], 0)
            percents = np.percentile(values, list(PERCENTS.values())) * 1e-3
            content.update(
                (f"{what}_{percent}_us", one) for percent, one in zip(PERCENTS, percents.tolist(), strict=True)
            )
            content[f"{what}_max_us"] = float(values.max()) * 1e-3
        rate = _per_s(risen["bits_on_bus"], span_s)
        content["bus_load"] = rate / self._bitrate if rate is not None and self._bitrate > 0 else None
        content.update((name, _per_s(risen[word], span_s)) for name, word in RATES.items())
        content.update((name, risen[name]) for name in TOTALS)
        content.update((f"{name}_total", int(last[name])) for name in TOTALS)
        content["bus_state"] = key(BusState, int(last["bus_state"]))
        return Figures(int(last["monotonic_ns"]), max(int(last["epoch_ns"]), 0), content)


def _per_s(count: int, span_s: float) -> float | None:
    return count / span_s if span_s > 0 else None


def properties() -> dict[str, dict[str, Any]]:
    """The JSON schema of each figure."""
    integer, number = {"type": "integer"}, {"type": ["number", "null"]}
    timed = {
        f"{what}_{name}_us": {**number, "description": f"{what.replace('_', ' ')} of the cycles in this second (µs)"}
        for what in TIMED
        for name in (*PERCENTS, "max")
    }
    return {
        "monotonic_ns": {**integer, "description": "of the last cycle of this second (ns)"},
        "number": {**integer, "description": "of that cycle's record"},
        "cycles": {**integer, "description": "cycles recorded in this second"},
        "cycles_not_recorded": {**integer, "description": "cycles between them that are missing in the recording"},
        "cycles_per_s": number,
        **timed,
        "bus_load": {
            **number,
            "description": "share of the bus' bits that were in use, 0…1; of several buses, those of all",
        },
        **dict.fromkeys(RATES, number),
        **{name: {**integer, "description": "in this second"} for name in TOTALS},
        **{f"{name}_total": {**integer, "description": "since the control process began"} for name in TOTALS},
        "bus_state": {"type": "string"},
    }
