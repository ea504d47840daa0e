"""What passes between checking a goal and streaming it."""

from dataclasses import dataclass

import numpy as np

NS = 1_000_000_000


@dataclass(frozen=True)
class GoalPlan:
    """A checked goal, ready for the setpoint ring; joints in configuration order, all of the arm's."""

    times_ns: np.ndarray
    """(n,) from the start of the trajectory."""
    orders: np.ndarray
    """(n,) order of the segment that ends in the knot."""
    joints: np.ndarray
    """(n, joints, 3): position rad, velocity rad/s, acceleration rad/s²."""
    joint_mask: int
    tolerances: np.ndarray
    """(joints, 3): path rad, goal rad, goal velocity rad/s; 0 = off."""
    goal_time_s: float
    """Patience after the last point; 0 = without limit."""
    start_ns: int
    """CLOCK_MONOTONIC at which the trajectory's time is 0; 0 = at once."""
    bridge: bool

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
