"""How a command ends: the exit codes, in one table, and the error that carries one."""

from __future__ import annotations

import importlib.util
import os
import sys
from enum import IntEnum

from sentences.meaning import Language
from shm.errors import EndedMeanwhile, SharedMemoryError


class ExitCode(IntEnum):
    """Exit codes of every `rtarm` command; `MEANINGS` says them to people."""

    DONE = 0
    REFUSED = 1
    LOOP_REFUSED = 2
    LOOP_DIED = 3
    GOAL_FAILED = 4
    UNHEALTHY = 5


MEANINGS: dict[ExitCode, str] = {
    ExitCode.DONE: "done; for `status`: running and healthy; for `doctor`: nothing worse than a note; "
    "for `drives`: as the file wants them; for `scan`: drives found; for `commission`: nothing differs from the manual",
    ExitCode.REFUSED: "refused or not possible: usage, configuration, arm not running, request refused",
    ExitCode.LOOP_REFUSED: "the control process refused to start (port, drives, already running, …); "
    "for `calibrate` and `commission`: a drive did not do as it was told, and was stopped, or was not seen to stand",
    ExitCode.LOOP_DIED: "the control process ended by itself; the drives stop by themselves, but a homing run goes on",
    ExitCode.GOAL_FAILED: "a goal did not succeed (`demo`, `play`, `move`)",
    ExitCode.UNHEALTHY: "`status`: running, but not fit to move; `doctor`: something to mend; `drives`: not as the "
    "file wants them; `scan`: no drive found; `commission`: something differs from the manual",
}


def exit_code_table() -> str:
    """The table as it stands at the end of `rtarm --help`."""
    return "\n\n".join(f"{code.value}  {MEANINGS[code]}" for code in ExitCode)


class Refusal(Exception):
    """What was asked for was refused, or not possible; only where the sentence says so has anything moved.

    Attributes:
        sentence: what is wrong, what is allowed, and what to do, for a person.
        code: with which a command ends.
        joint, value, limit: which joint, what was too much, and how much is allowed, in SI units (rad, rad/s, …), where
            it is about such a thing and this is known; else None.
    """

    def __init__(
        self,
        sentence: str,
        code: ExitCode = ExitCode.REFUSED,
        *,
        joint: str | None = None,
        value: float | None = None,
        limit: float | None = None,
    ) -> None:
        super().__init__(sentence)
        self.sentence = sentence
        self.code = code
        self.joint = joint
        self.value = value
        self.limit = limit


class GoalFailed(Refusal):
    """A goal that the arm was given did not succeed; where it had begun, the arm has stopped on its path.

    `joint`, `value` and `limit` are there where the control process decided by them, such as a path tolerance.
    """

    def __init__(
        self, sentence: str, *, joint: str | None = None, value: float | None = None, limit: float | None = None
    ) -> None:
        super().__init__(sentence, ExitCode.GOAL_FAILED, joint=joint, value=value, limit=limit)


def needs(package: str) -> None:
    """Refuse, with what to install, where an optional package is missing whose import name is its own."""
    if importlib.util.find_spec(package) is None:
        raise Refusal(f"{package} is not installed, and this needs it: `pip install {package}`, then try again.")


class AlreadySaid(Refusal):
    """A refusal whose sentence a process of the arm has already spoken."""


def _one_place() -> bool:
    """Whether standard output and standard error go to the same terminal, file or pipe."""
    try:
        return os.path.sameopenfile(sys.stdout.fileno(), sys.stderr.fileno())
    except (OSError, ValueError):  # closed, or replaced by what is no file
        return False


def foreseen(error: Exception, language: Language = "en") -> tuple[str, ExitCode] | None:
    """What a person is told of a foreseeable error ("" if it has just been read), and the exit code.

    None for anything else: a defect shows its traceback.
    """
    from config.errors import ConfigError

    if isinstance(error, Refusal):
        heard = isinstance(error, AlreadySaid) and _one_place()
        return "" if heard else error.sentence, error.code
    if isinstance(error, ConfigError):
        return "\n".join(str(problem) for problem in error.errors), ExitCode.REFUSED
    if isinstance(error, SharedMemoryError):
        from rtarm.console.language import told

        return told(error, language), ExitCode.LOOP_DIED if isinstance(error, EndedMeanwhile) else ExitCode.REFUSED
    if "rosfront.program" in sys.modules and isinstance(error, sys.modules["rosfront.program"].CannotServe):
        return str(error), ExitCode.REFUSED  # where its module was not imported, it cannot have come up
    return None
