"""What a calibration says to one drive: the file of the drive's family in this folder has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

from config.drives.drive import Drive
from config.schema import ArmConfig
from rtloop.offline import families
from rtloop.offline.settings.compare import DriveReport
from rtloop.service.conversation import Part, Unaddressed, Value


@dataclass(frozen=True)
class Found:
    """What a drive is before anything moves."""

    joint: str
    address: int
    firmware: str
    """As it tells it, such as 2.0.0; empty where it does not."""
    enabled: bool
    homing_rpm: int | None
    problems: list[str]
    """Why it is not moved, a sentence each."""


class State(NamedTuple):
    """What a drive says of itself."""

    enabled: bool
    power_lost: bool
    """Whether it has lost power since it was homed."""


class Motor(Protocol):
    """What is said to one drive; places are in counts of its motor, and every part raises DialogueFailed."""

    def addressed(self, dialogue: Unaddressed[Value]) -> Part[Value]:
        """A dialogue, said to this drive."""

    def counts(self) -> Unaddressed[int]:
        """Where the motor stands."""

    def state(self) -> Unaddressed[State]:
        """How it is."""

    def require_held(self) -> Unaddressed[object]:
        """See that the drive holds the joint and may move it."""

    def stand(self) -> Unaddressed[int]:
        """Stop it, and see that it stands; where."""

    def stand_held(self) -> Unaddressed[int]:
        """The same of one that must hold its joint."""

    def hold(self) -> Unaddressed[int]:
        """Enable it, and see that it holds where it stands; where."""

    def let_go(self) -> Unaddressed[int]:
        """Let its shaft turn freely; where it was then."""

    def turn(self, by_counts: int, rpm: int) -> Unaddressed[int]:
        """Turn the motor by so many counts and see that it does just that; where it stands then."""


class MotorFile(Protocol):
    """What a family's file has."""

    def motor_of(self, arm: ArmConfig, joint: int, now_ns: Callable[[], int]) -> Motor:
        """What is said to a joint's drive; `now_ns` tells the time."""

    def found_of(self, arm: ArmConfig, joint: int, reading: Any, report: DriveReport) -> Found:
        """What a drive is before anything moves, by the reading of its settings."""

    def tells_power_loss(self, reading: Any) -> bool:
        """Whether such a drive says that it has lost power since it was homed."""


def motors_of(drive: Drive) -> MotorFile:
    """The file of a family whose motors can be turned."""
    return cast(MotorFile, families.file_of("calibration", drive))
