"""What a family's file `<family>_gripper.py` offers to ordinary Python: the drive of a gripper on the arm's bus."""

from __future__ import annotations

import importlib
import math
from typing import Protocol, cast

from config.gripper import GripperConfig, GripperServo
from rtloop.service.conversation import Dialogue, Unaddressed
from shm.words import GripTrouble


class Trouble(Exception):
    """The gripper's drive cannot do what was requested, or cannot be used at all; `kind` says why."""

    def __init__(self, kind: GripTrouble, value: float = math.nan) -> None:
        super().__init__(kind)
        self.kind, self.value = kind, value


class GripperHost(Protocol):
    """The conversation with the gripper's drive, as the drive's code sees it."""

    now_ns: int

    @property
    def waits(self) -> bool:
        """Whether a newer order waits."""

    def show(self) -> None:
        """Publish the gripper's state."""


class GripperDrive(Protocol):
    """The drive of a gripper; angles are the gripper's (rad), and every part of a dialogue raises Trouble."""

    def addressed(self, turn: Unaddressed[None]) -> Dialogue:
        """A turn of the conversation, addressed to this drive."""

    def get_to_know(self) -> Unaddressed[None]:
        """Check that the drive matches the arm file, and let it hold its position if it is moving."""

    def make_able(self) -> Unaddressed[None]:
        """Clear the drive's protection and enable it, where that is needed; a lost count stays lost."""

    def limit_effort(self, effort: float) -> Unaddressed[None]:
        """Limit the drive's torque (N·m); 0 restores the limit that the drive was found with."""

    def go_to(self, angle_rad: float) -> Unaddressed[None]:
        """Command a motion, and check that the drive has taken it."""

    def hold(self) -> Unaddressed[None]:
        """Stop the drive where it is, so that it neither moves nor pushes."""

    def home(self) -> Unaddressed[None]:
        """Run the drive to its stop, from which it counts; an order that comes meanwhile ends the run."""

    def position_rad(self) -> Unaddressed[float]:
        """The gripper's angle."""

    def look(self, moves: bool) -> Unaddressed[GripTrouble]:
        """What is wrong with a drive whose count means an angle.

        If the drive is stalled while no motion is commanded (`moves` is False), it is told to hold where it is.
        """

    def measure_effort(self, nm_per_ampere: float) -> Unaddressed[float]:
        """The drive's torque (N·m); NaN if the drive does not report it."""


def gripper_drive_of(servo: GripperServo, gripper: GripperConfig, host: GripperHost) -> GripperDrive:
    """The drive of a gripper, as its family's file implements it."""
    family = importlib.import_module(f"rtloop.drives.{servo.family}_gripper")
    return cast(GripperDrive, family.Gripper(servo, gripper, host))
