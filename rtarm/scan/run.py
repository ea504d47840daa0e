"""`rtarm scan`: looks at every adapter that may be looked at, and says what it has not tried and why."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from typing import Any

from config.errors import legible
from rtarm.console.errors import Refusal
from rtarm.doctor.machine import Machine, Unknown
from rtarm.scan import adapters as detection
from rtarm.scan.adapters import Adapter
from rtarm.scan.proposal import proposal
from rtarm.scan.questions import BY_NAME
from rtarm.scan.search import Outcome, may_have, search_link, search_slcan
from rtarm.scan.wires import CanWire, SlcanWire, TtyPort
from rtloop.wire.claim import claim_for_scan
from rtloop.wire.refusal import WireRefused
from rtloop.wire.tty import close_slcan, open_port

UART_BAUDS: tuple[int, ...] = (1_000_000, 115_200, 2_000_000, 921_600, 500_000, 460_800, 230_400)
"""Speeds at which a true UART is tried."""

FAMILIES_ASKED = ("zdt", *BY_NAME)

Report = dict[str, Any]


def scan(
    machine: Machine,
    ports: Sequence[str],
    *,
    family: str | None = None,
    telling: Callable[[str], None] = lambda _: None,
    detect: detection.Detection = detection.seen_by_python_can,
) -> Report:
    """Everything that was found, as plain values.

    Args:
        ports: serial ports or CAN interfaces a person names; only these are looked at then.
        family: whose drives alone are asked; None for all who can be asked without harm to others.
        telling: gets a line before something that takes a while.

    Raises:
        Refusal: a named port is not there, or a family is none that can be asked.
    """
    if family is not None and family not in FAMILIES_ASKED:
        raise Refusal(
            f"Drives of family {legible(family, 20)} are not asked: name {', '.join(FAMILIES_ASKED[:-1])} or "
            f"{FAMILIES_ASKED[-1]}, or leave --family out, which overhears ODrives too."
        )
    notes: list[str] = []
    if ports:
        found = [_named(machine, port) for port in ports]
    else:
        found = detection.adapters(machine)
        seen, why_not = detect()
        found += detection.beyond_reach(seen, found)
        notes += [why_not] if why_not else []
    entries = []
    for adapter in found:
        entry: Report = {**asdict(adapter), "outcome": None, "serial_baud": None}
        if adapter.not_tried is None:
            telling(f"looking for drives at {adapter.channel}; it takes up to a minute")
            _try(adapter, entry, family)
        entries.append(entry)
    report: Report = {"adapters": entries, "notes": notes, "found": False, "proposal": None}
    best = max((e for e in entries if e["outcome"] is not None), key=_drive_count, default=None)
    if best is not None and _drive_count(best):
        report |= {"found": True, "proposal": proposal(best)}
    return report


def _drive_count(entry: Report) -> int:
    outcome = entry["outcome"]
    return sum(len(outcome[kind]) for kind in ("drives", "answered", "overheard")) if outcome else 0


def _named(machine: Machine, port: str) -> Adapter:
    if "/" not in port:
        names = [adapter.channel for adapter in detection.links(machine)]
        if port not in names:
            there = ", ".join(names) or "none"
            raise Refusal(
                f"There is no CAN interface {legible(port, 40)} (found: {there}): name one of those, or a serial port "
                "by its path (/dev/ttyACM0)."
            )
        return detection.link(machine, port)
    port = os.path.abspath(port)
    try:
        exists = machine.exists(port)
    except ValueError:
        exists = False
    if not exists:
        raise Refusal(
            f"There is no serial port {legible(port, 200)}: plug the adapter in, or leave --port out to see what is "
            "there."
        )
    try:
        return detection.serial_port(machine, port, named=True)
    except Unknown as problem:
        raise Refusal(f"{port} cannot be looked at: {problem}.") from None


def _try(adapter: Adapter, entry: Report, family: str | None) -> None:
    """Look for drives; what cannot be opened is not tried, with the reason."""
    try:
        if adapter.interface == "slcan":
            outcome, entry["serial_baud"] = _try_serial(adapter, family)
        else:
            outcome = _try_link(adapter, family)
    except WireRefused as refused:
        entry["not_tried"] = str(refused)
    except OSError as problem:
        entry["not_tried"] = (
            f"It stopped working while it was looked at ({os.strerror(problem.errno or 0)}): check its plug, then scan "
            "again."
        )
    else:
        entry["outcome"] = asdict(outcome)


def _try_link(adapter: Adapter, family: str | None) -> Outcome:
    if family is not None and adapter.bitrate is not None and not may_have(family, adapter.bitrate):
        rates = ", ".join(map(str, sorted(BY_NAME[family].bitrates)))
        raise WireRefused(
            f"It runs at {adapter.bitrate} bit/s, to which {family} drives cannot be set (only to {rates}), "
            f"so none was asked: give {adapter.channel} the drives' rate, then scan again."
        )
    with closing(claim_for_scan(adapter.channel)), closing(CanWire(adapter.channel)) as wire:
        return search_link(wire, adapter.bitrate, family)


def _try_serial(adapter: Adapter, family: str | None) -> tuple[Outcome, int | str]:
    """The outcome, and the speed of the serial line at which the adapter has spoken."""
    bauds: tuple[int | str, ...] = UART_BAUDS if adapter.is_uart else ("cdc",)
    for baud in bauds:
        fd = open_port(adapter.channel, baud)
        try:
            wire = SlcanWire(TtyPort(fd))
            if wire.greet() or not adapter.is_uart:
                outcome = search_slcan(wire, family)
                if not wire.answers:
                    outcome.notes.append(
                        "The adapter answers no command, as the original canable firmware does, and as something does "
                        "that is no SLCAN adapter: whether it listened at all is not known."
                    )
                return outcome, baud
        finally:
            close_slcan(fd)
    raise WireRefused(
        f"It has not answered as an SLCAN adapter at any of {', '.join(map(str, bauds))} baud, so no bit rate was "
        "tried: give it power. An adapter of another kind (USB-CAN-A, AT) is not recognised here: its arm file says "
        "bus.interface seeedstudio or ch340-at (docs/hardware/adapters.md)."
    )
