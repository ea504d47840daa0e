"""A loop of 50 Hz that sees the arm and says where it is to be, as a policy does: `python observe_act.py [ARM]`."""

from __future__ import annotations

import math
import sys
import time

import numpy as np

import rtarm

RATE_HZ = 50.0
DURATION_S = 4.0


class Policy:
    """Where yours goes: this one draws an eight with the first and the last joint, about where the arm stood."""

    def __init__(self, position_rad: np.ndarray) -> None:
        self._about_rad = position_rad

    def act(self, time_s: float, position_rad: np.ndarray) -> np.ndarray:
        """All joints (rad) a moment from now."""
        target_rad = self._about_rad.copy()
        softly = min(1.0, time_s, DURATION_S - time_s)
        target_rad[0] += 0.1 * softly * math.sin(math.pi * time_s)
        target_rad[-1] += 0.1 * softly * math.sin(2.0 * math.pi * time_s)
        return target_rad


def main() -> None:
    """The program."""
    with rtarm.connect(sys.argv[1] if len(sys.argv) > 1 else None) as arm, arm.stream(rate_hz=RATE_HZ) as stream:
        policy = Policy(arm.state().commanded_rad)
        begun_s = time.monotonic()
        for step in range(round(DURATION_S * RATE_HZ)):
            observed = arm.state()
            stream.send(policy.act(step / RATE_HZ, observed.position_rad))
            time.sleep(max(0.0, begun_s + (step + 1) / RATE_HZ - time.monotonic()))
        print(f"{step + 1} actions in {time.monotonic() - begun_s:.1f} s.")


if __name__ == "__main__":
    main()
