"""The figures as tables that fit 80 columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rtarm.bench.lateness import PERCENTS
from rtarm.bench.results import LOADS, RATIOS, WHO
from rtarm.running.status import describe_scheduling
from rtarm.why_late.causes import WORDS, Cause

HEADINGS = {"p50": "p50", "p90": "p90", "p99": "p99", "p99_9": "p99.9", "max": "max"}


def render(report: Mapping[str, Any]) -> RenderableType:
    """Everything that a person wants to know of a run."""
    rates = sorted({int(rate) for by_rate in report["lateness_us"].values() for rate in by_rate})
    lateness = [_lateness_table(report, str(rate), load) for rate in rates for load in LOADS]
    ratios = [_ratio_table(name, report["ratios"][name]) for name in RATIOS if name in report["ratios"]]
    return Group(*filter(None, lateness), *ratios, *_facts(report))


def _lateness_table(report: Mapping[str, Any], rate: str, load: str) -> Table | None:
    wire = report["wires"][rate]
    table = _table(f"{rate} Hz, {load}, {wire}", "lateness µs")
    for column in (*PERCENTS, "max"):
        table.add_column(HEADINGS[column], justify="right", no_wrap=True)
    for column in ("cycles", "missed", "CPU µs"):
        table.add_column(column, justify="right", no_wrap=True)
    for who in WHO:
        figures = report["lateness_us"].get(who, {}).get(rate, {}).get(load)
        if figures is None:
            continue
        table.add_row(
            who,
            *(_short(figures[column]) for column in (*PERCENTS, "max")),
            str(figures["count"]),
            str(report["missed_cycles"][who][rate][load]),
            _short(report["processor_us_per_cycle"][who][rate][load]["all"]),
        )
    return table if table.rows else None


def _ratio_table(name: str, by_rate: Mapping[str, Any]) -> Table:
    table = _table(f"{name.replace('_to_', ' / ')}, median (lowest…highest)", "")
    figures = {"p99_9": "p99.9", "max": "max"}
    if name != "rtarm_to_cyclictest":
        figures["processor_time"] = "CPU"
    for heading in figures.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for rate, by_load in by_rate.items():
        for load, found in by_load.items():
            table.add_row(f"{rate} Hz {load}", *(_spread(found[figure]) for figure in figures))
    return table


def _table(title: str, first: str) -> Table:
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 0, 0, 1)
    )
    table.add_column(first, no_wrap=True)
    return table


def _facts(report: Mapping[str, Any]) -> list[RenderableType]:
    lines = [
        f"{describe_machine(report['machine'])}, {report['machine']['kernel_build']}",
        describe_versions(report["versions"]),
        "load average before: " + " ".join(f"{load:.2f}" for load in report["machine"]["load_average"]),
        f"load: {report['load']}",
        *(f"{who}: {describe_scheduling(found)}" for who, found in report["scheduling"].items()),
        *report["notes"],
    ]
    lines += _causes(report.get("causes", {}))
    for who, by_rate in report["goals_in_trouble"].items():
        for rate, by_load in by_rate.items():
            for load, troubles in by_load.items():
                lines += [f"{who}, {rate} Hz {load}, a goal did not succeed: {trouble}" for trouble in troubles]
    return [Text(line) for line in lines]


def _causes(found: Mapping[str, Any]) -> list[str]:
    """What the latest cycle of each rate and load waited for, and the shares of all causes."""
    lines = []
    for who, by_rate in found.items():
        for rate, by_load in by_rate.items():
            for load, causes in by_load.items():
                worst = max((one for one in causes if one["worst"]), key=lambda one: one["worst"]["us"], default=None)
                if worst is not None:
                    parts = [part for part in worst["worst"]["segments"] if part["cause"] == worst["cause"]]
                    named = max(parts, key=lambda part: part["us"])["who"]
                    chief = f"{WORDS[Cause(worst['cause'])]}{', ' if named else ''}{named}"
                    shares = ", ".join(f"{WORDS[Cause(one['cause'])]} {one['share']:.0%}" for one in causes)
                    lines.append(f"{who}, {rate} Hz {load}, the latest: {worst['worst']['us']:.0f} µs, {chief}")
                    lines.append(f"  all that was later than 100 µs: {shares}")
    return lines


def describe_machine(machine: Mapping[str, Any]) -> str:
    """Processors and kernel in a few words."""
    virtual = " (virtual)" if machine["virtual"] else ""
    return f"{machine['processors']} × {machine['processor']}{virtual}, Linux {machine['kernel']}"


def describe_versions(versions: Mapping[str, str | None]) -> str:
    """What is installed of what takes part."""
    return ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)


def _short(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.{2 if value < 10.0 else 1 if value < 100.0 else 0}f}"


def _spread(found: Mapping[str, Any]) -> str:
    if found["median"] is None:
        return "-"
    if found["repeats"] == 1:
        return _short(found["median"])
    return f"{_short(found['median'])} ({_short(found['lowest'])}…{_short(found['highest'])})"
