"""A serialised request for follow_joint_trajectory as what its checks look at; its points never become messages.

What stands beside the points is small or refused, and is left to rclpy: the request without its trajectory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.serialization import deserialize_message

from rosfront.refusals import TooMuchBeside, Unreadable
from rosfront.trajectory_bytes import ENCAPSULATION, LITTLE_ENDIAN_CDR, MOST_BESIDE, Trajectory, trajectory_at

Request: Any = FollowJointTrajectory.Impl.SendGoalService.Request
"""rclpy's class of a goal request: the goal's id, then the goal, which begins with the trajectory."""
Response: Any = FollowJointTrajectory.Impl.SendGoalService.Response
_ID_SIZE = 16
_NO_TRAJECTORY = {
    end: bytes(_ID_SIZE + 8) + len(frame).to_bytes(4, "little") + frame + bytes(-len(frame) % 4 + 8)
    for end, frame in ((0, b"\0"), (4, b"\0\0\0\0\0"))
}
"""A goal's id and a trajectory without joints and points; the name of its frame makes it end there, modulo 8."""


class Goal(NamedTuple):
    """What of a FollowJointTrajectory goal its checks look at."""

    trajectory: Trajectory
    multi_dof_trajectory: Any
    path_tolerance: Any
    component_path_tolerance: Any
    goal_tolerance: Any
    component_goal_tolerance: Any
    goal_time_tolerance: Any


def goal_id(data: np.ndarray) -> bytes:
    """Whose request a serialised one is."""
    return data[ENCAPSULATION : ENCAPSULATION + _ID_SIZE].tobytes()


def read_goal(data: np.ndarray, most_points: int) -> Goal:
    """The goal in a serialised request, (n,) bytes; raises TooManyPoints, TooMuchBeside, Unreadable."""
    found = None
    body = memoryview(data)[ENCAPSULATION:]  # type: ignore[arg-type]  # an array is a buffer
    if data[:2].tobytes() == LITTLE_ENDIAN_CDR:
        found = trajectory_at(body, _ID_SIZE, most_points)
    if found is None:
        raise _unreadable(data)
    trajectory, end = found
    if len(body) - end > MOST_BESIDE:
        raise TooMuchBeside(MOST_BESIDE)
    rest = b"".join((LITTLE_ENDIAN_CDR, bytes(2), _NO_TRAJECTORY[end % 8], body[end:]))
    try:
        goal = deserialize_message(rest, Request).goal
    except RuntimeError as problem:  # the root of all of rclpy's own, whose classes are private
        raise _unreadable(data) from problem
    return Goal(trajectory, *(getattr(goal, field) for field in Goal._fields[1:]))


def _unreadable(data: np.ndarray) -> Unreadable:
    return Unreadable(len(data), "request for control_msgs/action/FollowJointTrajectory")
