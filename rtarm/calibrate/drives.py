"""A joint's drive as a calibration needs it, and the drives that dialogues of their own turn while nothing is up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from config.drives.drive import Drive as DriveConfig
from rtarm.console.person import Person
from rtarm.drives.settings import OfflineProcess
from rtloop.offline.calibration.session import DriveState, NotDone
from rtloop.offline.calibration.talk import Found


@dataclass(frozen=True)
class State:
    """State of a drive."""

    turns: float
    """Position of its motor, from where the drive counts 0."""
    enabled: bool
    doubt: str | None
    """Why its count may not be one from its homing stop, to follow the joint's name; None if it is."""


class Drive(Protocol):
    """One joint's drive; everything returns once it stands. Failures end the calibration."""

    homing_rpm: int | None
    """Speed of its motor in a homing run; None where that is not told."""

    def look(self) -> State:
        """Its state."""

    def turn(self, by_turns: float, rpm: int) -> State:
        """Turn the motor; raises NotDone where that is farther than the joint may go."""

    def let_go(self) -> State:
        """Let a person turn the joint, who holds it already."""

    def hold(self) -> State:
        """Hold the joint where it stands."""

    def home(self) -> State:
        """Run to the homing stop, from which it then counts."""


class OfflineDrive:
    """A drive that dialogues of its family turn (`rtloop.offline.calibration`); `order` takes their orders."""

    def __init__(
        self, joint: int, config: DriveConfig, homing_rpm: int | None, order: Callable[[str], DriveState]
    ) -> None:
        self.homing_rpm = homing_rpm
        self._joint = joint
        self._counts_per_turn = config.reading_steps_per_revolution
        self._order = order

    def look(self) -> State:
        return self._told("look")

    def turn(self, by_turns: float, rpm: int) -> State:
        return self._told("turn", round(by_turns * self._counts_per_turn), rpm)

    def let_go(self) -> State:
        return self._told("release")

    def hold(self) -> State:
        return self._told("hold")

    def home(self) -> State:
        return self._told("home")

    def _told(self, word: str, *numbers: int) -> State:
        state = self._order(" ".join([word, str(self._joint), *map(str, numbers)]))
        return State(state.counts / self._counts_per_turn, state.enabled, state.doubt)


class OfflineDrives:
    """The drives of such families, through the process that turns them."""

    def __init__(self, process: OfflineProcess, person: Person) -> None:
        drives = process.answer("ready", person.tell)["drives"]
        self.found = {int(joint): Found(**found) for joint, found in drives.items()}
        self._order = partial(_ordered, process, person)

    def drive(self, joint: int, config: DriveConfig) -> OfflineDrive:
        """One of them."""
        return OfflineDrive(joint, config, self.found[joint].homing_rpm, self._order)


def _ordered(process: OfflineProcess, person: Person, line: str) -> DriveState:
    process.order(line)
    state = process.answer("state", person.tell)
    if "not_done" in state:
        raise NotDone(state["not_done"])
    return DriveState(**state)
