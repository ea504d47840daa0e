"""Curves in panels: a column for each case, a row for each quantity, one axis of time for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from handbook.pictures.svg import BLUE, FAINT, GREY, GRID, ORANGE, RED, Drawing, Point

LEFT, TOP, RIGHT, BOTTOM = 62.0, 56.0, 10.0, 60.0
ROW_PX, GAP_X, GAP_Y = 110.0, 14.0, 20.0
WIDTH = 780.0
ROUNDING = 1e-9


@dataclass(frozen=True)
class Axis:
    """A quantity, the range that is shown of it and the distance of its ticks."""

    name: str
    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Curve:
    """One quantity over time."""

    times_s: np.ndarray
    values: np.ndarray


@dataclass
class Case:
    """A column: for each row its curve, and what is drawn beside it."""

    title: Sequence[str]
    curves: Sequence[Curve]
    beside: Sequence[Curve] = ()
    """For each row what the curve is compared with, in grey."""
    points: Sequence[Curve] = ()
    """For each row what the goal's points have of it."""
    limits: Sequence[Sequence[float]] = ((), (), ())
    """For each row values at which a dashed line is drawn."""
    moments: dict[float, str] = field(default_factory=dict)
    """Times at which a line is drawn from top to bottom, and its name."""


def panels(
    cases: Sequence[Case], rows: Sequence[Axis], time: Axis, legend: Sequence[tuple[str, str]], in_words: str
) -> str:
    """The picture of some cases; `legend` names kinds of lines ("curve", "beside", "point", "limit")."""
    column_px = (WIDTH - LEFT - RIGHT - GAP_X * (len(cases) - 1)) / len(cases)
    height = TOP + len(rows) * ROW_PX + (len(rows) - 1) * GAP_Y + BOTTOM
    drawing = Drawing(WIDTH, height, in_words)
    for number, case in enumerate(cases):
        left = LEFT + number * (column_px + GAP_X)
        drawing.lines((left + column_px / 2, 22), case.title)
        for row, axis in enumerate(rows):
            panel = _Panel(drawing, (left, TOP + row * (ROW_PX + GAP_Y)), column_px, time, axis)
            panel.frame(names=number == 0, times=row == len(rows) - 1)
            for value in case.limits[row]:
                panel.draw(Curve(np.array([time.low, time.high]), np.array([value, value])), RED, 1, "5 3")
            for moment in case.moments:
                panel.draw(Curve(np.array([moment, moment]), np.array([axis.low, axis.high])), ORANGE, 1, "2 2")
            if case.beside:
                panel.draw(case.beside[row], GREY, 1.2, "")
            panel.draw(case.curves[row], BLUE, 1.8, "")
            if case.points:
                panel.dots(case.points[row])
            if row == 0:
                for moment, text in case.moments.items():
                    drawing.text((panel.x(moment), TOP - 4), text, color=ORANGE, size=12)
    drawing.text((LEFT + (WIDTH - LEFT - RIGHT) / 2, height - 30), time.name, color=FAINT)
    _legend(drawing, legend, height - 10)
    return drawing.svg()


class _Panel:
    """One quantity of one case."""

    def __init__(self, drawing: Drawing, corner: Point, width: float, time: Axis, axis: Axis) -> None:
        self._drawing, self._corner, self._width = drawing, corner, width
        self._time, self._axis = time, axis

    def x(self, time_s: float) -> float:
        """Where a time stands."""
        return self._corner[0] + self._width * (time_s - self._time.low) / (self._time.high - self._time.low)

    def y(self, value: float) -> float:
        """Where a value stands; raises ValueError for one that the axis does not show."""
        axis = self._axis
        if not axis.low - ROUNDING <= value <= axis.high + ROUNDING:
            raise ValueError(f"{axis.name} {value:g} is off its axis, {axis.low:g} to {axis.high:g}")
        return self._corner[1] + ROW_PX * (axis.high - value) / (axis.high - axis.low)

    def frame(self, *, names: bool, times: bool) -> None:
        """The box with its ticks; `names` says which quantity it is, `times` writes the times below."""
        left, top = self._corner
        for value in _ticks(self._axis):
            self._drawing.line([(left, self.y(value)), (left + self._width, self.y(value))], color=GRID, width=1)
            if names:
                self._drawing.text((left - 6, self.y(value) + 4), f"{value:g}", anchor="end", color=FAINT, size=11)
        for value in _ticks(self._time):
            self._drawing.line([(self.x(value), top), (self.x(value), top + ROW_PX)], color=GRID, width=1)
            if times:
                self._drawing.text((self.x(value), top + ROW_PX + 15), f"{value:g}", color=FAINT, size=11)
        self._drawing.box(self._corner, (self._width, ROW_PX), color=FAINT)
        if names:
            self._drawing.text((14, top + ROW_PX / 2), self._axis.name, color=FAINT, size=12, turn=-90)

    def draw(self, curve: Curve, color: str, width: float, dash: str) -> None:
        """A curve."""
        points = [(self.x(t), self.y(v)) for t, v in zip(curve.times_s.tolist(), curve.values.tolist(), strict=True)]
        self._drawing.line(points, color=color, width=width, dash=dash)

    def dots(self, curve: Curve) -> None:
        """The same as single points."""
        for time_s, value in zip(curve.times_s.tolist(), curve.values.tolist(), strict=True):
            self._drawing.dot((self.x(time_s), self.y(value)), 3.2, fill="#fff", color=ORANGE)


def _ticks(axis: Axis) -> list[float]:
    """Multiples of an axis' step within its range; + 0.0 makes 0 of -0."""
    first = np.ceil(axis.low / axis.step - ROUNDING)
    last = np.floor(axis.high / axis.step + ROUNDING)
    return [float(axis.step * count) + 0.0 for count in np.arange(first, last + 1)]


def _legend(drawing: Drawing, legend: Sequence[tuple[str, str]], y: float) -> None:
    x = LEFT
    for kind, text in legend:
        if kind == "point":
            drawing.dot((x + 12, y - 4), 3.2, fill="#fff", color=ORANGE)
        else:
            color, width, dash = {"curve": (BLUE, 1.8, ""), "beside": (GREY, 1.2, ""), "limit": (RED, 1, "5 3")}[kind]
            drawing.line([(x, y - 4), (x + 24, y - 4)], color=color, width=width, dash=dash)
        drawing.text((x + 30, y), text, anchor="start", size=12.5)
        x += 50 + 7 * len(text)
