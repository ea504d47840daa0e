"""Goals recorded from MoveIt, as the demo plays them: checked here, sent by `rtarm.client`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtarm.console.errors import Refusal

TOUR = ("small", "single_joint", "large", "large_back")
"""Files beside this one; each starts where the one before ended, the first at zero, the last ends there."""

_REMEDY = (
    "give a FollowJointTrajectory goal as JSON, with trajectory.joint_names and trajectory.points, as MoveIt sends it"
)


@dataclass(frozen=True)
class Goal:
    """A recorded goal, as far as the demo must know it before it is sent."""

    name: str
    joint_names: tuple[str, ...]
    first_rad: tuple[float, ...]
    """Positions of the first point, in the order of `joint_names`."""
    planned_s: float
    document: dict[str, Any]
    """The whole goal, field for field."""


def tour() -> list[Goal]:
    """The goals of the demo when none is named."""
    return [load_goal(Path(__file__).with_name(f"{name}.json")) for name in TOUR]


def load_goal(path: Path) -> Goal:
    """Read a recorded goal.

    Only its form is checked, since judging its content is the ROS process' work.

    Raises:
        Refusal: there is no such file, or no goal in it.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise Refusal(f"{path} cannot be read ({error.strerror}): name an existing goal file.") from None
    except ValueError as error:
        raise Refusal(f"{path} is not JSON ({error}): {_REMEDY}.") from None
    try:
        return goal_of(path.stem, document)
    except (LookupError, TypeError, ValueError, OverflowError):
        raise Refusal(f"{path} holds no goal with joint names and points: {_REMEDY}.") from None


def goal_of(name: str, document: dict[str, Any]) -> Goal:
    """A goal from its fields; raises LookupError, TypeError, ValueError, OverflowError where they are none."""
    trajectory = document["trajectory"]
    names, points = trajectory["joint_names"], trajectory["points"]
    first_rad = _numbers(points[0]["positions"])
    if not all(isinstance(joint, str) for joint in names) or len(first_rad) != len(names):
        raise ValueError("not a name and a position for each joint")
    return Goal(name, tuple(names), first_rad, seconds(points[-1]["time_from_start"]), document)


def seconds(duration: dict[str, Any]) -> float:
    """A ROS duration or time in seconds."""
    return int(duration["sec"]) + int(duration["nanosec"]) * 1e-9


def _numbers(values: Sequence[Any]) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)
    if not all(map(math.isfinite, numbers)):
        raise ValueError("not finite")
    return numbers
