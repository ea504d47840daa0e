"""What was found, as one object and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rtarm.why_late.causes import MEANINGS, WORDS, Cause
from rtarm.why_late.watch import Late, Watcher

MOSTLY = 3
"""Names that are told of a cause, those with most time first."""
BAR = 24


def causes_of(late: Sequence[Late]) -> list[dict[str, Any]]:
    """Causes by the share that they have of all late time, the largest first."""
    total_ns = sum(one.length_ns for one in late)
    found = []
    for cause in Cause:
        took_ns = sum(one.by_cause.get(cause, 0) for one in late)
        if took_ns == 0:
            continue
        chiefly = [one for one in late if one.cause is cause]
        worst = max(chiefly, key=lambda one: one.length_ns, default=None)
        found.append(
            {
                "cause": cause.value,
                "cycles": len(chiefly),
                "us": took_ns / 1000,
                "share": took_ns / total_ns,
                "mostly": [{"who": who, "us": ns / 1000} for who, ns in mostly(late, cause)],
                "worst": None if worst is None else _plain(worst),
            }
        )
    return sorted(found, key=lambda one: -one["us"])


def mostly(late: Iterable[Late], cause: Cause) -> list[tuple[str, int]]:
    """Who is named with a cause, and for how many ns, those with most time first."""
    names: Counter[str] = Counter()
    for one in late:
        for (named, who), length_ns in one.by_name.items():
            if named is cause and who:
                names[who] += length_ns
    return names.most_common(MOSTLY)


def report_of(arm: str, seconds: float, bound_us: float, watcher: Watcher, notes: Iterable[str]) -> dict[str, Any]:
    """Everything, in figures and names; `traced` and `hints` are for the caller to add."""
    return {
        "arm": arm,
        "seconds": round(seconds, 3),
        "bound_us": bound_us,
        "cycles": watcher.cycles,
        "late": watcher.count,
        "undivided": watcher.undivided,
        "late_us": sum(one.length_ns for one in watcher.late) / 1000,
        "causes": causes_of(watcher.late),
        "notes": list(notes),
    }


def _plain(late: Late) -> dict[str, Any]:
    return {
        "cycle": late.cycle,
        "what": "woke up late" if late.woke else "took long",
        "us": late.length_ns / 1000,
        "segments": [
            {
                "at_us": (segment.start_ns - late.start_ns) / 1000,
                "us": segment.length_ns / 1000,
                "cause": segment.cause.value,
                "who": segment.who,
            }
            for segment in late.segments
        ],
    }


def render(report: Mapping[str, Any]) -> RenderableType:
    """The same for a person."""
    within = f"{report['arm']}: {report['cycles']} cycles in {report['seconds']:.0f} s"
    if not report["late"]:
        return Group(Text(f"{within}, none later than {report['bound_us']:g} µs."), *_remarks(report))
    heading = f"{within}, {report['late']} later than {report['bound_us']:g} µs, {_us(report['late_us'])} µs together"
    return Group(Text(heading), _table(report["causes"]), *map(_example, report["causes"]), *_remarks(report))


def _table(causes: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("cause")
    for column in ("share", "chiefly", "µs"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("mostly")
    for one in causes:
        who = one["mostly"][0]["who"] if one["mostly"] else ""
        cycles = str(one["cycles"]) if one["cycles"] else ""
        words = WORDS[Cause(one["cause"])]
        table.add_row(Text(words), f"{one['share']:.1%}", cycles, _us(one["us"]), Text(who))
    return table


def _example(one: Mapping[str, Any]) -> RenderableType:
    """The worst of those that a cause is the chief one of, as a time line."""
    worst, cause = one["worst"], Cause(one["cause"])
    if worst is None:
        return Group()
    lines = [
        Text(f"{WORDS[cause]}: {MEANINGS[cause]}", style="bold"),
        Text(f"  the worst: cycle {worst['cycle']} {worst['what']}, {_us(worst['us'])} µs"),
    ]
    for segment in worst["segments"]:
        begin = round(BAR * segment["at_us"] / worst["us"])
        length = max(1, round(BAR * segment["us"] / worst["us"]))
        bar = (" " * min(begin, BAR - 1) + "█" * length)[:BAR].ljust(BAR)
        name = f"{WORDS[Cause(segment['cause'])]}{', ' if segment['who'] else ''}{segment['who']}"
        lines.append(Text(f"  {bar} {_us(segment['us']):>7}  {name}"))
    return Group(*lines, Text())


def _remarks(report: Mapping[str, Any]) -> list[RenderableType]:
    lines = list(report["notes"])
    if report["undivided"]:
        lines.append(f"{report['undivided']} late cycles were too many, and were not looked into.")
    if report["hints"]:
        lines.append("Counters that rose faster while cycles were late (hints, no causes), and otherwise, in 50 ms:")
        lines += [
            f"  {one['a_look_with_late_cycles']:g} and {one['a_look_without']:g}  {one['what']}"
            for one in report["hints"]
        ]
    return [Text(line) for line in lines]


def _us(value: float) -> str:
    return f"{value:.{1 if value < 100 else 0}f}"
