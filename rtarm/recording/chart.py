"""A joint's motion drawn with characters: any terminal shows it, and so does a message in a chat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rtarm.console.language import said
from sentences.meaning import Language
from shm.recording import Recording

LABEL = 10
"""Columns of the figures at the left edge."""
BEFORE_S, AFTER_S = 1.5, 1.0
MARK, AXIS = "┊", "│"


class Series(NamedTuple):
    """What is drawn: a character, and its points in time (s) and value."""

    symbol: str
    times_s: np.ndarray
    values: np.ndarray


LEAST_MARGIN = 1e-4
"""Above and below what hardly changes: as much as its labels can tell."""


def chart(series: Sequence[Series], span_s: tuple[float, float], width: int, height: int) -> list[str]:
    """Lines of text: later series over earlier ones, a mark at the time 0, the times below."""
    columns = max(width - LABEL - 2, 10)
    inside = [one.values[(one.times_s >= span_s[0]) & (one.times_s <= span_s[1])] for one in series]
    shown = np.concatenate(inside)
    shown = shown[np.isfinite(shown)]
    if len(shown) == 0:
        return []
    low, high = float(shown.min()), float(shown.max())
    margin = max(0.05 * (high - low), LEAST_MARGIN)
    low, high = low - margin, high + margin
    grid = [[" "] * columns for _ in range(height)]

    def column(time_s: float) -> int:
        return round((time_s - span_s[0]) / (span_s[1] - span_s[0]) * (columns - 1))

    if span_s[0] <= 0.0 <= span_s[1]:
        for row in grid:
            row[column(0.0)] = MARK
    for one in series:
        for time_s, value in zip(one.times_s.tolist(), one.values.tolist(), strict=True):
            if span_s[0] <= time_s <= span_s[1] and math.isfinite(value):
                grid[round((high - value) / (high - low) * (height - 1))][column(time_s)] = one.symbol
    labels = {0: high, height // 2: (low + high) / 2, height - 1: low}
    drawn = [
        f"{f'{labels[number]:.4f}' if number in labels else '':>{LABEL}} {AXIS}{''.join(row).rstrip()}"
        for number, row in enumerate(grid)
    ]
    return [*drawn, _times(span_s, columns)]


def _times(span_s: tuple[float, float], columns: int) -> str:
    left, right = f"{span_s[0]:+.2f} s", f"{span_s[1]:+.2f} s"
    line = left + " " * max(columns - len(left) - len(right), 1) + right
    zero = round(-span_s[0] / (span_s[1] - span_s[0]) * (columns - 1))
    if len(left) < zero < columns - len(right):
        line = f"{line[:zero]}0{line[zero + 1 :]}"
    return " " * (LABEL + 2) + line


def joint_charts(recording: Recording, joint: int, zero_ns: int, width: int, language: Language = "en") -> list[str]:
    """Position commanded and measured of a joint around an instant, and below it the error."""
    records = recording.records
    times_s = (records["monotonic_ns"] - zero_ns) * 1e-9
    rows = records["joints"][:, joint]
    _, first = np.unique(rows["measured_ns"], return_index=True)  # a reading is drawn once, where it was taken
    read = rows[np.sort(first)]
    read = read[read["measured_ns"] > 0]
    read_s = (read["measured_ns"] - zero_ns) * 1e-9
    span_s = max(-BEFORE_S, float(times_s[0])), min(AFTER_S, float(times_s[-1]))
    if span_s[1] <= span_s[0]:
        return []
    commanded = Series("·", times_s, rows["commanded_position_rad"])
    measured = Series("●", read_s, read["measured_position_rad"])
    error = Series("●", read_s, read["measured_position_rad"] - read["reference_position_rad"])
    name = recording.joints[joint]
    allowed = float(recording.limits["following_error_rad"])
    drawn = chart([commanded, measured], span_s, width, 12)
    below = chart([error], span_s, width, 7)
    head = [said(language, "Position of {joint} (rad): · commanded, ● measured", joint=name)] if drawn else []
    between = ["", said(language, "Its error (rad; {allowed:.4f} are allowed)", allowed=allowed)] if below else []
    return [*head, *drawn, *between, *below]
