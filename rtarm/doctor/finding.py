"""What a check says: how bad it is, what was found, what mends it, and what `--fix` may write."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from shlex import join, quote


class Level(IntEnum):
    """How much a finding matters; what is unknown is at least a note."""

    OK = 0
    NOTE = 1
    WARN = 2
    BAD = 3


LEVEL_MEANINGS: dict[Level, str] = {
    Level.OK: "as it should be",
    Level.NOTE: "worth knowing, or could not be found out (`unknown: …`)",
    Level.WARN: "may make cycles late or the bus slow",
    Level.BAD: "cycles will be late, or the arm will not start",
}


@dataclass(frozen=True)
class Write:
    """A value for a file below /proc or /sys, where it lasts until the next boot (or until the device is unplugged)."""

    path: str
    value: str


@dataclass(frozen=True)
class Found:
    """What a check found.

    Attributes:
        found: the value, in words.
        mend: shell command that mends it; where none can, a line of advice that begins with #.
        fix: what `--fix` writes for it; the command is made of it where `mend` says nothing.
    """

    level: Level
    found: str
    mend: str | None = None
    fix: tuple[Write, ...] = ()

    @property
    def command(self) -> str | None:
        """The command to show."""
        return self.mend if self.mend is not None or not self.fix else tee(self.fix)


def ok(found: str) -> Found:
    return Found(Level.OK, found)


def note(found: str, mend: str | None = None, fix: tuple[Write, ...] = ()) -> Found:
    return Found(Level.NOTE, found, mend, fix)


def warn(found: str, mend: str | None = None, fix: tuple[Write, ...] = ()) -> Found:
    return Found(Level.WARN, found, mend, fix)


def bad(found: str, mend: str | None = None, fix: tuple[Write, ...] = ()) -> Found:
    return Found(Level.BAD, found, mend, fix)


def together(parts: Sequence[Found]) -> Found:
    """Several of a kind (adapters, interfaces) as one finding, as bad as the worst of them."""
    commands = [part.command for part in parts if part.command is not None]
    return Found(
        max(part.level for part in parts),
        "; ".join(part.found for part in parts),
        "\n".join(dict.fromkeys(commands)) or None,
        tuple(write for part in parts for write in part.fix),
    )


def tee(writes: Iterable[Write]) -> str:
    """The shell command, or commands, that write these values."""
    paths_of: dict[str, list[str]] = {}
    for write in writes:
        paths_of.setdefault(write.value, []).append(write.path)
    return "\n".join(f"echo {quote(value)} | sudo tee {join(paths)}" for value, paths in paths_of.items())
