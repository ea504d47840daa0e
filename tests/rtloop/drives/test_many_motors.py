"""RobStride and MyActuator motors in arms of one and of 32 joints, and beside drives of other families."""

from typing import Any

import numpy as np
import pytest
from mixed_arm import ODRIVE, ZDT, arm_of
from virtual import VirtualArm

from config.schema import ArmConfig
from shm.words import Mode, Outcome

CONTROL = {"family": "robstride", "mode": "control", "kp": 200.0, "kd": 5.0, "encoder": "absolute"}
CSP = {"family": "robstride", "mode": "csp", "encoder": "absolute"}
MYACTUATOR = {"family": "myactuator", "encoder": "absolute"}


def goes_there(arm: ArmConfig, by_rad: float = 0.1) -> None:
    """All joints go to a place within a second."""
    virtual = VirtualArm(arm)
    assert virtual.bring_up(at_most_s=60.0).failure is None, virtual.told
    virtual.until(lambda: virtual.memory["mode"] == Mode.HOLDING, at_most_s=5.0)
    count = len(arm.joints)
    joints = np.zeros((2, count, 3))
    joints[:, :, 0] = virtual.loop[0]["axes"]["commanded"]["position_rad"][:count]
    joints[1, :, 0] += by_rad
    goal = virtual.send_goal(np.array([0, 1_000_000_000]), joints, order=3)
    assert virtual.end_of(goal) == Outcome.SUCCEEDED
    virtual.cycles(int(0.5e9 / virtual.period_ns))
    for joint in range(count):
        assert virtual.sim.true_position_rad(joint, virtual.sim.now_ns - 1) == pytest.approx(by_rad, abs=2e-3)
    virtual.close()


@pytest.mark.parametrize(
    ("drive", "rate_hz"), [(CONTROL, 60), (CSP, 40), (MYACTUATOR, 45)], ids=["control", "csp", "myactuator"]
)
@pytest.mark.parametrize("count", [1, 32])
def test_arms_have_one_to_32_joints(drive: dict[str, Any], rate_hz: float, count: int) -> None:
    drives = [{**drive, "motor_id": number} for number in range(1, count + 1)]
    goes_there(arm_of(drives, rate_hz=rate_hz, interface="socketcan"))


def test_four_families_share_a_bus() -> None:
    drives = [
        {**ZDT, "address": 1},
        {**ODRIVE, "node_id": 2},
        {**CONTROL, "motor_id": 21},
        {**MYACTUATOR, "motor_id": 4},
        {**CSP, "motor_id": 22},
        {**ZDT, "address": 6},
    ]
    goes_there(arm_of(drives, rate_hz=150))
