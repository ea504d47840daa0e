"""`rtarm plot`: a recording as a picture: positions and errors of every joint, lateness, modes and faults."""

from __future__ import annotations

import math
import os
import stat
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rtarm.console.errors import Refusal, needs
from rtarm.recording.mcap_format import Loaded, Step
from rtarm.recording.mcap_reader import read
from rtarm.recording.story import UNLED, tell
from sentences.told import mode_name
from shm.recording import Recording
from shm.words import Event, Fault, Mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
SOFTWARE = "rtarm plot"
"""So a picture of ours says that it was made; nothing else is replaced."""
COMMANDED, MEASURED, ERROR, LATENESS, FAULT = "#0072b2", "#d55e00", "#d55e00", "#555555", "#b00020"
"""Told apart by everybody (Okabe and Ito's palette)."""
MODES = {
    Mode.OFFLINE: "#bbbbbb",
    Mode.BRINGING_UP: "#f0e442",
    Mode.HOLDING: "#e8e8e8",
    Mode.EXECUTING: "#56b4e9",
    Mode.STOPPING: "#e69f00",
    Mode.FAULT: "#d9534f",
    Mode.DISABLED: "#999999",
    Mode.FREE: "#cc79a7",
    Mode.REFERENCING: "#009e73",
}
MOST_POINTS = 4000
"""Of a line; a picture has fewer columns, and of more points the lowest and highest of each stretch are drawn."""
LEAST_SPAN_DEG = 0.1
"""Of a joint's axis; the position of one that stands is a line then, and its error is seen to be small."""
LEAST_SPAN_US = 10.0
COLUMNS_FROM = 9
"""From so many joints on, they stand in two columns."""


class Times(NamedTuple):
    """When cycles were, in seconds from the picture's zero."""

    seconds: np.ndarray
    zero_ns: int


def plot(file: Path, output: Path | None, step: Step = lambda _: None) -> Path:
    """Draw a recording; the picture that was written, beside the recording where no other place is named.

    Raises:
        Refusal: the recording cannot be read, or the picture not be written.
    """
    needs("matplotlib")
    target = output if output is not None else file.with_suffix(FORMATS[0])
    if target.suffix.lower() not in FORMATS:
        raise Refusal(f"{target} is no name of a picture: let it end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}.")
    _check_target(target)
    loaded = read(file, lambda done: step(0.8 * done))
    figure = draw(loaded)
    step(0.9)
    _save(figure, target)
    return target


