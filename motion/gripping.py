"""Whether a gripper has reached its target, or something stands between its fingers: judged from where it is.

A gripper that does not move any more although it is not where it should be has gripped something. Speeds and currents
would say so sooner, but not every gripper tells them, and what all of them tell is where they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

AGREEING = 2
"""Readings in a row that say it has arrived: one alone may be garbled."""
STILL_SHARE = 0.25
"""Moving by less than this share of the tolerance is standing."""


class Grip(IntEnum):
    """What a gripper is doing."""

    UNKNOWN = 0  # nothing has been read yet
    MOVING = 1
    REACHED = 2
    STALLED = 3  # something stands between its fingers, and it holds there
    HELD = 4  # it was stopped and holds where it was
    TROUBLE = 5  # it cannot do what it was told; the trouble says why


def stall_ns(stall_s: float, tolerance_rad: float, speed_rad_s: float) -> int:
    """How long a gripper must stand to have gripped something: at a crawl it takes its time to be seen moving."""
    return round(1e9 * max(stall_s, 2.0 * STILL_SHARE * tolerance_rad / speed_rad_s))


@dataclass
class GripJudge:
    """One motion of a gripper, from its command to its end."""

    target_rad: float
    tolerance_rad: float
    """Distance from the target within which it is reached."""
    stall_ns: int
    """Standing for so long elsewhere is a stall."""
    stood_rad: float
    """Where it was when it was last seen to move."""
    stood_ns: int
    """When that was."""
    _near: int = 0

    def judge(self, now_ns: int, position_rad: float) -> Grip:
        """What it is doing by the position read at `now_ns` (any clock, the same all along): MOVING until it ends."""
        if abs(position_rad - self.target_rad) <= self.tolerance_rad:
            self._near += 1
            return Grip.REACHED if self._near >= AGREEING else Grip.MOVING
        self._near = 0
        if abs(position_rad - self.stood_rad) > STILL_SHARE * self.tolerance_rad:
            self.stood_rad, self.stood_ns = position_rad, now_ns
        return Grip.STALLED if now_ns - self.stood_ns >= self.stall_ns else Grip.MOVING
