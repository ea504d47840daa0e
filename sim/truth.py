"""What the drives of a live simulation truly did and what their adapter was told, as a file for tests and plots.

A NumPy archive with, for each joint, `<name>.times_ns` (CLOCK_MONOTONIC), `<name>.position_rad` and
`<name>.velocity_rad_s`, one row for each change of velocity and one for the moment of writing. The
position is linear in between. `wire_ns`, `wire_ends` and `wire_bytes` are what the host wrote: when the simulation
read it, where in the bytes each such piece ends, and the bytes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arm import SimulatedArm
from sim.drives.shaft import Reals, Times


@dataclass(frozen=True)
class JointTruth:
    """True motion of one joint."""

    times_ns: Times
    position_rad: Reals
    velocity_rad_s: Reals

    def position_at(self, times_ns: Times) -> Reals:
        """True positions [rad] at any times between the first and the last."""
        # Subtracted as integers: a float cannot hold nanoseconds since boot exactly.
        start_ns = self.times_ns[0]
        position_rad: Reals = np.interp(times_ns - start_ns, self.times_ns - start_ns, self.position_rad)
        return position_rad

    def velocity_at(self, times_ns: Times) -> Reals:
        """True velocities [rad/s] at any times between the first and the last."""
        index = np.searchsorted(self.times_ns, times_ns, side="right") - 1
        return self.velocity_rad_s[np.maximum(index, 0)]


Heard = list[tuple[int, bytes]]
"""What the host wrote: (CLOCK_MONOTONIC ns, bytes), oldest first."""


def save_truth(arm: SimulatedArm, path: Path, heard: Heard) -> None:
    """Write the motion of every joint so far; the file appears complete or not at all."""
    columns: dict[str, NDArray[Any]] = {
        "wire_ns": np.array([time_ns for time_ns, _ in heard], np.int64),
        "wire_ends": np.cumsum([len(data) for _, data in heard], dtype=np.int64),
        "wire_bytes": np.frombuffer(b"".join(data for _, data in heard), np.uint8),
    }
    for index, joint in enumerate(arm.config.joints):
        times_ns = arm.truth_changes(index)
        position_rad, velocity_rad_s = arm.truth(index, times_ns)
        columns[f"{joint.name}.times_ns"] = times_ns
        columns[f"{joint.name}.position_rad"] = position_rad
        columns[f"{joint.name}.velocity_rad_s"] = velocity_rad_s
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **columns)
    os.replace(partial, path)


def load_truth(path: Path) -> dict[str, JointTruth]:
    """Read a file written by `save_truth`: the motion of each joint by its name."""
    with np.load(path) as columns:
        names = [key.removesuffix(".times_ns") for key in columns if key.endswith(".times_ns")]
        return {
            name: JointTruth(
                columns[f"{name}.times_ns"],
                columns[f"{name}.position_rad"],
                columns[f"{name}.velocity_rad_s"],
            )
            for name in names
        }


def load_wire(path: Path) -> Heard:
    """Read what the host wrote from a file written by `save_truth`."""
    with np.load(path) as columns:
        data = columns["wire_bytes"].tobytes()
        ends = [0, *columns["wire_ends"].tolist()]
        times_ns = columns["wire_ns"].tolist()
    return [(time_ns, data[begin:end]) for time_ns, (begin, end) in zip(times_ns, pairwise(ends), strict=True)]