def draw(loaded: Loaded) -> Figure:
    """The picture of a recording."""
    from matplotlib.figure import Figure

    recording = loaded.recording
    story = tell(recording, loaded.reason)
    seconds = (recording.records["monotonic_ns"] - story.zero_ns) * 1e-9
    times = Times(seconds, story.zero_ns)
    count = len(recording.joints)
    columns = 2 if count >= COLUMNS_FROM else 1
    rows = -(-count // columns)
    width_in, height_in = 11.0 * columns**0.5, 2.2 + 1.55 * rows
    figure = Figure(figsize=(width_in, height_in))
    grid = figure.add_gridspec(  # places of our own: to measure every label for them takes as long as to read the file
        rows + 3,
        2 * columns,
        height_ratios=[0.28, *[1.0] * rows, 0.1, 0.8],
        left=0.8 / width_in,
        right=1.0 - 0.1 / width_in,
        bottom=0.5 / height_in,
        top=1.0 - 0.85 / height_in,
        wspace=0.2,
        hspace=0.17,
    )
    mode = figure.add_subplot(grid[0, :])
    _draw_modes(mode, recording, times)
    for index, name in enumerate(recording.joints):
        row, column = index % rows + 1, 2 * (index // rows)
        last = index % rows == rows - 1 or index == count - 1
        _draw_joint(
            figure.add_subplot(grid[row, column], sharex=mode),
            figure.add_subplot(grid[row, column + 1], sharex=mode),
            recording,
            index,
            name,
            times,
            first=index == 0,
            last=last,
        )
    lateness = figure.add_subplot(grid[rows + 2, :], sharex=mode)
    _draw_lateness(lateness, recording, times)
    for axes in figure.axes:
        _mark_faults(axes, recording, times)
        axes.margins(x=0.01)
    heading = [_plain(story.heading)]
    if story.fault != Fault.NONE:
        heading.append(_plain(_shortened(story.verdict[0])))
    if loaded.damage:
        heading.append(_plain(_shortened(f"The file is damaged: {loaded.damage}")))
    figure.suptitle("\n".join(heading), fontsize=10, x=0.01, y=1.0 - 0.1 / height_in, ha="left", va="top")
    return figure


def _plain(text: str) -> str:
    """Text in which matplotlib sees no formula."""
    return text.replace("$", r"\$")


def _shortened(sentence: str) -> str:
    return sentence if len(sentence) <= 150 else sentence[:149] + "…"


def _at_least(axes: Axes, span: float) -> None:
    """Make room for at least such a range of values, so that the noise of what stands is seen for what it is."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)
    axes.ticklabel_format(axis="y", useOffset=False)


def _style(axes: Axes, last: bool) -> None:
    axes.grid(True, linewidth=0.4, alpha=0.5)
    axes.tick_params(labelsize=7, labelbottom=last)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_modes(axes: Axes, recording: Recording, times: Times) -> None:
    """A band that is coloured by the mode, with its name where there is room, else above it."""
    from matplotlib.patches import Patch

    modes = recording.records["mode"]
    borders = [0, *(np.flatnonzero(np.diff(modes)) + 1).tolist(), len(modes)]
    span = float(times.seconds[-1] - times.seconds[0]) or 1.0
    unnamed: dict[str, str] = {}
    for start, end in pairwise(borders):
        left, right = times.seconds[start], times.seconds[min(end, len(modes) - 1)]
        number = int(modes[start])
        colour = next((shade for mode, shade in MODES.items() if mode == number), "#ffffff")
        axes.axvspan(left, right, color=colour, linewidth=0)
        name = mode_name(number)
        if (right - left) / span < 0.012 * len(name) + 0.01:
            unnamed[name] = colour
        else:
            axes.text(
                (left + right) / 2,
                0.5,
                name,
                ha="center",
                va="center",
                fontsize=8,
                transform=axes.get_xaxis_transform(),
            )
    if unnamed:
        handles = [Patch(color=colour, label=name) for name, colour in unnamed.items()]
        axes.legend(handles=handles, fontsize=7, frameon=False, ncols=9, loc="lower left", bbox_to_anchor=(0.0, 0.95))
    axes.set_yticks([])
    axes.set_ylabel("mode", fontsize=8, rotation=0, ha="right", va="center")
    axes.tick_params(labelbottom=False, length=0)
    for side in axes.spines.values():
        side.set_visible(False)


def _draw_joint(
    position: Axes, error: Axes, recording: Recording, index: int, name: str, times: Times, *, first: bool, last: bool
) -> None:
    rows = recording.records["joints"][:, index]
    led = ~np.isin(recording.records["mode"], UNLED)  # nobody commands a joint that is limp, homed or brought up
    at, commanded = _thinned(times.seconds, np.degrees(np.where(led, rows["commanded_position_rad"], np.nan)))
    position.plot(at, commanded, color=COMMANDED, linewidth=1.6, label="commanded")
    read_s, measured, errors = _readings(rows, led, times)
    position.plot(*_thinned(read_s, np.degrees(measured)), color=MEASURED, linewidth=0.9, label="measured")
    position.set_ylabel(f"{_plain(name)}\n(°)", fontsize=8)
    error.plot(*_thinned(read_s, np.degrees(errors)), color=ERROR, linewidth=0.8)
    error.set_ylabel("error\n(°)", fontsize=8)
    for axes in (position, error):
        _at_least(axes, LEAST_SPAN_DEG)
    for axes in (position, error):
        _style(axes, last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8)
    if first:
        position.legend(fontsize=7, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0)
        allowed = math.degrees(recording.limits["following_error_rad"])
        error.set_title(f"measured less commanded, of the same instant; {allowed:.3g}° are allowed", fontsize=7)


def _readings(rows: np.ndarray, led: np.ndarray, times: Times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each reading once, where it was taken: its time, the position, and the error, NaN where nobody commanded it."""
    _, first = np.unique(rows["measured_ns"], return_index=True)
    at = np.sort(first)
    seconds = (rows["measured_ns"][at] - times.zero_ns) * 1e-9
    at = at[(rows["measured_ns"][at] > 0) & (seconds >= times.seconds[0])]
    read = rows[at]
    errors = np.where(led[at], read["measured_position_rad"] - read["reference_position_rad"], np.nan)
    return (read["measured_ns"] - times.zero_ns) * 1e-9, read["measured_position_rad"], errors


def _draw_lateness(axes: Axes, recording: Recording, times: Times) -> None:
    late_us = np.maximum(recording.records["lateness_ns"], 0) * 1e-3
    axes.plot(*_thinned(times.seconds, late_us), color=LATENESS, linewidth=0.7)
    missed = np.flatnonzero(np.diff(recording.records["overruns"]) > 0) + 1
    if len(missed):
        axes.plot(
            times.seconds[missed],
            late_us[missed],
            "x",
            color=FAULT,
            markersize=5,
            label=f"{len(missed)} × cycles missed",
        )
        axes.legend(fontsize=7, frameon=False, loc="upper right")
    _style(axes, last=True)
    axes.set_ylim(0.0, max(axes.get_ylim()[1], LEAST_SPAN_US))
    axes.set_ylabel("lateness\n(µs)", fontsize=8)
    axes.set_xlabel("time (s)", fontsize=8)


def _mark_faults(axes: Axes, recording: Recording, times: Times) -> None:
    """A line where each fault was latched."""
    for event in recording.events:
        seconds = (int(event["monotonic_ns"]) - times.zero_ns) * 1e-9
        if event["kind"] == Event.FAULT and event["code"] != Fault.NONE and seconds >= times.seconds[0]:
            axes.axvline(seconds, color=FAULT, linewidth=0.9, linestyle=(0, (4, 2)))


def _thinned(times_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As much of a line as a picture shows: of each stretch its lowest and highest point, so that no peak is lost."""
    stride = 2 * len(times_s) // MOST_POINTS
    if stride < 2:
        return times_s, values
    rows = len(times_s) // stride
    block = values[: rows * stride].reshape(rows, stride)
    known = np.where(np.isfinite(block), block, np.nanmean(block) if np.isfinite(block).any() else 0.0)
    starts = np.arange(rows)[:, None] * stride
    chosen = np.sort(np.hstack([starts + known.argmin(1)[:, None], starts + known.argmax(1)[:, None]]), axis=1).ravel()
    chosen = np.concatenate([chosen, np.arange(rows * stride, len(times_s))])
    return times_s[chosen], values[chosen]


def _check_target(path: Path) -> None:
    """Refuse to write over anything but an older picture of ours.

    Raises:
        Refusal: with the sentence for people.
    """
    try:
        mode = path.lstat().st_mode
        if stat.S_ISDIR(mode):
            raise Refusal(f"{path} is a folder: name a file in it, such as {path / 'recording.png'}.")
        if not stat.S_ISREG(mode):
            raise Refusal(f"{path} is a link, a device or a pipe, which no picture replaces: name a file.")
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            head = file.read(_SAID_WITHIN)
            file.seek(max(os.fstat(file.fileno()).st_size - _SAID_WITHIN, 0))
            ours = SOFTWARE.encode() in head + file.read(_SAID_WITHIN)
    except FileNotFoundError:
        return
    except OSError as problem:
        raise Refusal(f"{path} cannot be read ({problem.strerror}), so it is kept: name another file.") from problem
    if not ours:
        raise Refusal(f"{path} is there and no picture of `{SOFTWARE}`, so it is kept: name another file with -o.")


_SAID_WITHIN = 64 << 10
"""Bytes at a picture's beginning or end among which it says who made it."""
_SAID_IN: dict[str, dict[str, Any]] = {
    ".png": {"Software": SOFTWARE},
    ".svg": {"Creator": SOFTWARE},
    ".pdf": {"Creator": SOFTWARE},
}


def _save(figure: Figure, path: Path) -> None:
    suffix = path.suffix.lower()
    try:
        fd, aside = tempfile.mkstemp(suffix, ".rtarm-plot-", path.parent)
        try:
            with open(fd, "wb") as file:
                figure.savefig(file, format=suffix[1:], dpi=110, metadata=_SAID_IN[suffix])
            os.replace(aside, path)
        finally:
            Path(aside).unlink(missing_ok=True)
    except OSError as problem:
        raise Refusal(
            f"The picture {path} cannot be written ({problem.strerror}): give a file in a folder that you may write to."
        ) from problem
