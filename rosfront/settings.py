"""Settings of the goal checks that can be changed while the front runs, and their initial values."""

from __future__ import annotations

from dataclasses import dataclass

from config.schema import ArmConfig


@dataclass(frozen=True)
class Settings:
    """Defaults for every goal; replaced as a whole, so that a goal is checked by one consistent set."""

    path_tolerance_rad: tuple[float, ...]
    """One per joint; 0 = off."""
    goal_tolerance_rad: tuple[float, ...]
    """One per joint; 0 = off."""
    stopped_velocity_rad_s: float
    """Below this a joint counts as at rest; 0 = not checked."""
    goal_time_s: float
    """Time allowed after the last point until the arm has arrived; 0 = without limit."""
    allow_nonzero_end_velocity: bool
    allow_partial_joints_goal: bool
    feedback_hz: float

    @classmethod
    def of(cls, arm: ArmConfig) -> Settings:
        """The values of the arm file."""
        trajectory, count = arm.trajectory, len(arm.joints)
        return cls(
            path_tolerance_rad=(trajectory.path_tolerance_rad,) * count,
            goal_tolerance_rad=(trajectory.goal_tolerance_rad,) * count,
            stopped_velocity_rad_s=trajectory.stopped_velocity_rad_s,
            goal_time_s=trajectory.goal_time_s,
            allow_nonzero_end_velocity=trajectory.allow_nonzero_end_velocity,
            allow_partial_joints_goal=True,
            feedback_hz=arm.front.feedback_hz,
        )
