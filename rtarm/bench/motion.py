"""The goal that plays while somebody is measured: every joint goes and comes back, smoothly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

WAYPOINT_S = 0.05
AMPLITUDE_RAD_A_SECOND = 0.03
"""Way of each joint, a second of the goal; the slowest joints of the arms we know take thrice that speed."""


def there_and_back(joint_names: Sequence[str], start_rad: Sequence[float], duration_s: float) -> dict[str, Any]:
    """A FollowJointTrajectory goal, as JSON has it: q = start + a (1 - cos 2πt/T) / 2 and its derivative.

    The first and the last point are `start_rad`, both at rest.
    """
    way_rad, turn = AMPLITUDE_RAD_A_SECOND * duration_s, 2.0 * math.pi / duration_s
    waypoints = max(2, round(duration_s / WAYPOINT_S))
    points = []
    for waypoint in range(waypoints + 1):
        time_s = duration_s * waypoint / waypoints
        offset_rad = 0.5 * way_rad * (1.0 - math.cos(turn * time_s))
        velocity_rad_s = 0.5 * way_rad * turn * math.sin(turn * time_s) if waypoint < waypoints else 0.0
        sec, nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
        points.append(
            {
                "positions": [start + offset_rad for start in start_rad],
                "velocities": [velocity_rad_s for _ in start_rad],
                "time_from_start": {"sec": sec, "nanosec": nanosec},
            }
        )
    return {"trajectory": {"joint_names": list(joint_names), "points": points}}
