"""What was found, as one object and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rtarm.console.chinese import CAUSE_MEANINGS, CAUSES, WHY_LATE
from rtarm.console.language import said
from rtarm.why_late.causes import MEANINGS, WORDS, Cause
from rtarm.why_late.watch import Late, Watcher
from sentences.meaning import Language

WOKE_LATE = "woke up late"
NAMES = 500
MOSTLY = 3
"""Names that are told of a cause, those with most time first."""
BAR = 24


class Tally:
    """Late cycles summed up by their causes, as many as there may be."""

    def __init__(self) -> None:
        self._took_ns: Counter[Cause] = Counter()
        self._cycles: Counter[Cause] = Counter()
        self._names: dict[Cause, Counter[str]] = {}
        self._worst: dict[Cause, Late] = {}

    def add(self, late: Late) -> None:
        """One more."""
        chief = late.cause
        self._cycles[chief] += 1
        if chief not in self._worst or late.length_ns > self._worst[chief].length_ns:
            self._worst[chief] = late
        for (cause, who), length_ns in late.by_name.items():
            self._took_ns[cause] += length_ns
            if who:
                self._name(self._names.setdefault(cause, Counter()), who, length_ns)

    @staticmethod
    def _name(names: Counter[str], who: str, length_ns: int) -> None:
        names[who] += length_ns
        if len(names) > 2 * NAMES:  # each process that comes and goes has one of its own
            for rare, _ in names.most_common()[NAMES:]:
                del names[rare]

    def causes(self) -> list[dict[str, Any]]:
        """Causes by the share that they have of all late time, the largest first."""
        total_ns = self._took_ns.total()
        return [
            {
                "cause": cause.value,
                "cycles": self._cycles[cause],
                "us": took_ns / 1000,
                "share": took_ns / total_ns,
                "mostly": [
                    {"who": who, "us": ns / 1000} for who, ns in self._names.get(cause, Counter()).most_common(MOSTLY)
                ],
                "worst": _plain(self._worst[cause]) if cause in self._worst else None,
            }
            for cause, took_ns in self._took_ns.most_common()
        ]


def causes_of(late: Iterable[Late]) -> list[dict[str, Any]]:
    """Causes by the share that they have of all late time, the largest first."""
    tally = Tally()
    for one in late:
        tally.add(one)
    return tally.causes()


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
        "what": WOKE_LATE if late.woke else "took long",
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


def render(report: Mapping[str, Any], language: Language = "en") -> RenderableType:
    """The same for a person."""
    given = {
        "arm": report["arm"],
        "cycles": report["cycles"],
        "seconds": report["seconds"],
        "bound": report["bound_us"],
        "late": report["late"],
        "together": _us(report["late_us"]),
    }
    if not report["late"]:
        none = said(language, "{arm}: {cycles} cycles in {seconds:.0f} s, none later than {bound:g} µs.", **given)
        return Group(Text(none), *_remarks(report, language))
    heading = said(
        language,
        "{arm}: {cycles} cycles in {seconds:.0f} s, {late} later than {bound:g} µs, {together} µs together",
        **given,
    )
    examples = [_example(one, language) for one in report["causes"]]
    return Group(Text(heading), _table(report["causes"], language), *examples, *_remarks(report, language))


def cause_word(cause: str, language: Language) -> str:
    """A cause, by its name in JSON, in words."""
    return WORDS[Cause(cause)] if language == "en" else CAUSES[cause]


def names_told(english: str, language: Language) -> str:
    """Names of tasks, interrupts and counters as they are, with what is said about them in a language."""
    for phrase, chinese in WHY_LATE.items() if language == "zh" else ():
        english = english.replace(phrase, chinese)
    return english


def _table(causes: Sequence[Mapping[str, Any]], language: Language) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(said(language, "cause"))
    for column in (said(language, "share"), said(language, "chiefly"), "µs"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column(said(language, "mostly"))
    for one in causes:
        who = names_told(one["mostly"][0]["who"], language) if one["mostly"] else ""
        cycles = str(one["cycles"]) if one["cycles"] else ""
        words = cause_word(one["cause"], language)
        table.add_row(Text(words), f"{one['share']:.1%}", cycles, _us(one["us"]), Text(who))
    return table


def _example(one: Mapping[str, Any], language: Language) -> RenderableType:
    """The worst of those that a cause is the chief one of, as a time line."""
    worst, cause = one["worst"], one["cause"]
    if worst is None:
        return Group()
    meaning = MEANINGS[Cause(cause)] if language == "en" else CAUSE_MEANINGS[cause]
    found = {"cycle": worst["cycle"], "length": _us(worst["us"])}
    lines = [
        Text(said(language, "{cause}: {meaning}", cause=cause_word(cause, language), meaning=meaning), style="bold"),
        Text(
            said(language, "  the worst: cycle {cycle} woke up late, {length} µs", **found)
            if worst["what"] == WOKE_LATE
            else said(language, "  the worst: cycle {cycle} took long, {length} µs", **found)
        ),
    ]
    for segment in worst["segments"]:
        begin = round(BAR * segment["at_us"] / worst["us"])
        length = max(1, round(BAR * segment["us"] / worst["us"]))
        bar = (" " * min(begin, BAR - 1) + "█" * length)[:BAR].ljust(BAR)
        parts = [cause_word(segment["cause"], language), names_told(segment["who"], language)]
        lines.append(Text(f"  {bar} {_us(segment['us']):>7}  {said(language, ', ').join(filter(None, parts))}"))
    return Group(*lines, Text())


def _remarks(report: Mapping[str, Any], language: Language) -> list[RenderableType]:
    lines = list(report["notes"])
    if report["undivided"]:
        lines.append(
            said(
                language,
                "{undivided} late cycles were too many, and were not looked into.",
                undivided=report["undivided"],
            )
        )
    if report["hints"]:
        lines.append(
            said(
                language,
                "Counters that rose faster while cycles were late (hints, no causes), and otherwise, in 50 ms:",
            )
        )
        for one in report["hints"]:
            late, other = (f"{one[key]:g}" for key in ("a_look_with_late_cycles", "a_look_without"))
            what = names_told(one["what"], language)
            lines.append(said(language, "  {late} and {other}  {what}", late=late, other=other, what=what))
    return [Text(line) for line in lines]


def _us(value: float) -> str:
    return f"{value:.{1 if value < 100 else 0}f}"
