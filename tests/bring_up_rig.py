"""What tests of bring-up in virtual time have in common: what a drive was told by others, and how far joints went."""

import numpy as np
from motion_figures import sampled_truth
from virtual import VirtualArm

from sim.bus import Frame


def tell(arm: VirtualArm, joint: int, can_id: int, data: bytes, *, extended: bool = False) -> None:
    """Somebody else says something to a drive; its answer is lost."""
    drive = arm.sim.drives[joint]
    drive.receive(arm.sim.now_ns, Frame(can_id, data, extended=extended))
    drive.outbox.clear()


def way(arm: VirtualArm, joint: int, since_ns: int | None = None) -> float:
    """Between the farthest places at which a shaft has been since then, or ever (rad)."""
    _, position_rad, _ = sampled_truth(
        arm.sim, joint, arm.sim.start_ns if since_ns is None else since_ns, arm.sim.now_ns
    )
    return float(np.ptp(position_rad))


def farthest(arm: VirtualArm, since_ns: int | None = None) -> float:
    """The same of the joint that has gone farthest."""
    return max(way(arm, joint, since_ns) for joint in range(len(arm.arm.joints)))


def failure_of(arm: VirtualArm, **options: bool) -> str:
    """Why the arm does not come up."""
    failure = arm.bring_up(**options).failure
    assert failure is not None
    return str(failure)
