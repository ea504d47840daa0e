"""An arm in virtual time whose commanded motion is kept, cycle by cycle, and judged to the last digit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from virtual import VirtualArm

from config.schema import ArmConfig


class CommandedArm(VirtualArm):
    """Brought up; `positions` begins with where it holds then, `times` are those of the cycles (monotonic, ns)."""

    def __init__(self, arm: ArmConfig | str = "mock", start_rad: Sequence[float] | None = None, **options: Any) -> None:
        super().__init__(arm, start_rad=start_rad, **options)
        self.positions: list[np.ndarray] = []
        self.times: list[int] = []
        drives_keep_it = start_rad is None or self.sim is not None
        assert self.bring_up(mock_positions_rad=None if drives_keep_it else list(start_rad)).failure is None
        self.positions, self.times = [self.commanded()], [self.now_ns]

    def commanded(self) -> np.ndarray:
        return self.loop[0]["axes"]["commanded"]["position_rad"][: len(self.arm.joints)].copy()

    def cycle(self, periods: int = 1) -> None:
        super().cycle(periods)
        self.positions.append(self.commanded())
        self.times.append(self.now_ns)

    def acceleration_ratio(self, first: int = 0) -> float:
        """Largest commanded acceleration, from a cycle on, as a multiple of its joint's limit."""
        return float(np.abs(acceleration_ratios(np.array(self.positions[first:]), self)).max())


def acceleration_ratios(positions: np.ndarray, arm: VirtualArm) -> np.ndarray:
    """Accelerations of positions at consecutive cycles (n, joints) as multiples of the joints' limits."""
    limits = np.array([joint.max_acceleration_rad_s2 for joint in arm.arm.joints])
    ratios: np.ndarray = np.diff(positions, 2, axis=0) / (arm.period_ns * 1e-9) ** 2 / limits
    return ratios
