"""A report of `rtarm.running.status` for people: tables and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rtarm.console.chinese import BUS_STATES, BUS_TROUBLES, GRIPS, MODES, PHASES
from rtarm.console.language import named, said
from rtarm.console.wrapping import Sentence
from rtarm.running.status import PERCENTS, describe_scheduling
from sentences.drive_words import listed
from sentences.meaning import Language
from shm.layout import BUS_TROUBLE

if TYPE_CHECKING:
    from rtarm.running.referencing import Reading


def render_status(report: Mapping[str, Any], language: Language = "en") -> RenderableType:
    """The report, made in the same language, as tables that fit 80 columns."""
    return Group(
        heading(report, language),
        *(Sentence(Text(f"- {sentence}", style="yellow")) for sentence in report["problems"]),
        _joints_table(report["joints"], language),
        *_drives_table(report["joints"], language),
        _facts_table(report, language),
        timing_table(report, language),
    )


def heading(report: Mapping[str, Any], language: Language = "en") -> Text:
    """Arm, mode and whether it is fit to move, in one line."""
    return Text.assemble(
        (said(language, "{arm}: {mode}", arm=report["arm"], mode=named(language, MODES, report["mode"])), "bold"),
        said(language, ", "),
        (said(language, "healthy"), "green") if report["healthy"] else (said(language, "not fit to move"), "bold red"),
    )


def _joints_table(joints: Sequence[Mapping[str, Any]], language: Language) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(said(language, "joint"))
    for column in (
        said(language, "measured °"),
        "rad",
        "°/s",
        said(language, "commanded °"),
        said(language, "age ms"),
    ):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column(said(language, "referenced"))
    for joint in joints:
        position, velocity = joint["position_rad"], joint["velocity_rad_s"]
        table.add_row(
            joint["name"],
            shown(position, 3, degrees=True),
            shown(position, 5),
            shown(velocity, 2, degrees=True),
            shown(joint["commanded_rad"], 3, degrees=True),
            shown(joint["age_ms"], 1),
            said(language, "yes") if joint["referenced"] else said(language, "NO"),
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


def _drives_table(joints: Sequence[Mapping[str, Any]], language: Language) -> Iterator[Table]:
    """What drives measure beside where they are, and what is wrong with them, where there is any of it."""
    columns = [column for column in DRIVE_COLUMNS if any(joint[column.key] is not None for joint in joints)]
    if not columns and not any(joint["drive_trouble"] for joint in joints):
        return
    table = Table(said(language, "drive of"), box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column.heading, justify="right", no_wrap=True)
    table.add_column(said(language, "says"))
    for joint in joints:
        figures = [shown(joint[column.key], column.digits) for column in columns]
        table.add_row(joint["name"], *figures, listed(joint["drive"], language) or "-")
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


def gripper_words(gripper: Mapping[str, Any], language: Language = "en") -> str:
    """The same in words: what it does and where, or what is wrong with it."""
    if gripper["trouble"] is not None:
        return str(gripper["trouble"])
    grip, at_deg = named(language, GRIPS, gripper["grip"]), shown(gripper["position_rad"], 1, degrees=True)
    return said(language, "{grip} at {at}°", grip=grip, at=at_deg)


def shown(value: float | None, digits: int, *, degrees: bool = False) -> str:
    """A figure in so many decimals (with `degrees`: radians as degrees), or that there is none."""
    if value is None:
        return "-"
    return f"{math.degrees(value) if degrees else value:.{digits}f}"


def _facts_table(report: Mapping[str, Any], language: Language) -> Table:
    bus, front = report["bus"], report["front"]
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    table.add_row(said(language, "goal"), Sentence(Text(goal_words(report, language))))
    table.add_row(said(language, "speed scale"), f"{report['speed_scale']:.2f}")
    if report["gripper"] is not None:
        gripper = gripper_words(report["gripper"], language)
        table.add_row(said(language, "gripper"), Sentence(Text(gripper)))
    served = said(language, "none") if front["pid"] is None else f"pid {front['pid']}"
    processes = said(
        language,
        "control pid {pid}, ROS {served}, up {uptime}",
        pid=report["loop"]["pid"],
        served=served,
        uptime=duration_words(report["uptime_s"]),
    )
    table.add_row(said(language, "processes"), Sentence(Text(processes)))
    cycles = said(
        language,
        "{cycles} at {rate:g} Hz, {overruns} overruns",
        cycles=report["cycles"],
        rate=report["rate_hz"],
        overruns=report["overruns"],
    )
    table.add_row(said(language, "cycles"), cycles)
    scheduling = describe_scheduling(report["scheduling"], language)
    table.add_row(said(language, "scheduling"), Sentence(Text(scheduling)))
    frames = said(language, "{sent} frames sent, {received} received", sent=bus["frames_tx"], received=bus["frames_rx"])
    load = "" if bus["load"] is None else said(language, ", load {load:.1%}", load=bus["load"])
    table.add_row(said(language, "bus"), f"{frames}{load}")
    if "buses" in report:
        table.add_row(said(language, "buses"), Sentence(Text(buses_words(report["buses"], language))))
    trouble = trouble_words(bus, language)
    if trouble:
        table.add_row(said(language, "bus trouble"), Sentence(Text(trouble)))
    return table


def buses_words(buses: Sequence[Mapping[str, Any]], language: Language = "en") -> str:
    """Load and state of each of several buses, by its name."""
    each = (
        said(
            language,
            "{bus} {state}, load {load:.1%}",
            bus=bus["name"],
            state=named(language, BUS_STATES, bus["state"]),
            load=bus["load"] or 0.0,
        )
        for bus in buses
    )
    return said(language, "; ").join(each)


def trouble_words(bus: Mapping[str, Any], language: Language = "en") -> str:
    """What went wrong on the bus, counted; empty when nothing did."""
    counted = (f"{bus[name]} {named(language, BUS_TROUBLES, name)}" for name in BUS_TROUBLE if bus[name])
    return said(language, ", ").join(counted)


def goal_words(report: Mapping[str, Any], language: Language = "en") -> str:
    """Where the goal stands, or how the last one ended."""
    goal, last = report["goal"], report["last_result"]
    if goal is not None:
        stands = {"id": goal["id"], "phase": named(language, PHASES, goal["phase"]), "clock": goal["clock_s"] or 0.0}
        if goal["duration_s"] is None:
            return said(language, "{id} {phase}, {clock:.2f} s", **stands)
        return said(language, "{id} {phase}, {clock:.2f} of {end:.2f} s", end=goal["duration_s"], **stands)
    if last is None:
        return said(language, "none")
    return said(language, "none; the last one ({id}): {sentence}", id=last["goal_id"], sentence=last["sentence"])


def duration_words(seconds: float) -> str:
    """Such as `2 h 5 min`, `3 min 12 s`, `4.2 s`, in every language."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


def timing_rows(report: Mapping[str, Any], language: Language = "en") -> list[tuple[str, ...]]:
    """Lateness and cycle time in microseconds, a row each: name and the columns of `TIMING_COLUMNS`."""
    return [
        (name, *(f"{report[figure][column]:.1f}" for column in (*PERCENTS, "max")))
        for name, figure in (
            (said(language, "wake-up lateness µs"), "lateness_us"),
            (said(language, "cycle time µs"), "cycle_us"),
        )
    ]


TIMING_COLUMNS = ("p50", "p99", "p99.9", "max")


def timing_table(report: Mapping[str, Any], language: Language = "en") -> Table:
    table = Table(said(language, "timing"), box=box.SIMPLE_HEAD, pad_edge=False)
    for column in TIMING_COLUMNS:
        table.add_column(column, justify="right")
    for row in timing_rows(report, language):
        table.add_row(*row)
    return table
