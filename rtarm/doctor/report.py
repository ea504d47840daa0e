"""Runs all checks and shows what they found: as lines for people, as one object for scripts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from config.schema import ArmConfig
from rtarm.doctor.checks import CHECKS
from rtarm.doctor.finding import Level
from rtarm.doctor.machine import Machine
from rtarm.doctor.repair import Repairs, repair

Report = dict[str, Any]
"""What `--json` prints."""

STYLES = {Level.OK: "green", Level.NOTE: "cyan", Level.WARN: "yellow", Level.BAD: "bold red"}
NAME_WIDTH = 22
INDENT = 6


def examine(machine: Machine, arm: ArmConfig | None, *, fix: bool = False) -> Report:
    """What all checks found; with `fix`, after what could be mended was."""
    repairs = Repairs([], [])
    found = [(check, check.run(machine, arm)) for check in CHECKS]
    if fix:
        repairs = repair(machine, (write for _, finding in found for write in finding.fix))
        found = [(check, check.run(machine, arm)) for check in CHECKS]
    worst = max(finding.level for _, finding in found)
    return {
        "arm": None if arm is None else arm.name,
        "healthy": worst < Level.WARN,
        "level": worst.name.lower(),
        "findings": [
            {
                "name": check.name,
                "level": finding.level.name.lower(),
                "found": finding.found,
                "why": check.why,
                "mend": finding.command,
                "fixable": bool(finding.fix),
            }
            for check, finding in found
        ],
        "changes": [
            {"path": change.path, "before": change.before, "after": change.after, "undo": change.undo}
            for change in repairs.changes
        ],
        "refused": repairs.refusals,
    }


def show(report: Mapping[str, Any], console: Console) -> None:
    """The report for people, worst first; commands are never wrapped, so that they can be copied."""
    arm = "this machine" if report["arm"] is None else f"this machine, for arm {report['arm']}"
    count = sum(Level[finding["level"].upper()] >= Level.WARN for finding in report["findings"])
    verdict = (f"{count} to mend", "bold red") if count else ("nothing found that makes cycles late", "green")
    console.print(Text.assemble((f"{arm}: ", "bold"), verdict))
    for change in report["changes"]:
        said = f"changed {change['path']}: {change['before']} → {change['after']}; to undo:"
        console.print(Text(said), soft_wrap=True)
        _show_command(change["undo"], console)
    for sentence in report["refused"]:
        console.print(Text(sentence, style="yellow"))
    for finding in sorted(report["findings"], key=lambda finding: -Level[finding["level"].upper()]):
        _show_finding(finding, console)
    fixable = ", ".join(finding["name"] for finding in report["findings"] if finding["fixable"])
    if fixable:
        hint = f'`sudo "$(command -v rtarm)" doctor --fix` sets {fixable} until the next boot, and says how to undo it.'
        console.print(Text(hint, style="dim"))


def _show_finding(finding: Mapping[str, Any], console: Console) -> None:
    level = Level[finding["level"].upper()]
    line = Text(f"{finding['level']:<{INDENT}}", style=STYLES[level])
    line.append(f"{finding['name']:<{NAME_WIDTH}}", style="bold" if level else "")
    line.append(finding["found"], style="")
    console.print(line, soft_wrap=True)
    if level == Level.OK:
        return
    console.print(Padding(Text(finding["why"], style="dim"), (0, 0, 0, INDENT)))
    if finding["mend"] is not None:
        _show_command(finding["mend"], console)


def _show_command(commands: str, console: Console) -> None:
    for command in commands.splitlines():
        console.print(Text(f"{'':{INDENT}}{command}", style="bold"), soft_wrap=True)
