"""From slices to figures: what `rtarm bench --json` writes. Pure functions of what was measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rtarm.bench.lateness import as_pairs, figures_us, merged, spread
from rtarm.why_late.report import causes_of
from rtarm.why_late.watch import Late

WHO = ("cyclictest", "rtarm", "one_node", "plain_loop", "one_node_fifo")
"""`one_node_fifo` is `one_node` with the priority of rtarm, given from outside."""
LOADS = ("idle", "loaded")

RATIOS = {
    "rtarm_to_cyclictest": ("rtarm", "cyclictest"),
    "one_node_to_rtarm": ("one_node", "rtarm"),
    "plain_loop_to_rtarm": ("plain_loop", "rtarm"),
    "one_node_fifo_to_rtarm": ("one_node_fifo", "rtarm"),
}
"""Whose figure is divided by whose, each pair within one repeat of the same rate and load."""
RATIOS_OF = ("p50", "p99", "p99_9", "max")

Key = tuple[str, int, str]
"""Who, rate (Hz), idle or loaded."""


@dataclass(frozen=True)
class Slice:
    """What was measured of one competitor in one slice.

    Attributes:
        lateness: histogram of its wake-ups.
        seconds: how long it was, None where only the number of cycles is known.
        processor_ns: processor time used, by process.
        scheduling: what it really ran with, as `rtarm status --json` names it.
        trouble: what happened to its goal, "" where that succeeded.
        cycle_time: histogram from wake-up to the end of the write, where it is known.
        joint_states: how /joint_states arrived at a subscriber: `rate_hz`, `interval_ms`, `age_ms` (since the stamp).
        goal_ms: from the moment before the client sent its goal to the instant that its first setpoint was due.
        late: its late cycles, divided into causes; None where nobody traced them.
    """

    lateness: np.void
    seconds: float | None
    processor_ns: Mapping[str, int]
    scheduling: Mapping[str, Any]
    trouble: str = ""
    cycle_time: np.void | None = None
    joint_states: Mapping[str, Any] | None = None
    goal_ms: float | None = None
    late: tuple[Late, ...] | None = None

    @property
    def cycles(self) -> int:
        """Wake-ups."""
        return int(self.lateness["count"])

    @property
    def processor_us_per_cycle(self) -> float:
        """Processor time of all its processes together."""
        return sum(self.processor_ns.values()) * 1e-3 / max(self.cycles, 1)


@dataclass
class Measurements:
    """All slices of a run, by who, rate and load; the order within each is that of the repeats."""

    slices: dict[Key, list[Slice]] = field(default_factory=dict)

    def add(self, rate_hz: int, who: str, load: str, found: Slice) -> None:
        """One more."""
        self.slices.setdefault((who, rate_hz, load), []).append(found)

    def scheduling(self) -> dict[str, dict[str, Any]]:
        """What everybody ran with in their first slice; nothing changes it in a run."""
        found: dict[str, dict[str, Any]] = {}
        for (who, _, _), slices in self.slices.items():
            found.setdefault(who, dict(slices[0].scheduling))
        return found

    def tree(self, figure: Callable[[Key, Sequence[Slice]], Any]) -> dict[str, dict[str, dict[str, Any]]]:
        """`who → rate → load → figure`, of those slices that have it: others give None."""
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for key, slices in self.slices.items():
            who, rate_hz, load = key
            value = figure(key, slices)
            if value is not None:
                found.setdefault(who, {}).setdefault(str(rate_hz), {})[load] = value
        return found


def document(measured: Measurements) -> dict[str, Any]:
    """The figures; every key says its unit, and the rates are keys as text."""
    return {
        "lateness_us": measured.tree(lambda _, slices: figures_us(merged(one.lateness for one in slices))),
        "ratios": ratios(measured),
        "lateness_spread_us": measured.tree(lambda _, slices: _spreads([figures_us(one.lateness) for one in slices])),
        "processor_us_per_cycle": measured.tree(lambda _, slices: _processor_us(slices)),
        "missed_cycles": measured.tree(
            lambda key, slices: sum(missed_cycles(one.lateness, 1e9 / key[1]) for one in slices)
        ),
        "obtained_hz": measured.tree(lambda _, slices: _obtained_hz(slices)),
        "scheduling": measured.scheduling(),
        "goals_in_trouble": measured.tree(lambda _, slices: [one.trouble for one in slices if one.trouble] or None),
        "chain": chain(measured),
        **_causes(measured),
        "histogram_ns": measured.tree(lambda _, slices: as_pairs(merged(one.lateness for one in slices))),
    }


def ratios(measured: Measurements) -> dict[str, Any]:
    """Medians, with their spread, of the ratios that the repeats give, each of slices that alternated."""
    found: dict[str, Any] = {}
    for ratio, (above, below) in RATIOS.items():
        for (who, rate_hz, load), slices in measured.slices.items():
            others = measured.slices.get((below, rate_hz, load))
            if who != above or others is None:
                continue
            late = [(figures_us(a.lateness), figures_us(b.lateness)) for a, b in zip(slices, others, strict=True)]
            used = [(a.processor_us_per_cycle, b.processor_us_per_cycle) for a, b in zip(slices, others, strict=True)]
            figures = {name: spread(_quotients((a[name], b[name]) for a, b in late)) for name in RATIOS_OF}
            if below != "cyclictest":  # which does nothing
                figures["processor_time"] = spread(_quotients(used))
            found.setdefault(ratio, {}).setdefault(str(rate_hz), {})[load] = figures
    return found


def chain(measured: Measurements) -> dict[str, Any]:
    """The other links between a goal and what is heard of it; each `who → rate → load`, as far as it was measured."""
    return {
        "wake_up_to_written_us": measured.tree(lambda _, slices: _cycle_time_us(slices)),
        "stamp_to_subscriber_ms": measured.tree(lambda _, slices: _arrival(slices, "age_ms")),
        "between_joint_states_ms": measured.tree(lambda _, slices: _arrival(slices, "interval_ms")),
        "goal_sent_to_first_setpoint_ms": measured.tree(lambda _, slices: _goal_ms(slices)),
    }


def _cycle_time_us(slices: Sequence[Slice]) -> dict[str, float | int] | None:
    found = [one.cycle_time for one in slices if one.cycle_time is not None]
    return figures_us(merged(found)) if found else None


def _arrival(slices: Sequence[Slice], figure: str) -> dict[str, Any] | None:
    """Median, 99th percentile and maximum of the slices, each with its spread over the repeats."""
    found = [one.joint_states[figure] for one in slices if one.joint_states and one.joint_states[figure]]
    return {name: spread([one[name] for one in found]) for name in ("p50", "p99", "max")} if found else None


def _goal_ms(slices: Sequence[Slice]) -> Mapping[str, float | int | None] | None:
    found = [one.goal_ms for one in slices if one.goal_ms is not None]
    return spread(found) if found else None


def _quotients(pairs: Iterable[tuple[float, float]]) -> list[float]:
    """First through second; a pair whose second is 0 gives none."""
    return [above / below for above, below in pairs if below > 0]


def missed_cycles(lateness: np.void, period_ns: float) -> int:
    """Deadlines that had passed unserved when somebody at last woke up, to the histogram's 3 %."""
    return sum(int(late_ns // period_ns) * count for late_ns, count in as_pairs(lateness))


def _spreads(repeats: Sequence[Mapping[str, float | int]]) -> dict[str, Any]:
    return {name: spread([one[name] for one in repeats]) for name in (*RATIOS_OF, "p90")}


def _processor_us(slices: Sequence[Slice]) -> dict[str, float]:
    """Medians of the repeats: all processes together, and each."""
    each = {
        name: float(np.median([one.processor_ns.get(name, 0) * 1e-3 / max(one.cycles, 1) for one in slices]))
        for name in slices[0].processor_ns
    }
    return {"all": float(np.median([one.processor_us_per_cycle for one in slices])), **each}


def _obtained_hz(slices: Sequence[Slice]) -> float | None:
    """Cycles a second, waking up at all being what is counted."""
    timed = [(one.cycles, one.seconds) for one in slices if one.seconds]
    seconds = sum(second for _, second in timed)
    return sum(cycles for cycles, _ in timed) / seconds if seconds else None


def _causes(measured: Measurements) -> dict[str, Any]:
    """Why cycles were late, where that was traced; nothing where it was not."""
    traced = measured.tree(
        lambda _, slices: (
            None
            if all(one.late is None for one in slices)
            else causes_of([late for one in slices for late in one.late or () if late.woke])
        )
    )
    return {"causes": traced} if traced else {}
