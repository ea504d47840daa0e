"""How often whoever wakes up later than that: survival curves on logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtarm.bench.lateness import from_pairs, survival
from rtarm.bench.report import describe_machine, describe_versions
from rtarm.bench.results import LOADS, WHO
from rtarm.console.errors import Refusal
from rtarm.processes import has_module
from rtarm.running.status import describe_scheduling

FORMATS = (".png", ".svg", ".pdf")
COLOURS = {
    "cyclictest": "#888888",
    "rtarm": "#0072b2",
    "one_node": "#d55e00",
    "plain_loop": "#e69f00",
    "one_node_fifo": "#cc79a7",
}
"""Told apart by everybody (Okabe and Ito's palette)."""
LABELS = {
    "cyclictest": "cyclictest (C, nothing but waking up)",
    "rtarm": "rtarm, full cycle",
    "one_node": "one rclpy node",
    "plain_loop": "plain Python loop",
    "one_node_fifo": "one rclpy node given that priority",
}


def check(path: Path) -> None:
    """Refuse what could not be drawn in the end.

    Raises:
        Refusal: matplotlib is missing, or the name is that of no picture.
    """
    if not has_module("matplotlib"):
        raise Refusal(
            "matplotlib is not installed, and --plot needs it: `pip install matplotlib`, or leave --plot out."
        )
    if path.suffix not in FORMATS:
        raise Refusal(f"{path} is no name of a picture: let it end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}.")


def draw(report: Mapping[str, Any], path: Path) -> None:
    """Draw `histogram_ns` of a report, one panel a rate and load."""
    from matplotlib.figure import Figure

    found = report["histogram_ns"]
    rates = sorted({rate for by_rate in found.values() for rate in by_rate}, key=int)
    labels = {
        who: f"{LABELS[who]}: {describe_scheduling(obtained).partition(',')[0]}"
        for who, obtained in report["scheduling"].items()
    }
    figure = Figure(figsize=(max(4.2 * len(rates), 8.0) + 0.8, 7.6), layout="constrained")
    panels = figure.subplots(len(LOADS), len(rates), sharex=True, sharey=True, squeeze=False)
    for row, load in enumerate(LOADS):
        for column, rate in enumerate(rates):
            panel = panels[row][column]
            panel.set_title(f"{rate} Hz, {load}", loc="left", fontsize=10)
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.grid(True, which="major", linewidth=0.4, alpha=0.5)
            for who in WHO:
                pairs = found.get(who, {}).get(rate, {}).get(load)
                if pairs:
                    late_us, share = survival(from_pairs(pairs))
                    panel.step(late_us, share, where="pre", color=COLOURS[who], label=labels[who], linewidth=1.6)
            if row == len(LOADS) - 1:
                panel.set_xlabel("wake-up lateness (µs)")
            if column == 0:
                panel.set_ylabel("share of cycles at least as late")
    figure.legend(
        *panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9
    )
    figure.suptitle(f"{describe_machine(report['machine'])}\n{describe_versions(report['versions'])}", fontsize=8)
    figure.savefig(path, dpi=130)
