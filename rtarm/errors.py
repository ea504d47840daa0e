"""How a command ends: the exit codes, in one table, and the error that carries one."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit codes of every `rtarm` command; `MEANINGS` says them to people."""

    DONE = 0
    REFUSED = 1
    LOOP_REFUSED = 2
    LOOP_DIED = 3
    GOAL_FAILED = 4
    UNHEALTHY = 5


MEANINGS: dict[ExitCode, str] = {
    ExitCode.DONE: "done; for `status`: running and healthy",
    ExitCode.REFUSED: "refused or not possible: usage, configuration, arm not running, request refused",
    ExitCode.LOOP_REFUSED: "the control process refused to start (port, drives, already running, …)",
    ExitCode.LOOP_DIED: "the control process ended by itself; the drives have braked by their own ramp",
    ExitCode.GOAL_FAILED: "a goal of the demo did not succeed",
    ExitCode.UNHEALTHY: "`status`: running, but not fit to move",
}


def exit_code_table() -> str:
    """The table as it stands at the end of `rtarm --help`."""
    return "\n\n".join(f"{code.value}  {MEANINGS[code]}" for code in ExitCode)


class Refusal(Exception):
    """A foreseeable end of a command: one sentence for a person, and an exit code."""

    def __init__(self, sentence: str, code: ExitCode = ExitCode.REFUSED) -> None:
        super().__init__(sentence)
        self.sentence = sentence
        self.code = code


class AlreadySaid(Refusal):
    """A refusal whose sentence a process of the arm has already spoken."""
