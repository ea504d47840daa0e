"""Steps that need each other, at the same time where they do not, with a line when each begins and ends.

Only Python's own library: the first of these steps make the environment that all else needs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO

MESSAGES_S = 30.0
CYCLE_S = 30.0
"""About how long the two long steps of every first use take, on a quiet machine of two cores."""

POLL_S = 0.02
LOG_LINES_SHOWN = 15

Say = Callable[[str], None]


@dataclass(frozen=True)
class Step:
    """Something that is made by commands, one after the other."""

    name: str
    words: str
    """What it makes, for people."""
    about_s: float
    """How long it takes on a quiet machine, about."""
    commands: Sequence[Sequence[str]]
    needs: Sequence[str] = ()
    """Names of the steps that must be done before."""
    environment: Mapping[str, str] | None = None


class StepFailed(Exception):
    """A step could not be done; one sentence, after the last lines that its command printed."""


@dataclass
class _Running:
    step: Step
    number: int
    started: float
    log: IO[str]
    waiting: list[Sequence[str]] = field(default_factory=list)
    process: subprocess.Popen[bytes] | None = None

    def next_command(self) -> bool:
        """Start the next command; False when there is none left."""
        if not self.waiting:
            return False
        environment = self.step.environment
        # A group of its own, so that whatever it has started ends with it.
        self.process = subprocess.Popen(
            self.waiting.pop(0),
            env=None if environment is None else dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        return True

    def end(self) -> None:
        if self.process is not None and self.process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()

    def last_lines(self) -> str:
        self.log.seek(0)
        return "".join(self.log.readlines()[-LOG_LINES_SHOWN:]).rstrip()


def run(steps: Sequence[Step], say: Say, done: Callable[[Step, str], None] = lambda *_: None) -> None:
    """Do all steps; a need that is not among them is taken for done. `done` is told of each, with what it printed.

    Raises StepFailed, and whatever interrupts it, once the commands that ran have ended.
    """
    waiting = list(steps)
    running: list[_Running] = []
    try:
        while waiting or running:
            unfinished = {step.name for step in waiting} | {each.step.name for each in running}
            for step in [step for step in waiting if not unfinished.intersection(step.needs)]:
                waiting.remove(step)
                number = steps.index(step) + 1
                say(f"step {number} of {len(steps)}: {step.words}, about {step.about_s:.0f} s …")
                log = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 - closed below
                running.append(_Running(step, number, time.monotonic(), log, list(step.commands)))
                running[-1].next_command()
            time.sleep(POLL_S)
            for each in list(running):
                if each.process is not None and each.process.poll() is None:
                    continue
                if each.process is not None and each.process.returncode != 0:
                    raise StepFailed(
                        f"{each.last_lines()}\nStep {each.number} of {len(steps)} ({each.step.words}) failed: its last "
                        "lines stand above. What was done is kept, so the same command goes on from here."
                    )
                if each.next_command():
                    continue
                running.remove(each)
                say(f"step {each.number} of {len(steps)}: {each.step.words}, {time.monotonic() - each.started:.0f} s")
                done(each.step, each.last_lines())
                each.log.close()
    finally:
        for each in running:
            each.end()
            each.log.close()
