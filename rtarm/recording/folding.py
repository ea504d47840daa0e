"""What repeats in a story is said once, with how often, until when, and between which values."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from rtarm.console.language import said
from rtarm.recording.story import Line
from sentences.meaning import Language

WITHIN_S = 2.0
"""Lines of a kind that follow each other within this are repeats."""
FEWEST = 3
"""Fewer are told as they are."""
_VALUE = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?![\w.]*\w)")
"""A number in a sentence that is no part of a name."""


def folded(
    lines: Sequence[Line], apart: Sequence[int], when: Callable[[int], str], language: Language = "en"
) -> list[Line]:
    """The lines, a run of repeats in the place of its first one.

    A repeat says the same as the one before of its kind, but for its values. Nothing else disappears, and what is told
    keeps its order.

    Args:
        lines: in the order of their times.
        apart: instants (ns), such as a fault's, whose lines stay as they are and which no run goes beyond.
        when: an instant (ns) in words.
        language: of the lines.
    """
    runs = _runs(lines, apart)
    return [
        _as_one(run, when, language) if len(run) >= FEWEST else line
        for line, run in zip(lines, runs, strict=True)
        if len(run) < FEWEST or line is run[0]
    ]


def _runs(lines: Sequence[Line], apart: Sequence[int]) -> list[list[Line]]:
    """For each line the run that it belongs to, itself in it."""
    runs: list[list[Line]] = []
    newest: dict[object, list[Line]] = {}
    for line in lines:
        side = sum(line.monotonic_ns >= instant for instant in apart)
        kind = (_VALUE.sub("#", line.sentence), line.style, line.sign, line.joint, side)
        run = newest.get(kind)
        alone = line.monotonic_ns in apart
        if run is None or line.monotonic_ns - run[-1].monotonic_ns > WITHIN_S * 1e9:
            run = []
        if not alone:
            newest[kind] = run
        run.append(line)
        runs.append(run)
    return runs


def _as_one(run: Sequence[Line], when: Callable[[int], str], language: Language) -> Line:
    values = iter(zip(*(_VALUE.findall(line.sentence) for line in run), strict=True))
    sentence = _VALUE.sub(lambda _: _range(next(values), language), run[0].sentence)
    last_ns = run[-1].monotonic_ns
    once = said(language, "{n} times until {when}: {sentence}", n=len(run), when=when(last_ns), sentence=sentence)
    return run[0]._replace(sentence=once, end_ns=max(last_ns, run[-1].end_ns))


def _range(values: Sequence[str], language: Language) -> str:
    least, most = min(values, key=float), max(values, key=float)
    return least if least == most else said(language, "{least} to {most}", least=least, most=most)
