"""The page of what the benchmarks have measured, from the files that they wrote with `--keep bench/measured`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from handbook.markdown import block, code, page, table

MEASURED = Path(__file__).parents[1] / "bench" / "measured"
INTRODUCTION = """\
Each table is what one benchmark of this repository printed, with when and on what it ran. None was edited; nothing is
asserted of them, and a busy machine gives others. What they say, and what older ones were:
[performance](../explanation/performance.md). `make bench` measures all of them on your machine."""


def build() -> str:
    """The page."""
    kept = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(MEASURED.glob("*.json"))]
    return page("Measured figures", INTRODUCTION, *(part for one in kept for part in _section(one)))


def _section(kept: Mapping[str, Any]) -> Iterator[str]:
    yield f"## {kept['benchmark']}"
    yield from kept["about"]
    settings = "".join(f"{name}={value} " for name, value in kept["settings"].items())
    yield block(f"{settings}{kept['command']}", "")
    yield f"{kept['when']}, commit {code(kept['commit'])}; {_machine(kept['machine'])}; {_versions(kept['versions'])}."
    for lines in kept["tests"].values():
        yield table(["what", "figure"], _rows(lines))


def _machine(machine: Mapping[str, Any]) -> str:
    virtual = "virtual machine, " if machine["virtual"] else ""
    load = ", ".join(f"{one:.2f}" for one in machine["load_average"])
    return (
        f"{virtual}{machine['processors']} processors of {machine['processor'] or machine['architecture']}, "
        f"Linux {machine['kernel']}, load average before {load}"
    )


def _versions(versions: Mapping[str, str | None]) -> str:
    return ", ".join(f"{name} {version}" for name, version in versions.items() if version)


def _rows(lines: Sequence[Sequence[str]]) -> Iterator[tuple[str, str]]:
    """What is indented belongs to the line before it, which is its heading."""
    for number, (what, figure) in enumerate(lines):
        heads = number + 1 < len(lines) and lines[number + 1][0].startswith(" ") and not what.startswith(" ")
        yield (f"**{what}**" if heads else what.strip()), figure
