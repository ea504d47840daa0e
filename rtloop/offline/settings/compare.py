"""Comparison of a drive's settings with what the arm file wants.

A setting is wanted only if the arm file (or an override) names it. Defaults of the schema are shown, and a drive that
differs from a default is reported, but a setting that is not named is never written.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

Value = int | float | str | bool | None
ALIKE = 1e-4
"""Relative difference below which two fractions are the same one, rounded."""


class Verdict(StrEnum):
    """Result of comparing a drive's setting with the arm file."""

    SAME = "same"
    DIFFERS = "differs"
    NOT_NAMED = "not named"  # by the arm file
    UNKNOWN = "unknown"  # the drive does not report it


@dataclass(frozen=True)
class Setting:
    """A setting of a drive: what the arm file wants and what the drive has."""

    name: str
    wanted: Value
    found: Value
    verdict: Verdict
    writable: bool
    """Whether `rtarm drives --write` may write it; id, bit rate and checksum are changed in the drive's menu only."""
    kept: bool = False
    """Whether the drive keeps it without power however it is written, so that it is written with `--store` alone."""


@dataclass(frozen=True)
class DriveReport:
    """Everything that is known of one drive."""

    joint: str
    address: int
    answers: bool
    firmware: str | None
    hardware: int | str | None
    supply_v: float | None
    homing: dict[str, Any] | None
    trip: dict[str, Any] | None
    settings: list[Setting]
    left_alone: list[str]
    """Reasons why nothing is written to this drive, a sentence each."""
    notes: list[str]
    """Other remarks, a sentence each."""

    @property
    def agrees(self) -> bool:
        """Whether the drive is as the arm file wants it."""
        fine = (Verdict.SAME, Verdict.NOT_NAMED)
        return self.answers and not self.left_alone and all(setting.verdict in fine for setting in self.settings)

    @property
    def to_write(self) -> list[Setting]:
        """The settings that differ and may be written."""
        if self.left_alone:
            return []
        return [s for s in self.settings if s.writable and s.verdict is Verdict.DIFFERS]


def as_json(report: DriveReport) -> dict[str, Any]:
    """A report as plain values."""
    return {**asdict(report), "agrees": report.agrees, "to_write": [setting.name for setting in report.to_write]}


def compared(name: str, wanted: Value, found: Value, *, writable: bool = False, kept: bool = False) -> Setting:
    """Compare a wanted value (None: not named in the arm file) with a drive's value (None: not reported)."""
    if found is None:
        verdict = Verdict.NOT_NAMED if wanted is None else Verdict.UNKNOWN
    elif wanted is None:
        verdict = Verdict.NOT_NAMED
    else:
        verdict = Verdict.SAME if _alike(wanted, found) else Verdict.DIFFERS
    return Setting(name, wanted, found, verdict, writable, kept)


def _alike(wanted: Value, found: Value) -> bool:
    if isinstance(wanted, float) and isinstance(found, float):
        return math.isclose(wanted, found, rel_tol=ALIKE)
    return wanted == found
