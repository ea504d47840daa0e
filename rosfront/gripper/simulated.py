"""A simulated gripper: it moves at its speed, and stops at an object that `options.object_deg` puts in its way."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from config.gripper import GripperConfig
from rosfront.gripper.hook import GripperTrouble, Reading


class SimulatedGripper:
    """Begins open, at rest."""

    def __init__(self, config: GripperConfig, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Raises GripperTrouble when `object_deg` is no angle."""
        self._speed_rad_s = config.speed_rad_s
        self._clock_s = clock_s
        self._from_rad = self._to_rad = config.open_rad
        self._since_s = clock_s()
        thing = config.options.get("object_deg", -math.inf)
        if isinstance(thing, bool) or not isinstance(thing, (int, float)) or math.isnan(thing):
            raise GripperTrouble(f"options.object_deg of the gripper is {thing!r}; write an angle in degrees.")
        self._object_rad = math.radians(thing)

    def move(self, position_rad: float, max_effort: float) -> None:
        """Move at the arm file's speed, whatever the effort."""
        here_rad = self.read().position_rad
        if position_rad < here_rad:
            position_rad = min(here_rad, max(position_rad, self._object_rad))
        self._from_rad, self._to_rad, self._since_s = here_rad, position_rad, self._clock_s()

    def stop(self) -> None:
        """Stop at once."""
        self._from_rad = self._to_rad = self.read().position_rad

    def read(self) -> Reading:
        """The exact position and velocity."""
        way_rad = self._to_rad - self._from_rad
        gone_rad = min(abs(way_rad), self._speed_rad_s * (self._clock_s() - self._since_s))
        velocity_rad_s = self._speed_rad_s if gone_rad < abs(way_rad) else 0.0
        return Reading(self._from_rad + math.copysign(gone_rad, way_rad), math.copysign(velocity_rad_s, way_rad))

    def close(self) -> None:
        """Nothing to do, since nothing was opened."""
