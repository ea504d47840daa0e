"""What the arm file wants of a drive's settings, beside what the drive says.

A setting is wanted only if the arm file (or an override) names it: defaults of the schema are shown, and a drive that
differs from one is told, but nothing is written that nobody has named.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

Value = int | str | bool | None


class Verdict(StrEnum):
    """How a setting of a drive stands to the arm file."""

    SAME = "same"
    DIFFERS = "differs"
    NOT_NAMED = "not named"  # by the arm file
    UNKNOWN = "unknown"  # the drive does not say it


@dataclass(frozen=True)
class Setting:
    """A setting of a drive: what the arm file wants and what the drive has."""

    name: str
    wanted: Value
    found: Value
    verdict: Verdict
    writable: bool
    """Whether `rtarm drives --write` may write it; id, bit rate and checksum are changed in the drive's own menu."""


@dataclass(frozen=True)
class DriveReport:
    """Everything known of one drive."""

    joint: str
    address: int
    answers: bool
    firmware: str | None
    hardware: int | None
    supply_v: float | None
    homing: dict[str, Any] | None
    trip: dict[str, Any] | None
    settings: list[Setting]
    left_alone: list[str]
    """Why nothing is written to this drive, a sentence each."""
    notes: list[str]
    """What is worth knowing besides, a sentence each."""

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


def compared(name: str, wanted: Value, found: Value, *, writable: bool = False) -> Setting:
    """What the arm file wants beside what the drive says, None where it names nothing or the drive says nothing."""
    if found is None:
        verdict = Verdict.NOT_NAMED if wanted is None else Verdict.UNKNOWN
    elif wanted is None:
        verdict = Verdict.NOT_NAMED
    else:
        verdict = Verdict.SAME if wanted == found else Verdict.DIFFERS
    return Setting(name, wanted, found, verdict, writable)
