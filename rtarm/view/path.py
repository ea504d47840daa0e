"""The way of the running goal, from the ring of waypoints in which the ROS process hands it to the control process."""

from __future__ import annotations

import contextlib
import zlib

import numpy as np

from motion.segment import cubic, evaluate, linear, quintic
from shm import files, layout
from shm.errors import SharedMemoryError
from shm.files import MemoryFile
from shm.words import Setpoint

POINTS = 240
"""A path is drawn with so many points at the most."""
MOST_WAYPOINTS = 20_000
"""Of a goal without end, such as a stream, as many of the newest."""

_NS = 1e-9
_LINEAR, _CUBIC, _QUINTIC = 1, 3, 5


class GoalPath:
    """The waypoints of one goal, gathered while they are in the ring: it keeps the newest 4096 records only."""

    def __init__(self, arm: str, joint_count: int) -> None:
        self._arm = arm
        self._used = layout.used_bytes(layout.Setpoint, joint_count)
        self._joint_count = joint_count
        self._memory: MemoryFile | None = None
        self._goal_id = 0
        self._read = 0
        self._waypoints: dict[int, tuple[int, np.ndarray]] = {}
        self._drawn = np.zeros((0, joint_count))

    def of(self, goal_id: int, start: np.ndarray) -> np.ndarray:
        """Joint angles (n, joints) along a goal, n at most `POINTS`; none for goal 0 and where none can be read.

        Args:
            start: position, velocity and acceleration (joints, 3) with which the goal began, from where it goes to its
                first waypoint.
        """
        if goal_id != self._goal_id:
            self.close()  # the file of a new control process is another one
            self._goal_id, self._read = goal_id, 0
            self._waypoints.clear()
            self._drawn = np.zeros((0, self._joint_count))
        if goal_id and self._gather():
            self._drawn = sampled(begun(self._waypoints, start), self._joint_count)
        return self._drawn

    def close(self) -> None:
        """Let go of the command file."""
        if self._memory is not None:
            self._memory.close()
            self._memory = None

    def _gather(self) -> bool:
        """Take what has come into the ring since; whether there was any."""
        if self._memory is None:
            with contextlib.suppress(SharedMemoryError):
                self._memory = files.open_command(self._arm)  # only to be read here
        if self._memory is None:
            return False
        written = int(self._memory.record["setpoints_written"][0])
        ring = self._memory.record["setpoints"]
        before = len(self._waypoints), self._read
        for number in range(max(self._read, written - layout.SETPOINT_SLOTS + 1), written):
            raw = ring[number % layout.SETPOINT_SLOTS].tobytes()[: self._used]
            if zlib.crc32(raw[8:]) != int.from_bytes(raw[:8], "little"):
                continue
            waypoint = np.frombuffer(raw.ljust(layout.Setpoint.dtype.itemsize, b"\0"), layout.Setpoint.dtype)[0]
            if int(waypoint["goal_id"]) == self._goal_id and int(waypoint["kind"]) == Setpoint.WAYPOINT:
                joints = waypoint["joints"][: self._joint_count]
                state = np.stack([joints[name] for name in joints.dtype.names], axis=-1)
                self._waypoints[int(waypoint["time_ns"])] = (int(waypoint["order"]), state)
        for old in sorted(self._waypoints)[:-MOST_WAYPOINTS]:
            del self._waypoints[old]
        self._read = written
        return (len(self._waypoints), self._read) != before


Waypoints = dict[int, tuple[int, np.ndarray]]
"""Time (ns) → order of the segment that ends there, and position, velocity and acceleration (joints, 3)."""


def begun(waypoints: Waypoints, start: np.ndarray) -> Waypoints:
    """Waypoints with one at time 0: where the goal began, unless they say so themselves."""
    return waypoints if not waypoints or 0 in waypoints else {0: (_QUINTIC, start), **waypoints}


def sampled(waypoints: Waypoints, joint_count: int) -> np.ndarray:
    """Joint angles (n, joints) at equal steps of time along waypoints; none where there are fewer than two."""
    if len(waypoints) < 2:
        return np.zeros((0, joint_count))
    times_ns = sorted(waypoints)
    times_s = np.array(times_ns) * _NS
    orders = np.array([waypoints[at][0] for at in times_ns])
    states = np.stack([waypoints[at][1] for at in times_ns])
    at_s = np.linspace(times_s[0], times_s[-1], POINTS)
    end = np.clip(np.searchsorted(times_s, at_s), 1, len(times_s) - 1)
    (p0, v0, a0), (p1, v1, a1) = (np.moveaxis(states[index], -1, 0) for index in (end - 1, end))
    duration_s = (times_s[end] - times_s[end - 1])[:, None]
    along_s = (at_s - times_s[end - 1])[:, None]
    order = orders[end][:, None]
    return np.where(
        order == _LINEAR,
        _positions(linear(p0, p1, duration_s), along_s),
        np.where(
            order == _CUBIC,
            _positions(cubic(p0, v0, p1, v1, duration_s), along_s),
            _positions(quintic(p0, v0, a0, p1, v1, a1, duration_s), along_s),
        ),
    )


def _positions(coefficients: tuple[np.ndarray, ...], along_s: np.ndarray) -> np.ndarray:
    c0, c1, c2, c3, c4, c5 = coefficients
    positions: np.ndarray = evaluate(c0, c1, c2, c3, c4, c5, along_s)[0]
    return positions


def thinned(points: np.ndarray) -> np.ndarray:
    """At most `POINTS` of some points, the first and the last among them."""
    if len(points) <= POINTS:
        return points
    kept: np.ndarray = points[np.linspace(0, len(points) - 1, POINTS).round().astype(int)]
    return kept
