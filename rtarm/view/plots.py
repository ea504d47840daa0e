"""The plots beside the arm: position, error and lateness of the last half minute."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rtarm.view.history import COLUMN_NS, COLUMNS, Curves
from rtarm.view.words import Words

if TYPE_CHECKING:
    import viser

HEIGHT_PX = 150
COLOURS = ("#2878dc", "#e67700", "#2b8a3e", "#c92a2a", "#7048e8", "#0c8599", "#a61e4d", "#5c940d")
IS, OUGHT = "#3e4c59", "#2878dc"
ANGLES_DEG, ERRORS_DEG, LATENESS_US = (-1.0, 1.0), (-0.05, 0.05), (0.0, 200.0)
"""What each plot shows at the least, so that noise about nothing looks like nothing."""
_SPAN_S = COLUMNS * COLUMN_NS * 1e-9
_PADDING = (6, 12, 0, 8)


class Plots:
    """Five plots of which three are seen: for one joint with what was commanded, or for all joints."""

    def __init__(self, server: viser.ViserServer, joints: Sequence[str], words: Words) -> None:
        self._joints = list(joints)
        self._all = words.all_joints
        gui = server.gui
        self._choice = gui.add_dropdown(words.which_joint, [self._all, *self._joints], initial_value=self._all)
        of_all = [(name, COLOURS[index % len(COLOURS)]) for index, name in enumerate(self._joints)]
        of_one = [(words.measured, IS), (words.commanded, OUGHT)]
        self._position_all = _plot(gui, words.position_plot, of_all, words, ANGLES_DEG)
        self._position_one = _plot(gui, words.position_plot, of_one, words, ANGLES_DEG, visible=False)
        self._error_all = _plot(gui, words.error_plot, of_all, words, ERRORS_DEG)
        self._error_one = _plot(gui, words.error_plot, of_one[:1], words, ERRORS_DEG, visible=False)
        self._lateness = _plot(gui, words.lateness_plot, [(words.late, "#7048e8")], words, LATENESS_US)

    def update(self, curves: Curves) -> None:
        """Draw what there is now; an empty history leaves the plots as they are."""
        if len(curves.times_s) == 0:
            return
        chosen = self._choice.value
        of_all = chosen not in self._joints
        for plot, visible in (
            (self._position_all, of_all),
            (self._error_all, of_all),
            (self._position_one, not of_all),
            (self._error_one, not of_all),
        ):
            if plot.visible != visible:
                plot.visible = visible
        times_s = curves.times_s
        if of_all:
            self._position_all.data = (times_s, *_rows(curves.measured_deg))
            self._error_all.data = (times_s, *_rows(curves.error_deg))
        else:
            index = self._joints.index(chosen)
            measured_deg, commanded_deg = curves.measured_deg[:, index], curves.commanded_deg[:, index]
            self._position_one.data = (times_s, np.array(measured_deg), np.array(commanded_deg))
            self._error_one.data = (times_s, np.array(curves.error_deg[:, index]))
        self._lateness.data = (times_s, curves.lateness_us)


def _rows(table: np.ndarray) -> list[np.ndarray]:
    return [np.ascontiguousarray(row) for row in table.T]


def _around(soft: tuple[float, float]) -> Any:
    """A range that fits the data and never shows less than `soft`."""
    low, high = ({"pad": 0.1, "soft": edge, "mode": 1} for edge in soft)
    return {"min": low, "max": high}


def _plot(
    gui: viser.GuiApi,
    title: str,
    series: Sequence[tuple[str, str]],
    words: Words,
    soft: tuple[float, float],
    *,
    visible: bool = True,
) -> viser.GuiUplotHandle:
    from viser import uplot

    nothing = np.zeros(0)
    return gui.add_uplot(
        (nothing,) * (1 + len(series)),
        (
            uplot.Series(label=words.seconds),
            *(uplot.Series(label=label, stroke=colour, width=1.5) for label, colour in series),
        ),
        title=title,
        scales={"x": uplot.Scale(time=False, range=(-_SPAN_S, 0.0)), "y": uplot.Scale(range=_around(soft))},
        legend=uplot.Legend(show=len(series) > 1),
        cursor=uplot.Cursor(drag=uplot.Cursor_Drag(x=True, y=False, setScale=True)),
        height=HEIGHT_PX,
        padding=_PADDING,
        visible=visible,
    )
