"""The causes as a picture: their shares, and the worst example of each as a time line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtarm.console.errors import Refusal, needs
from rtarm.recording.plot import FORMATS
from rtarm.why_late.causes import WORDS, Cause

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#888888")
"""Told apart by everybody (Okabe and Ito's palette)."""


def check(path: Path) -> None:
    """Refuse what could not be drawn in the end.

    Raises:
        Refusal: matplotlib is missing, or the name is that of no picture, or of one in no folder.
    """
    needs("matplotlib")
    if path.suffix not in FORMATS:
        raise Refusal(f"{path} is no name of a picture: let it end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}.")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise Refusal(f"{path} cannot be written: name a file in a folder that exists.")


def draw(report: Mapping[str, Any], path: Path) -> None:
    """Draw a report.

    Raises:
        Refusal: the file cannot be written.
    """
    from matplotlib.figure import Figure

    causes = report["causes"]
    colours = {one["cause"]: PALETTE[number % len(PALETTE)] for number, one in enumerate(causes)}
    rows = [("all late time", 100 / max(report["late_us"], 1e-9), _end_to_end(causes))]
    for one in causes:
        if (worst := one["worst"]) is not None:
            rows.append((f"cycle {worst['cycle']}, {worst['us']:.0f} µs", 100 / worst["us"], worst["segments"]))
    figure = Figure(figsize=(9.0, 1.6 + 0.45 * len(rows)), layout="constrained")
    panel = figure.subplots()
    for number, (_, scale, segments) in enumerate(rows):
        for segment in segments:
            colour = colours[segment["cause"]]
            panel.barh(number, segment["us"] * scale, left=segment["at_us"] * scale, color=colour)
    for one in causes:
        panel.barh(0, 0, color=colours[one["cause"]], label=f"{WORDS[Cause(one['cause'])]} ({one['share']:.0%})")
    panel.set_yticks(range(len(rows)), [name for name, *_ in rows])
    panel.invert_yaxis()
    panel.set_xlim(0, 100)
    panel.set_xlabel("% of the time")
    panel.set_title(
        f"{report['arm']}: {report['late']} of {report['cycles']} cycles later than {report['bound_us']:g} µs"
    )
    if causes:
        figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    try:
        figure.savefig(path, dpi=130)
    except OSError as error:
        raise Refusal(f"{path} cannot be written ({error.strerror}): name another file.") from None


def _end_to_end(causes: Any) -> list[dict[str, Any]]:
    at_us, found = 0.0, []
    for one in causes:
        found.append({"cause": one["cause"], "at_us": at_us, "us": one["us"]})
        at_us += one["us"]
    return found
