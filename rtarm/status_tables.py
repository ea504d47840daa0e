"""A report of `rtarm.status` for people: tables and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rtarm.status import PERCENTS, describe_scheduling
from shm.layout import BUS_TROUBLE

if TYPE_CHECKING:
    from rtarm.referencing import Reading


def render_status(report: Mapping[str, Any]) -> RenderableType:
    """The report as tables that fit 80 columns."""
    return Group(
        heading(report),
        *(Text(f"- {sentence}", style="yellow") for sentence in report["problems"]),
        _joints_table(report["joints"]),
        *_drives_table(report["joints"]),
        _facts_table(report),
        timing_table(report),
    )


def heading(report: Mapping[str, Any]) -> Text:
    """Arm, mode and whether it is fit to move, in one line."""
    return Text.assemble(
        (f"{report['arm']}: {report['mode'].replace('_', ' ')}", "bold"),
        ", ",
        ("healthy", "green") if report["healthy"] else ("not fit to move", "bold red"),
    )


def _joints_table(joints: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("joint")
    for column in ("measured °", "rad", "°/s", "commanded °", "age ms"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("referenced")
    for joint in joints:
        position, velocity = joint["position_rad"], joint["velocity_rad_s"]
        table.add_row(
            joint["name"],
            shown(position, 3, degrees=True),
            shown(position, 5),
            shown(velocity, 2, degrees=True),
            shown(joint["commanded_rad"], 3, degrees=True),
            shown(joint["age_ms"], 1),
            "yes" if joint["referenced"] else "NO",
        )
    return table


def readings_table(found: Sequence[Reading]) -> Table:
    """Joints without a reference: where each stands if its count is believed, and why it is not."""
    table = Table("joint", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("stands at °", justify="right", no_wrap=True)
    table.add_column("why that is not known")
    for joint in found:
        table.add_row(joint.joint, "-" if joint.stands_deg is None else f"{joint.stands_deg:.2f}", joint.cause)
    return table


def _drives_table(joints: Sequence[Mapping[str, Any]]) -> Iterator[Table]:
    """What drives measure beside where they are, and what is wrong with them, where there is any of it."""
    columns = [column for column in DRIVE_COLUMNS if any(joint[column.key] is not None for joint in joints)]
    if not columns and not any(joint["drive_trouble"] for joint in joints):
        return
    table = Table("drive of", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column.heading, justify="right", no_wrap=True)
    table.add_column("says")
    for joint in joints:
        figures = [shown(joint[column.key], column.digits) for column in columns]
        table.add_row(joint["name"], *figures, ", ".join(joint["drive"]) or "-")
    yield table


class DriveColumn(NamedTuple):
    """Something that some drives measure: its key in the report, and how it is shown."""

    key: str
    heading: str
    digits: int


DRIVE_COLUMNS = (
    DriveColumn("effort_nm", "Nm", 2),
    DriveColumn("temperature_c", "°C", 0),
    DriveColumn("voltage_v", "V", 1),
)


def gripper_words(gripper: Mapping[str, Any]) -> str:
    """The same in words: what it does and where, or what is wrong with it."""
    if gripper["trouble"] is not None:
        return str(gripper["trouble"])
    return f"{gripper['grip']} at {shown(gripper['position_rad'], 1, degrees=True)}°"


def shown(value: float | None, digits: int, *, degrees: bool = False) -> str:
    """A figure in so many decimals (with `degrees`: radians as degrees), or that there is none."""
    if value is None:
        return "-"
    return f"{math.degrees(value) if degrees else value:.{digits}f}"


def _facts_table(report: Mapping[str, Any]) -> Table:
    bus, front = report["bus"], report["front"]
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    table.add_row("goal", goal_words(report))
    table.add_row("speed scale", f"{report['speed_scale']:.2f}")
    if report["gripper"] is not None:
        table.add_row("gripper", gripper_words(report["gripper"]))
    served = "none" if front["pid"] is None else f"pid {front['pid']}"
    pids = f"control pid {report['loop']['pid']}, ROS {served}"
    table.add_row("processes", f"{pids}, up {duration_words(report['uptime_s'])}")
    table.add_row("cycles", f"{report['cycles']} at {report['rate_hz']:g} Hz, {report['overruns']} overruns")
    table.add_row("scheduling", describe_scheduling(report["scheduling"]))
    load = "" if bus["load"] is None else f", load {bus['load']:.1%}"
    table.add_row("bus", f"{bus['frames_tx']} frames sent, {bus['frames_rx']} received{load}")
    trouble = trouble_words(bus)
    if trouble:
        table.add_row("bus trouble", trouble)
    return table


def trouble_words(bus: Mapping[str, Any]) -> str:
    """What went wrong on the bus, counted; empty when nothing did."""
    return ", ".join(f"{bus[name]} {name.replace('_', ' ')}" for name in BUS_TROUBLE if bus[name])


def goal_words(report: Mapping[str, Any]) -> str:
    """Where the goal stands, or how the last one ended."""
    goal, last = report["goal"], report["last_result"]
    if goal is not None:
        end = "" if goal["duration_s"] is None else f" of {goal['duration_s']:.2f}"
        return f"{goal['id']} {goal['phase']}, {goal['clock_s'] or 0.0:.2f}{end} s"
    return "none" if last is None else f"none; the last one ({last['goal_id']}): {last['sentence']}"


def duration_words(seconds: float) -> str:
    """Such as `2 h 5 min`, `3 min 12 s`, `4.2 s`."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


def timing_rows(report: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Lateness and cycle time in microseconds, a row each: name and the columns of `TIMING_COLUMNS`."""
    return [
        (name, *(f"{report[figure][column]:.1f}" for column in (*PERCENTS, "max")))
        for name, figure in (("wake-up lateness µs", "lateness_us"), ("cycle time µs", "cycle_us"))
    ]


TIMING_COLUMNS = ("p50", "p99", "p99.9", "max")


def timing_table(report: Mapping[str, Any]) -> Table:
    table = Table("timing", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in TIMING_COLUMNS:
        table.add_column(column, justify="right")
    for row in timing_rows(report):
        table.add_row(*row)
    return table
