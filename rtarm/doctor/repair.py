"""`--fix`: the values that may be written because a boot, or unplugging, brings the old ones back."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from dataclasses import dataclass

from rtarm.doctor.finding import Write, tee
from rtarm.doctor.machine import Machine, Unknown


@dataclass(frozen=True)
class Change:
    """A value that was written; `undo` is the command that brings the old one back."""

    path: str
    before: str
    after: str

    @property
    def undo(self) -> str:
        return tee([Write(self.path, self.before)])


@dataclass
class Repairs:
    """What was changed, and a sentence for each value that could not be."""

    changes: list[Change]
    refusals: list[str]


def repair(machine: Machine, writes: Iterable[Write]) -> Repairs:
    """Write the values, read them back, and remember what was there; what was there is known before it is changed."""
    done = Repairs([], [])
    for write in dict.fromkeys(writes):
        try:
            before = machine.text(write.path)
            _put(machine, write)
        except (Unknown, OSError) as problem:
            done.refusals.append(_refusal(write, problem))
            continue
        after = None
        with contextlib.suppress(Unknown):
            after = machine.text(write.path)
        if after != before:
            done.changes.append(Change(write.path, before, write.value if after is None else after))
        if after != write.value:
            done.refusals.append(f"{write.path} was given {write.value}, but says {after}.")
    return done


def _put(machine: Machine, write: Write) -> None:
    # Never created: a file that is not there is no setting.
    descriptor = os.open(machine.path(write.path), os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC)
    try:
        os.write(descriptor, write.value.encode("ascii"))
    finally:
        os.close(descriptor)


def _refusal(write: Write, problem: Exception) -> str:
    reason = problem.strerror if isinstance(problem, OSError) else str(problem)
    as_root = 'run `sudo "$(command -v rtarm)" doctor --fix`'
    remedy = as_root if isinstance(problem, PermissionError) else "leave it as it is"
    return f"{write.path} was not set to {write.value} ({reason}); {remedy}."
