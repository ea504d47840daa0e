"""What a scan found, for people."""

from __future__ import annotations

from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

Report = dict[str, Any]


def render(report: Report) -> RenderableType:
    """Adapter by adapter what was found and what was not tried; the proposed file is to follow, as it is."""
    parts: list[RenderableType] = []
    for entry in report["adapters"]:
        parts += _adapter(entry)
    if not report["adapters"]:
        parts.append(Text("No adapter is here: plug one in, or name its port with --port."))
    parts += [Text(f"- {note}", style="dim") for note in report["notes"]]
    if report["proposal"] is not None:
        parts.append(Text("\nAn arm file to begin with:\n", style="bold"))
    return Group(*parts)


def _adapter(entry: Report) -> list[RenderableType]:
    usb = f", USB {entry['usb']}" if entry["usb"] else ""
    parts: list[RenderableType] = [Text(f"{entry['channel']}: {entry['what']}{usb}", style="bold")]
    if entry["not_tried"] is not None:
        return [*parts, Text(f"  not tried: {entry['not_tried']}")]
    outcome = entry["outcome"]
    parts.append(Text(f"  {_verdict(entry, outcome)}"))
    parts += [Text(f"  - {note}") for note in outcome["notes"]]
    if outcome["drives"]:
        parts.append(_table(outcome["drives"]))
        parts += [Text(f"  - {note}") for drive in outcome["drives"] for note in drive["notes"]]
    for kind in ("answered", "overheard"):
        if outcome[kind]:
            parts.append(_heard_table(kind, outcome[kind]))
    return parts


def _verdict(entry: Report, outcome: Report) -> str:
    baud = f", serial line at {entry['serial_baud']} baud" if entry["serial_baud"] not in (None, "cdc") else ""
    rates = ", ".join(map(str, outcome["asked"]))
    if outcome["drives"] or outcome["answered"]:
        count = len(outcome["drives"]) + len(outcome["answered"])
        rate = f" at {outcome['bitrate']} bit/s" if outcome["bitrate"] else ""
        return f"{count} drive{'' if count == 1 else 's'} answer{'s' if count == 1 else ''}{rate}{baud}"
    if outcome["overheard"]:
        count = len(outcome["overheard"])
        speaks = "drive speaks" if count == 1 else "drives speak"
        rate = f" at {outcome['bitrate']} bit/s" if outcome["bitrate"] else ""
        return f"{count} {speaks} by {'itself' if count == 1 else 'themselves'}{rate}{baud}"
    if outcome["bitrate"] or not outcome["asked"]:
        return "in use" if outcome["notes"] else "nobody was asked"
    family = outcome["asked_family"]
    asked = f"drive of family {family}" if family else "ZDT or RobStride drive"
    menu = ", and that the port in a ZDT drive's menu is set to CAN" if family in (None, "zdt") else ""
    only_named = "; MyActuator, MKS, Damiao and silent VESC and CANopen drives are asked with --family only"
    others = "; nobody else was asked" if family else only_named
    return (
        f"no {asked} answers (asked at {rates} bit/s{baud}), and no ODrive, VESC or CANopen drive was "
        f"overheard: check the drives' power, the two CAN wires, 120 Ω at both ends{menu}{others} "
        "(docs/hardware/drives.md)"
    )


def _table(drives: list[Report]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("address", "firmware", "microsteps", "response", "current mA", "state"):
        table.add_column(column, justify="right" if column != "state" else "left")
    for drive in drives:
        values = (drive["address"], drive["firmware"], drive["microsteps"], drive["response"], drive["current_ma"])
        cells = ["?" if value is None else escape(str(value)) for value in values]
        table.add_row(*cells, _state(drive))
    return table


def _heard_table(how: str, drives: list[Report]) -> Table:
    table = Table(how, box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("number", justify="right")
    table.add_column("state")
    for drive in drives:
        table.add_row(escape(drive["called"]), str(drive["number"]), escape(drive["state"]))
    return table


def _state(drive: Report) -> str:
    if drive["protected"] is None:
        return "?"
    words = [word for word in ("protected", "power_lost") if drive[word]]
    return ", ".join(word.replace("_", " ") for word in words) or "ready"
