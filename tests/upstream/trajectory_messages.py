"""Goals and trajectories as they come over ROS, in the words of the upstream controller's cases."""

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

NS = 1_000_000_000
Numbers = Sequence[float]


def duration(seconds: float) -> Duration:
    whole, rest = divmod(round(seconds * NS), NS)
    return Duration(sec=whole, nanosec=rest)


def point(
    time_s: float,
    positions: Numbers = (),
    velocities: Numbers = (),
    accelerations: Numbers = (),
    effort: Numbers = (),
) -> JointTrajectoryPoint:
    """One point; a field that is left out stays empty."""
    fields = {"positions": positions, "velocities": velocities, "accelerations": accelerations, "effort": effort}
    return JointTrajectoryPoint(
        time_from_start=duration(time_s), **{name: [float(n) for n in values] for name, values in fields.items()}
    )


def trajectory(*points: JointTrajectoryPoint, names: Iterable[str] = "abc", stamp_ns: int = 0) -> JointTrajectory:
    """A message of ~/joint_trajectory; the stamp counts on the clock of ROS."""
    message = JointTrajectory(joint_names=list(names), points=list(points))
    seconds, rest = divmod(stamp_ns, NS)
    message.header.stamp = Time(sec=seconds, nanosec=rest)
    return message


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> JointTolerance:
    return JointTolerance(name=name, position=position, velocity=velocity, acceleration=acceleration)


def tolerances(position: float, joints: str = "abc") -> list[JointTolerance]:
    """The same allowance in position for every joint."""
    return [tolerance(name, position) for name in joints]


def goal(
    *points: JointTrajectoryPoint,
    names: Iterable[str] = "abc",
    stamp_ns: int = 0,
    path: Sequence[JointTolerance] = (),
    arrival: Sequence[JointTolerance] = (),
    time_s: float = 0.0,
) -> Any:
    """A goal of the action, with what it allows on its path and at its arrival."""
    return FollowJointTrajectory.Goal(
        trajectory=trajectory(*points, names=names, stamp_ns=stamp_ns),
        path_tolerance=list(path),
        goal_tolerance=list(arrival),
        goal_time_tolerance=duration(time_s),
    )
