"""The hook: what a gripper must be able to do, so that everything else can be done for it.

`simulated.py` and `servo.py` are such hooks, and an arm file may name another one (docs/hardware/gripper.md). All its
methods are called from one thread, one after the other; none may wait for a motion to end, though each may take its
time.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from motion.gripping import Grip

__all__ = ["Grip", "Gripper", "GripperTrouble", "Reading"]


class GripperTrouble(Exception):
    """The gripper cannot do what it was told, or cannot be read; the text is the sentence people read."""


class NotThereYet(GripperTrouble):
    """What moves the gripper is still starting, or gone, which is said elsewhere."""


class Reading(NamedTuple):
    """Where a gripper is."""

    position_rad: float
    """NaN with Grip.MOVING alone: it is finding out where it is."""
    velocity_rad_s: float = math.nan
    effort: float = math.nan
    """Torque at its joint (N·m); NaN where it is not measured."""
    grip: Grip | None = None
    """What the gripper itself knows of its motion; None lets that be judged from where it is."""
    trouble: str = ""
    """With Grip.TROUBLE, the sentence that says what is wrong; its position is right all the same."""
    measured_ns: int = 0
    """CLOCK_MONOTONIC of the measurement; 0 is just now."""


class Gripper(Protocol):
    """What moves a gripper; any method may raise GripperTrouble.

    One that can find out where it is, such as by closing to its stop, has a method `home()` too, which begins that.
    """

    def move(self, position_rad: float, max_effort: float) -> None:
        """Begin to move there, from wherever it is; a newer call replaces an older one.

        `position_rad` is inside the arm file's range; `max_effort` (N·m) is 0 where none was named.
        """

    def stop(self) -> None:
        """Stand still and hold: after a cancel, and where something was gripped."""

    def read(self) -> Reading:
        """Where it is; called ten or twenty times a second."""

    def close(self) -> None:
        """The program ends: let go of what was opened, leave the gripper as it is."""
