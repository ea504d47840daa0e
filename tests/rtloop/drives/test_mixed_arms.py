"""Drives of several families on one bus, and arms of one to 32 joints."""

from typing import Any

import numpy as np
import pytest
from mixed_arm import ODRIVE, ZDT, arm_of, mixed
from virtual import VirtualArm

from config.errors import ConfigError
from config.loader import known_arms, load_arm
from rtloop.memory.link import LISTENERS
from shm.layout import MAX_JOINTS
from shm.words import Answer, Fault, Mode, Outcome, Request
from sim.faults import Protection, Silent


def there_and_back(arm: VirtualArm, by_rad: float = 0.1) -> int:
    """A goal of all joints: away and back in two seconds."""
    count = len(arm.arm.joints)
    joints = np.zeros((3, count, 3))
    joints[:, :, 0] = arm.loop[0]["axes"]["commanded"]["position_rad"][:count]
    joints[1, :, 0] += by_rad
    return arm.send_goal(np.array([0, 1_000_000_000, 2_000_000_000]), joints, order=3)


def test_families_move_together_on_one_bus() -> None:
    arm = VirtualArm.brought_up(mixed())
    goal = there_and_back(arm)
    arm.cycles(int(1e9 / arm.period_ns))
    for joint in range(6):
        assert abs(arm.sim.true_position_rad(joint, arm.sim.now_ns) - 0.1) < 0.01
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    arm.close()


@pytest.mark.parametrize(
    ("trouble", "joint", "fault"),
    [
        (Silent("joint2", 0.0), 1, Fault.STALE_READING),
        (Silent("joint3", 0.0), 2, Fault.STALE_READING),
        (Protection("joint4", 0.0), 3, Fault.DRIVE_FAULT),
    ],
)
def test_trouble_of_one_family_stops_all_of_them(trouble: Any, joint: int, fault: Fault) -> None:
    arm = VirtualArm.brought_up(mixed())
    there_and_back(arm)
    arm.cycles(60)
    arm.sim.inject(trouble, since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (fault, joint)
    arm.cycles(300)
    for other in set(range(6)) - {joint}:
        assert arm.sim.true_velocity_rad_s(other, arm.sim.now_ns) == pytest.approx(0.0, abs=1e-4)
    arm.close()


@pytest.mark.parametrize(("drive", "number", "rate_hz"), [(ZDT, "address", 40), (ODRIVE, "node_id", 70)])
@pytest.mark.parametrize("count", [1, 2, 13, 21, 32])
def test_arms_have_one_to_32_joints(drive: dict[str, Any], number: str, rate_hz: float, count: int) -> None:
    """An SLCAN adapter holds back the frames of 21 ZDT drives; the system's queue those of any arm."""
    drives = [{**drive, number: n + 1} for n in range(count)]
    arm = VirtualArm(arm_of(drives, rate_hz=rate_hz, interface="slcan" if count <= 21 else "socketcan"))
    assert arm.bring_up(at_most_s=60.0).failure is None, arm.told
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=5.0)  # the ring still holds what was said last
    goal = there_and_back(arm)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    arm.close()


def test_a_gripper_has_a_drive_of_another_family_than_the_arm() -> None:
    """A ZDT gripper on an arm of ODrives goes where it is told while the arm moves."""
    arm = VirtualArm.brought_up(load_arm("odrive6", overrides={"gripper": {"hook": "servo", "servo": {"address": 7}}}))
    arm.begin_with_gripper()
    arm.until(lambda: bool(np.isfinite(arm.state.record["gripper"]["position_rad"])))
    goal = there_and_back(arm)
    assert arm.ask(Request.GRIP, value=0.5) == Answer.DONE
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.sim.gripper_rad(arm.sim.now_ns) == pytest.approx(0.5, abs=0.01)
    arm.close()


@pytest.mark.parametrize("name", [name for name in known_arms() if name != "mock"])
def test_32_drives_of_any_family_and_a_gripper_are_heard(name: str) -> None:
    said = max(sum(used.from_drive for used in joint.drive.identifiers) for joint in load_arm(name).joints)
    assert MAX_JOINTS * said + 1 <= LISTENERS


def test_drives_that_could_be_taken_for_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="node_id 3 is used by joint1 and joint2"):
        arm_of([{**ODRIVE, "node_id": 3}, {**ODRIVE, "node_id": 3}], rate_hz=100)
    arm_of([{**ODRIVE, "node_id": 3}, {**ZDT, "address": 3}], rate_hz=100)


def test_what_only_zdt_drives_can_is_not_asked_of_others() -> None:
    with pytest.raises(ConfigError, match=r"positions is reported.*an ODrive axis; remove positions"):
        load_arm("odrive6", overrides={"bus": {"positions": "reported"}})
