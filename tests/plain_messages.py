"""Trajectories and goals as the front reads them from messages of ROS, and where an arm is then; without ROS."""

import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from rosfront.plan import Present


def duration(seconds: float) -> SimpleNamespace:
    whole = math.floor(seconds)
    return SimpleNamespace(sec=whole, nanosec=round((seconds - whole) * 1e9))


def point(
    time_s: float,
    positions: Sequence[float],
    velocities: Sequence[float] = (),
    accelerations: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> SimpleNamespace:
    return SimpleNamespace(
        time_from_start=duration(time_s),
        positions=list(positions),
        velocities=list(velocities),
        accelerations=list(accelerations),
        effort=list(effort),
    )


def trajectory(points: Sequence[SimpleNamespace], names: Sequence[str], stamp_s: float = 0.0) -> SimpleNamespace:
    header = SimpleNamespace(stamp=duration(stamp_s), frame_id="")
    return SimpleNamespace(header=header, joint_names=list(names), points=list(points))


def goal_of(wanted: SimpleNamespace) -> SimpleNamespace:
    """A goal with this trajectory and the default tolerances."""
    return SimpleNamespace(
        trajectory=wanted,
        multi_dof_trajectory=SimpleNamespace(joint_names=[], points=[]),
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=[],
        component_goal_tolerance=[],
        goal_time_tolerance=duration(0.0),
    )


def present(
    positions: Sequence[float] = (0.0,) * 6,
    *,
    standing: bool = True,
    monotonic_ns: int = 5_000_000_000,
    epoch_ns: int = 1_800_000_000 * 10**9,
) -> Present:
    """An arm that is commanded to be at these positions."""
    commanded = np.zeros((6, 3))
    commanded[:, 0] = positions
    return Present(commanded, standing, monotonic_ns, epoch_ns)
