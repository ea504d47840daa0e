"""What passes between checking a goal and streaming it."""

from dataclasses import dataclass

import numpy as np

from rosfront.refusals import GoalRefused
from shm.words import Entry

NS = 1_000_000_000
REST_RAD_S = 1e-3
"""A last velocity up to this is a residue that planners leave, and rest to the control process."""


@dataclass(frozen=True)
class Terms:
    """What a goal is allowed; all in SI, 0 = off."""

    path_tolerances: np.ndarray
    """(joints, 3): largest error in position, velocity, acceleration on the way."""
    goal_tolerances: np.ndarray
    """(joints, 3): the same at the end."""
    goal_time_s: float
    """Patience after the last point; 0 = without limit."""


@dataclass(frozen=True)
class Sample:
    """What a trajectory asks for at one moment; arrays (joints,) in configuration order."""

    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray


@dataclass(frozen=True)
class GoalPlan:
    """A checked goal, ready for the setpoint ring; joints in configuration order, all of the arm's."""

    times_ns: np.ndarray
    """(n,) from the start of the trajectory."""
    orders: np.ndarray
    """(n,) order of the segment that ends in the waypoint."""
    joints: np.ndarray
    """(n, joints, 3): position rad, velocity rad/s, acceleration rad/s²."""
    joint_mask: int
    terms: Terms
    start_ns: int
    """CLOCK_MONOTONIC at which the trajectory's time is (or was) 0; 0 = at once."""
    entry_ns: int
    """Time of the trajectory at which it would have been entered when it was planned."""
    entry: Entry
    origin: np.ndarray
    """(joints, 3): where the arm was commanded when it was planned, from where an approach segment begins."""
    wanted: "GoalPlan | None" = None
    """What a stream's message asked for, where the plan only follows that; its start is known."""
    reason: GoalRefused | None = None
    """Which limit that would break; None where it is only that the arm lags behind."""

    @property
    def approach(self) -> bool:
        """Whether the way to the first point begins where the arm is commanded."""
        return bool(self.entry & Entry.APPROACH)

    @property
    def stream(self) -> bool:
        """Whether newer points are expected, so that the arm runs on straight past the last one."""
        return bool(self.entry & Entry.STREAM)

    @property
    def duration_s(self) -> float:
        return float(self.times_ns[-1]) / NS


@dataclass(frozen=True)
class Present:
    """Where the arm is commanded at a moment of both clocks."""

    commanded: np.ndarray
    """(joints, 3): position rad, velocity rad/s, acceleration rad/s²."""
    standing: bool
    """False while a goal moves the arm: then the control process judges the first point at adoption."""
    monotonic_ns: int
    epoch_ns: int
    awaited: bool = False
    """Whether the end of a goal is awaited: one that moves the arm, is held, or is yet to begin."""
