"""The hook: the few methods that a gripper must have; the rest of this package does everything else for it.

`simulated.py` and `servo.py` are such hooks, and an arm file may name another one (docs/hardware/gripper.md). All its
methods are called from one thread, one after the other. Each may take its time, but none may wait for a motion to end.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from motion.gripping import Grip

__all__ = ["Grip", "Gripper", "GripperTrouble", "Reading"]


class GripperTrouble(Exception):
    """The gripper cannot do what it was told, or cannot be read; the text is the sentence that users read."""


class NotThereYet(GripperTrouble):
    """What moves the gripper is still starting, or gone; that is reported elsewhere."""


class Reading(NamedTuple):
    """Where a gripper is."""

    position_rad: float
    """NaN is allowed with Grip.MOVING only: the gripper is finding out where it is (homing)."""
    velocity_rad_s: float = math.nan
    effort: float = math.nan
    """Torque at its joint (N·m); NaN where it is not measured."""
    grip: Grip | None = None
    """What the gripper itself knows of its motion; None where that is to be judged from its positions."""
    trouble: str = ""
    """With Grip.TROUBLE, the sentence that says what is wrong; the position is right all the same."""
    measured_ns: int = 0
    """CLOCK_MONOTONIC of the measurement; 0 means just now."""


class Gripper(Protocol):
    """What moves a gripper; any method may raise GripperTrouble.

    A gripper that can home, such as by closing to its stop, also has a method `home()`, which begins that.
    """

    def move(self, position_rad: float, max_effort: float) -> None:
        """Begin to move there, from wherever it is; a newer call replaces an older one.

        `position_rad` is inside the arm file's range; `max_effort` (N·m) is 0 where none was named.
        """

    def stop(self) -> None:
        """Stop and hold the position; called after a cancel, and where something was gripped."""

    def read(self) -> Reading:
        """The gripper's present state; called ten or twenty times a second."""

    def close(self) -> None:
        """Called at shutdown: close what was opened, and leave the gripper as it is."""
