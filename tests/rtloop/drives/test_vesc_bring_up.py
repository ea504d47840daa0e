"""Bringing VESCs up, and what the cycle makes of drives whose positions come by themselves and round each turn."""

import math
import struct

import pytest
from bring_up_rig import failure_of, farthest, tell, way
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.memory import status
from shm.words import Answer, Fault, Mode, Request
from sim.faults import Protection

SET_POSITION, SET_CURRENT = 0x400, 0x100


def started(**changes: int) -> VirtualArm:
    """An arm whose first drive has other settings, and has had power for a while."""
    arm = VirtualArm("vesc6")
    drive = arm.sim.drives[0]
    for name, value in changes.items():
        setattr(drive.settings, name, value)
    drive.boot()
    arm.cycles(400)
    return arm


def test_a_drive_with_a_time_out_is_refused_before_it_lets_the_joint_fall() -> None:
    arm = started(timeout_ms=1000)
    assert "joint1 holds nothing because of its time-out: set Timeout to 0 in VESC Tool" in failure_of(arm)
    assert farthest(arm) == 0.0
    arm.close()


def test_a_drive_whose_kill_switch_is_pressed_is_refused_until_it_is_released() -> None:
    arm = started()
    arm.sim.drives[0].kill(arm.sim.now_ns, pressed=True)
    assert "joint1 holds nothing because of its kill switch: release it" in failure_of(arm)
    arm.sim.drives[0].kill(arm.sim.now_ns, pressed=False)
    assert arm.clear_fault().failure is None, arm.told
    arm.close()


def test_a_drive_that_does_not_send_its_position_is_told_what_to_switch_on() -> None:
    arm = started(position_hz=0)
    said = failure_of(arm)
    assert "joint1 does not send its position: switch Status 4 on" in said and "200 Hz" in said
    arm.close()


def test_firmware_that_does_not_tell_what_has_let_the_motor_go_is_refused() -> None:
    arm = started()
    drive, answered = arm.sim.drives[0], arm.sim.drives[0]._does
    drive._does = lambda command, data: (answered(command, data) or b"")[: 5 if data[1:2] == b"\x20" else 6]
    assert "before 2021" in failure_of(arm)
    arm.close()


def test_a_fault_is_waited_for_where_a_person_has_asked_for_that() -> None:
    arm = VirtualArm("vesc6", faults=[Protection("joint2", 0.0, 4.0, "temperature")])
    arm.cycles(2)
    assert "joint2 has a fault (over-temperature of the motor) and holds nothing" in failure_of(arm)
    assert "joint2 keeps its fault (over-temperature of the motor)" in failure_of(arm, clears_protection=True)
    arm.cycles(1000)
    assert arm.bring_up(clears_protection=True).failure is None, arm.told
    arm.close()


def test_a_drive_that_goes_elsewhere_is_told_to_stay_where_it_is() -> None:
    arm = started()
    tell(arm, 0, SET_POSITION | 1, struct.pack(">i", 300_000_000), extended=True)
    arm.cycles(4)
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(40)
    stood_ns = arm.sim.now_ns
    arm.cycles(100)
    assert way(arm, 0, stood_ns) < 0.001
    arm.close()


@pytest.mark.parametrize("end_deg", [-179.99, 139.99])
def test_at_either_end_of_its_range_a_joint_reads_where_it_stands(end_deg: float) -> None:
    """The lower end is 0.01 degrees of the drive; below it come 359.99."""
    arm = VirtualArm("vesc6", start_rad=[math.radians(end_deg), 0, 0, 0, 0, 0])
    assert arm.bring_up().failure is None, arm.told
    for _ in range(200):
        arm.cycle()
        read_deg = math.degrees(arm.loop[0]["axes"][0]["measured"]["position_rad"])
        assert read_deg == pytest.approx(end_deg, abs=0.05)
    assert arm.memory["mode"] == Mode.HOLDING
    arm.close()


def test_a_kill_switch_is_a_fault_and_nothing_enables_the_drive_before_a_person_does() -> None:
    arm = VirtualArm.brought_up("vesc6")
    arm.sim.drives[3].kill(arm.sim.now_ns, pressed=True)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 3)
    arm.sim.drives[3].kill(arm.sim.now_ns, pressed=False)
    arm.cycles(400)
    assert not arm.sim.drives[3].enabled
    assert not arm.loop[0]["axes"][3]["drive"]["status"] & status.ENABLED
    assert arm.clear_fault().failure is None, arm.told
    assert arm.sim.drives[3].enabled
    arm.close()


def test_a_fault_that_ends_by_itself_enables_nothing() -> None:
    arm = VirtualArm.brought_up("vesc6")
    arm.sim.inject(Protection("joint3", 0.0, 0.0), since_ns=arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.4)
    arm.cycles(400)
    assert arm.sim.drives[2].fault == 0 and not arm.sim.drives[2].enabled
    assert not arm.loop[0]["axes"][2]["drive"]["status"] & status.ENABLED
    arm.close()


def test_a_drive_that_speaks_and_does_not_hear_is_a_fault() -> None:
    arm = VirtualArm.brought_up("vesc6")
    arm.sim.drives[1].take = lambda frame: None
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=1.0)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 1)
    assert arm.loop[0]["axes"][1]["drive"]["status"] & status.COMMUNICATION
    arm.close()


def test_a_drive_that_was_switched_off_and_on_is_not_enabled_by_a_stop() -> None:
    arm = VirtualArm.brought_up("vesc6")
    drive = arm.sim.drives[4]
    drive.power_off(arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    drive.power_on(arm.sim.now_ns)
    arm.cycles(400)
    assert not drive.enabled
    arm.close()


def test_an_arm_of_vescs_does_not_go_on_by_itself() -> None:
    """A target would enable one that had no power meanwhile, and none proves that it had."""
    arm = VirtualArm.brought_up("vesc6")
    arm.heal_by_itself()
    for drive in arm.sim.drives:
        drive.unplug(arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    for drive in arm.sim.drives:
        drive.plug_in(arm.sim.now_ns)
    arm.cycles(1000)
    assert arm.memory["mode"] == Mode.FAULT
    assert arm.clear_fault().failure is None, arm.told
    arm.close()


def test_let_go_it_coasts() -> None:
    arm = VirtualArm.brought_up("vesc6")
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None, arm.told
    assert all(drive.limp for drive in arm.sim.drives)
    arm.close()


def test_the_arm_that_comes_with_rtarm_reads_each_joint_in_one_turn() -> None:
    assert all(joint.range_turns <= 0.95 for joint in load_arm("vesc6").joints)
