"""The data that passes from checking a goal to streaming it."""

from dataclasses import dataclass

import numpy as np

from rosfront.refusals import GoalRefused
from shm.words import Entry

NS = 1_000_000_000
REST_RAD_S = 1e-3
"""A last velocity up to this is a residue that planners leave; the control process treats it as rest."""


@dataclass(frozen=True)
class Terms:
    """The tolerances of a goal; all in SI, 0 = off."""

    path_tolerances: np.ndarray
    """(joints, 3): largest error in position, velocity, acceleration on the way."""
    goal_tolerances: np.ndarray
    """(joints, 3): the same at the end."""
    goal_time_s: float
    """Time allowed after the last point until the arm has arrived; 0 = without limit."""


@dataclass(frozen=True)
class Sample:
    """The setpoint of a trajectory at one moment; arrays (joints,) in configuration order."""

    position_rad: np.ndarray
    velocity_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray


@dataclass(frozen=True)
class GoalPlan:
    """A checked goal, ready for the setpoint ring; with all joints of the arm, in configuration order."""

    times_ns: np.ndarray
    """(n,) from the start of the trajectory."""
    orders: np.ndarray
    """(n,) order of the polynomial on the segment that ends in the waypoint: 1, 3 or 5."""
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
    """What a stream's message asked for, where this plan only follows it; its `start_ns` is not 0."""
    reason: GoalRefused | None = None
    """The limit that `wanted` would break; None where the arm only lags behind."""

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
    """The arm's commanded state at a moment, which is given by both clocks."""

    commanded: np.ndarray
    """(joints, 3): position rad, velocity rad/s, acceleration rad/s²."""
    standing: bool
    """False while a goal moves the arm: then the control process checks the first point when it enters the goal."""
    monotonic_ns: int
    epoch_ns: int
    awaited: bool = False
    """Whether the end of a goal is awaited: one that moves the arm, is held, or is yet to begin."""
