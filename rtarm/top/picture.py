"""A look drawn into the room that a terminal has: the same look and the same room give the same picture."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style
from rich.text import Text

from rtarm.console.chinese import TIMINGS
from rtarm.console.language import named, said
from rtarm.console.wrapping import wrapped
from rtarm.running.status import DOUBTFUL_BUS, describe_scheduling
from rtarm.running.status_tables import (
    DRIVE_COLUMNS,
    DriveColumn,
    buses_words,
    duration_words,
    goal_words,
    heading,
    shown,
    trouble_words,
)
from rtarm.top.watch import BINS, BINS_A_DECADE, Look
from sentences.drive_words import listed
from sentences.meaning import Language

GAP = 1
"""Blank columns between columns."""
NAME_WIDTH = 12
"""Longer names of joints are cut where there is no room."""
FACT_WIDTH = 9
JOINTS_AT_LEAST = 8
EVENTS_AT_LEAST = 4
NARROW = 60
"""Below so many columns events are told without milliseconds."""
SHORTEST_S = 0.1
"""A rate measured over less is none: one cycle more or less would be most of it."""
BARS = "▁▂▃▄▅▆▇█"
SCALE = (" " + "".join(f"{edge:<{BINS_A_DECADE}}" for edge in ("1", "10", "100", "1ms", "10ms"))).ljust(BINS)
"""Heading of a spectrum, whose first bin ends at 1 µs."""
OF_THE_PAST = Style(dim=True)

Lines = list[list[Segment]]


class Column(NamedTuple):
    """A column of figures: heading, width, the rank by which it is left out, and what it shows of a row."""

    heading: str
    width: int
    rank: int
    cell: Callable[[Any], str]


def _joint_columns(language: Language) -> tuple[Column, ...]:
    def referenced(joint: Mapping[str, Any]) -> str:
        return said(language, "yes") if joint["referenced"] else said(language, "NO")

    return (
        Column(said(language, "measured °"), 10, 0, lambda joint: shown(joint["position_rad"], 3, degrees=True)),
        Column(said(language, "commanded °"), 11, 2, lambda joint: shown(joint["commanded_rad"], 3, degrees=True)),
        Column("°/s", 8, 3, lambda joint: shown(joint["velocity_rad_s"], 2, degrees=True)),
        Column(said(language, "error °"), 9, 1, lambda joint: shown(joint["error_rad"], 4, degrees=True)),
        Column(said(language, "age ms"), 9, 4, lambda joint: shown(joint["age_ms"], 1)),
        Column(said(language, "referenced"), 10, 5, referenced),
    )


def _trouble_column(language: Language) -> Column:
    """While a drive has trouble."""
    return Column(
        said(language, "drive says"), 24, 6, lambda joint: _cut_off(listed(joint["drive_trouble"], language), 24)
    )


def _measured_column(number: int, measured: DriveColumn) -> Column:
    def cell(joint: Mapping[str, Any]) -> str:
        return shown(joint[measured.key], measured.digits)

    return Column(measured.heading, 7, 7 + number, cell)


MEASURED_COLUMNS = tuple(_measured_column(number, one) for number, one in enumerate(DRIVE_COLUMNS))
"""What only some drives measure, in the order of `DRIVE_COLUMNS`: for arms that have such."""
TIMING_COLUMNS = (
    Column("p50", 7, 3, lambda timing: shown(timing.figures["p50"], 1)),
    Column("p99", 7, 1, lambda timing: shown(timing.figures["p99"], 1)),
    Column("p99.9", 8, 2, lambda timing: shown(timing.figures["p99_9"], 1)),
    Column("max", 9, 0, lambda timing: shown(timing.figures["max"], 1)),
    Column(SCALE, BINS, 4, lambda timing: bars(timing.spectrum)),
)


def _cut_off(words: str, width: int) -> str:
    text = Text(words)
    text.truncate(width, overflow="ellipsis")
    return text.plain


class Picture:
    """What rich draws of a look: whole lines, never more than there is room for."""

    def __init__(self, look: Look) -> None:
        self.look = look

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = options.height or options.size.height
        flowing = options.update(height=None)

        def drawn(texts: Sequence[Text]) -> Lines:
            return [line for text in texts for line in console.render_lines(text, flowing, pad=False)]

        for line in _lines(self.look, options.max_width, height, drawn)[:height]:
            yield from line
            yield Segment.line()


def _lines(look: Look, width: int, height: int, drawn: Callable[[Sequence[Text]], Lines]) -> Lines:
    """All lines of the picture; what is most important keeps its room in a small terminal."""
    head, events = drawn([_title(look, width), *_complaints(look, width)]), drawn(_events(look, width))
    report = look.report
    if report is None:
        return head + events
    head = head[: max(1, height // 2)]
    facts, timing = drawn(_facts(look, width)), drawn(_timing(look, width))
    because = drawn(_because(look, width))
    joints = _joints(report["joints"], width, look.language)
    for_joints, for_facts, for_timing, for_because, for_events = share(
        height - len(head),
        [
            (min(len(joints), 1 + JOINTS_AT_LEAST), len(joints)),
            (len(facts), len(facts)),
            (len(timing), len(timing)),
            (len(because), len(because)),
            (min(len(events), EVENTS_AT_LEAST), len(events)),
        ],
    )
    body = (
        facts[:for_facts]
        + drawn(_cut(joints, for_joints, look.language))
        + timing[:for_timing]
        + because[:for_because]
        + events[:for_events]
    )
    if look.trouble is not None:
        body = [list(Segment.apply_style(line, OF_THE_PAST)) for line in body]
    return head + body


def share(room: int, wants: Sequence[tuple[int, int]]) -> list[int]:
    """Share out lines: `wants` says at least and at most how many, the most important first."""
    given = [0] * len(wants)
    for wanted in (0, 1):
        for index, want in enumerate(wants):
            more = max(0, min(want[wanted] - given[index], room))
            given[index] += more
            room -= more
    return given


def _cut(joints: Sequence[Text], room: int, language: Language) -> list[Text]:
    """The table of joints in so many lines; the last one says what is missing."""
    if room >= len(joints) or room < 2:
        return list(joints[:room])
    missing = len(joints) - room + 1
    more = said(language, "… {missing} more: make the terminal higher", missing=missing)
    return [*joints[: room - 1], _line(Text(more, style="dim"))]


def _line(text: Text) -> Text:
    """A line that is cut rather than wrapped."""
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


def _hanging(label: str, words: str, style: str, width: int, label_style: str = "dim") -> Text:
    """A label, and words wrapped beside it."""
    lines = wrapped(words, max(1, width - cell_len(label)))
    return _line(Text.assemble((label, label_style), (("\n" + " " * cell_len(label)).join(lines), style)))


def _padded(words: str, width: int, *, right: bool = False) -> str:
    """So many columns wide, of which a Chinese character takes two."""
    space = " " * (width - cell_len(words))
    return space + words if right else words + space


# --- head -----------------------------------------------------------------------------------------------


def _title(look: Look, width: int) -> Text:
    if look.report is None or look.trouble is not None:
        title = Text.assemble((f"{look.arm}: ", "bold"), (said(look.language, "waiting"), "bold red"))
    else:
        title = heading(look.report, look.language)
    hint = said(look.language, "q ends")
    space = width - cell_len(title.plain) - cell_len(hint)
    if space > 0:
        title.append(" " * space + hint, style="dim")
    return _line(title)


def _complaints(look: Look, width: int) -> list[Text]:
    """Why the arm is not fit to move, or why what is shown is not of now."""
    if look.trouble is not None:
        last = said(look.language, "Waiting; below are the last figures.")
        told = [look.trouble] if look.report is None else [look.trouble, last]
    else:
        told = [] if look.report is None else look.report["problems"]
    return [_hanging("- ", sentence, "yellow", width, "yellow") for sentence in told]


# --- facts ----------------------------------------------------------------------------------------------


def _facts(look: Look, width: int) -> list[Text]:
    report, recent = look.report, look.recent
    assert report is not None and recent is not None
    language = look.language
    rows = (
        (
            said(language, "goal"),
            said(
                language,
                "{goal}; speed scale {scale:.2f}",
                goal=goal_words(report, language).rstrip(".。"),
                scale=report["speed_scale"],
            ),
            "",
        ),
        (
            said(language, "cycles"),
            said(
                language,
                "{cycles} at {rate:g} Hz, {overruns} overruns ({recent} in the {span})",
                cycles=report["cycles"],
                rate=report["rate_hz"],
                overruns=report["overruns"],
                recent=recent["overruns"],
                span=look.recent_span,
            ),
            "red" if recent["overruns"] else "",
        ),
        (said(language, "bus"), *_bus(report["bus"], recent["bus"], look)),
        *_buses(recent, language),
        ("ROS", *_front(report["front"], language)),
        (
            said(language, "control"),
            said(
                language,
                "pid {pid}, up {uptime}, {scheduling}",
                pid=report["loop"]["pid"],
                uptime=duration_words(report["uptime_s"]),
                scheduling=describe_scheduling(report["scheduling"], language),
            ),
            "",
        ),
    )
    return [_hanging(_padded(name, FACT_WIDTH), words, style, width) for name, words, style in rows]


def _bus(total: Mapping[str, Any], recent: Mapping[str, Any], look: Look) -> tuple[str, str]:
    """Load and frames of the last seconds, and everything that ever went wrong."""
    language, seconds = look.language, look.recent_s
    if recent["load"] is None:
        words = [said(language, "no bus")]
    elif seconds < SHORTEST_S:
        words = [said(language, "being measured")]
    else:
        words = [
            said(language, "load {load:.1%}", load=recent["load"]),
            said(language, "{sent:.0f} frames/s sent", sent=recent["frames_tx"] / seconds),
            said(language, "{received:.0f} received", received=recent["frames_rx"] / seconds),
        ]
    trouble, new_trouble = trouble_words(total, language), trouble_words(recent, language)
    if trouble and new_trouble:
        words.append(
            said(language, "{all} ({recent} in the {span})", all=trouble, recent=new_trouble, span=look.recent_span)
        )
    elif trouble:
        words.append(trouble)
    return said(language, ", ").join(words), "red" if new_trouble else ""


def _buses(recent: Mapping[str, Any], language: Language) -> list[tuple[str, str, str]]:
    """Load of the last seconds and state of each of several buses."""
    if "buses" not in recent:
        return []
    doubtful = any(bus["state"] in DOUBTFUL_BUS for bus in recent["buses"])
    return [(said(language, "buses"), buses_words(recent["buses"], language), "red" if doubtful else "")]


def _front(front: Mapping[str, Any], language: Language) -> tuple[str, str]:
    """Whether a ROS process serves the arm."""
    pid, age_ms = front["pid"], front["heartbeat_age_ms"]
    if pid is None:
        return said(language, "no process serves the arm"), "red"
    if age_ms is None:
        return said(language, "pid {pid}, no sign of life yet", pid=pid), ""
    return said(language, "pid {pid}, alive {age:.0f} ms ago", pid=pid, age=age_ms), ""


# --- tables ---------------------------------------------------------------------------------------------


def fitting(columns: Sequence[Column], width: int) -> list[Column]:
    """The columns that fit side by side, in their order; those of the highest rank are left out first."""
    chosen: list[Column] = []
    for column in sorted(columns, key=lambda one: one.rank):
        width -= column.width + GAP
        if width < 0:
            break
        chosen.append(column)
    return [column for column in columns if column in chosen]


def _table(
    first: str, first_width: int, columns: Sequence[Column], rows: Sequence[tuple[str, Any, str]], width: int
) -> list[Text]:
    """Heading and rows; a row is its label, what its cells are made of, and a style."""
    columns = fitting(columns, width - first_width)

    def line(label: str, cells: Sequence[str], style: str) -> Text:
        text = Text(label, style=style)
        text.truncate(first_width, overflow="ellipsis", pad=True)
        for column, cell in zip(columns, cells, strict=True):
            text.append(" " * GAP + _padded(cell, column.width, right=True))
        return _line(text)

    head = line(first, [column.heading for column in columns], "dim")
    return [head, *(line(label, [column.cell(row) for column in columns], style) for label, row, style in rows)]


def joint_columns(joints: Sequence[Mapping[str, Any]], language: Language = "en") -> list[Column]:
    """The columns that have something to show."""
    measured = zip(DRIVE_COLUMNS, MEASURED_COLUMNS, strict=True)
    columns = [column for one, column in measured if any(joint[one.key] is not None for joint in joints)]
    troubled = any(joint["drive_trouble"] for joint in joints)
    return [*_joint_columns(language), *columns, *([_trouble_column(language)] if troubled else [])]


def _joints(joints: Sequence[Mapping[str, Any]], width: int, language: Language) -> list[Text]:
    rows = [(joint["name"], joint, "" if joint["referenced"] else "red") for joint in joints]
    head = said(language, "joint")
    longest = max(cell_len(name) for name in (head, *(name for name, _, _ in rows)))
    columns = joint_columns(joints, language)
    spare = width - sum(column.width + GAP for column in columns)
    return _table(head, min(longest, max(NAME_WIDTH, spare)), columns, rows, width)


def _timing(look: Look, width: int) -> list[Text]:
    rows = [(f"{named(look.language, TIMINGS, one.what)} {one.span}", one, "") for one in look.timings]
    longest = max((cell_len(label) for label, _, _ in rows), default=0)
    return _table("µs", longest, TIMING_COLUMNS, rows, width)


def _because(look: Look, width: int) -> list[Text]:
    """Why cycles were late, or one line why that is not known."""
    if look.why is None:
        return []
    language, heading = look.language, said(look.language, "late because")
    if look.why.hint:
        return [_hanging(f"{heading}: ", look.why.hint, "dim", width)]
    columns = (
        Column(said(language, "share"), 6, 0, lambda one: f"{one.share:.0%}"),
        Column(said(language, "chiefly"), 8, 2, lambda one: str(one.cycles)),
        Column(said(language, "worst µs"), 9, 1, lambda one: shown(one.worst_us, 0)),
    )
    rows = [(said(language, ", ").join(filter(None, (one.cause, one.who))), one, "") for one in look.why.causes]
    longest = max(cell_len(label) for label in (heading, *(label for label, _, _ in rows)))
    spare = width - sum(column.width + GAP for column in columns)
    return _table(heading, min(longest, max(NAME_WIDTH, spare)), columns, rows, width)


def bars(counts: Sequence[int]) -> str:
    """A bar for each bin, its height the logarithm of the count, so that a single late cycle is seen."""
    most = max(counts, default=0)
    scale = (len(BARS) - 1) / math.log(most) if most > 1 else 0.0
    return "".join(BARS[round(math.log(count) * scale)] if count > 0 else " " for count in counts)


# --- events ---------------------------------------------------------------------------------------------


def _events(look: Look, width: int) -> list[Text]:
    """Newest first; sentences are wrapped, since a fault's tells what to do only at its end."""
    return [
        _hanging(_clock(one.monotonic_ns + look.epoch_offset_ns, width) + "  ", one.sentence, one.style, width)
        for one in look.happenings
    ]


def _clock(epoch_ns: int, width: int) -> str:
    """Local time of day."""
    seconds, rest_ns = divmod(epoch_ns, 1_000_000_000)
    told = time.strftime("%H:%M:%S", time.localtime(seconds))
    return told if width < NARROW else f"{told}.{rest_ns // 1_000_000:03d}"
