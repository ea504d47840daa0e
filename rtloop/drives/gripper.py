"""What a family's file `<family>_gripper.py` has for ordinary Python: the drive of a gripper on the arm's bus."""

from __future__ import annotations

import importlib
import math
from typing import Protocol, cast

from config.gripper import GripperConfig, GripperServo
from rtloop.service.conversation import Dialogue, Unaddressed
from shm.words import GripTrouble


class Trouble(Exception):
    """What was asked cannot be done, or nothing can."""

    def __init__(self, kind: GripTrouble, value: float = math.nan) -> None:
        super().__init__(kind)
        self.kind, self.value = kind, value


class GripperHost(Protocol):
    """The conversation that a gripper's drive is part of."""

    now_ns: int

    @property
    def waits(self) -> bool:
        """Whether there is a newer order."""

    def show(self) -> None:
        """Publish how the gripper is."""


class GripperDrive(Protocol):
    """The drive of a gripper; angles are the gripper's (rad), and every part raises Trouble."""

    def addressed(self, turn: Unaddressed[None]) -> Dialogue:
        """A turn of the conversation, said to this drive."""

    def get_to_know(self) -> Unaddressed[None]:
        """See that the drive is what the arm file says, and let it hold where it stands if it is on its way."""

    def make_able(self) -> Unaddressed[None]:
        """Let a drive that has let go hold again; a lost count stays lost."""

    def limit_effort(self, effort: float) -> Unaddressed[None]:
        """Let it push no harder than this (N·m); with 0, as hard as it was found to."""

    def go_to(self, angle_rad: float) -> Unaddressed[None]:
        """Command the motion, and see that the drive has taken it."""

    def hold(self) -> Unaddressed[None]:
        """Let it stand where it is, so that it neither moves nor pushes."""

    def home(self) -> Unaddressed[None]:
        """Let the drive find its stop, from which it counts; an order that comes meanwhile ends that."""

    def position_rad(self) -> Unaddressed[float]:
        """Where it is."""

    def look(self, moves: bool) -> Unaddressed[GripTrouble]:
        """What is wrong with a drive whose count means an angle; one that pushes although nothing moves it holds."""

    def measure_effort(self, nm_per_ampere: float) -> Unaddressed[float]:
        """How hard it pushes (N·m); NaN where it does not say."""


def gripper_drive_of(servo: GripperServo, gripper: GripperConfig, host: GripperHost) -> GripperDrive:
    """What is said to the drive of a gripper, by its family's file."""
    family = importlib.import_module(f"rtloop.drives.{servo.family}_gripper")
    return cast(GripperDrive, family.Gripper(servo, gripper, host))
