"""Nothing moves while drives are brought up, whatever a serial line makes of what they say."""

import numpy as np
import pytest
from virtual import VirtualArm

from sim.faults import CorruptBytes

ARMS = (
    "cia402_6",
    "damiao6",
    "damiao6_pv",
    "episode1",
    "mks6",
    "myactuator6",
    "odrive6",
    "robstride6",
    "robstride6_position",
    "vesc6",
)
STANDS_RAD = 0.03
SETTLING_S = 0.5


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ARMS)
def test_no_joint_moves_by_what_was_garbled(name: str, seed: int) -> None:
    """Found by chance: one flipped bit of a CiA 402 drive's position became its target, 1.9 rad away."""
    start = [0.2, -0.1, 0.15, 0.3, -0.2, 0.25]
    arm = VirtualArm(name, start_rad=start, seed=seed)
    assert arm.sim is not None
    arm.sim.inject(CorruptBytes(0.01), arm.now_ns)
    arm.bring_up(at_most_s=60.0)
    arm.cycles(round(SETTLING_S * 1e9 / arm.period_ns))
    true_rad = [arm.sim.true_position_rad(joint, arm.sim.now_ns) for joint in range(6)]
    np.testing.assert_allclose(true_rad, start, atol=STANDS_RAD)
    arm.close()
