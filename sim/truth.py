"""What the drives of a live simulation truly did, as a file for tests and plots.

A NumPy archive with, for each joint, `<name>.times_ns` (CLOCK_MONOTONIC), `<name>.position_rad` and
`<name>.velocity_rad_s`, one row for each change of velocity and one for the moment of writing. The
position is linear in between.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

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


def save_truth(arm: SimulatedArm, path: Path) -> None:
    """Write the motion of every joint so far; the file appears complete or not at all."""
    columns: dict[str, Times | Reals] = {}
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
