"""What a calibration needs of a family of drives; the file of the family in this folder has it."""

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
    """As the drive reports it, such as 2.0.0; empty if it does not."""
    enabled: bool
    homing_rpm: int | None
    problems: list[str]
    """Reasons why the drive is not moved, a sentence each."""


class State(NamedTuple):
    """What a drive reports about itself."""

    enabled: bool
    power_lost: bool
    """Whether it has lost power since it was homed."""


class Motor(Protocol):
    """The dialogues with one drive; positions are in counts of its motor, and every dialogue raises DialogueFailed."""

    def addressed(self, dialogue: Unaddressed[Value]) -> Part[Value]:
        """Address a dialogue to this drive."""

    def counts(self) -> Unaddressed[int]:
        """The motor's position."""

    def state(self) -> Unaddressed[State]:
        """The drive's state."""

    def require_held(self) -> Unaddressed[object]:
        """Check that the drive holds the joint and may move it."""

    def stand(self) -> Unaddressed[int]:
        """Stop the drive, and check that it stands; its position."""

    def stand_held(self) -> Unaddressed[int]:
        """The same for a drive that must hold its joint."""

    def hold(self) -> Unaddressed[int]:
        """Enable the drive, and check that it holds and stands; its position."""

    def let_go(self) -> Unaddressed[int]:
        """Switch the drive's torque off, so that its shaft turns freely; its position then."""

    def turn(self, by_counts: int, rpm: int) -> Unaddressed[int]:
        """Turn the motor by `by_counts`, and check that it does just that; its position then."""


class MotorFile(Protocol):
    """The functions of a family's file in this folder."""

    def motor_of(self, arm: ArmConfig, joint: int, now_ns: Callable[[], int]) -> Motor:
        """The dialogues with a joint's drive; `now_ns` is the clock."""

    def found_of(self, arm: ArmConfig, joint: int, reading: Any, report: DriveReport) -> Found:
        """What a drive is before anything moves, by the reading of its settings."""

    def tells_power_loss(self, reading: Any) -> bool:
        """Whether such a drive can report that it has lost power since it was homed."""


def motors_of(drive: Drive) -> MotorFile:
    """The file in this folder of a family whose motors can be turned."""
    return cast(MotorFile, families.file_of("calibration", drive))
