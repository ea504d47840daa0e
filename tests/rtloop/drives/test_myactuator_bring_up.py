"""Bringing MyActuator motors up: their ramps, their errors, their brakes, and what is not as the arm file says."""

import struct

import pytest
from bring_up_rig import failure_of, farthest, tell
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives.myactuator_setup import ramp_dps_s
from rtloop.memory import status as status_bits
from shm.words import Mode, Unreferenced
from sim.drives.myactuator import OFF, POSITION
from sim.faults import Disabled, Protection

ARM = "myactuator6"


def told(arm: VirtualArm, joint: int, data: bytes) -> None:
    """Somebody else says something to a motor."""
    tell(arm, joint, 0x140 + arm.sim.drives[joint].settings.motor_id, data.ljust(8, b"\0"))


def test_ramps_are_written_once_and_said() -> None:
    arm = VirtualArm.brought_up(ARM)
    for joint, drive in enumerate(arm.sim.drives):
        wanted = ramp_dps_s(arm.arm.joints[joint], arm.arm)
        assert drive.settings.ramps_dps_s[:2] == [wanted, wanted] and drive.rom_writes == 2
        assert drive.settings.timeout_ms == 0
    said = [sentence for sentence in arm.told if "ramp" in sentence]
    assert len(said) == 6
    assert any("joint1" in text and "10000 °/s² up and 10000 °/s² down, and is 201 °/s² now" in text for text in said)
    assert arm.bring_up().failure is None
    assert all(drive.rom_writes == 2 for drive in arm.sim.drives)
    arm.close()


def test_a_ramp_that_is_not_taken_is_said() -> None:
    arm = VirtualArm(ARM)
    arm.sim.drives[3]._does[0x43] = bytes
    failed = failure_of(arm)
    assert "joint4 does not take 501 °/s² as the acceleration" in failed
    assert "stays at 10000" in failed
    arm.close()


def test_a_motor_that_is_on_its_way_is_stopped() -> None:
    arm = VirtualArm(ARM)
    arm.cycles(2)
    told(arm, 0, struct.pack("<BxHi", 0xA4, 20, 9000))
    arm.cycles(20)
    assert arm.bring_up().failure is None, arm.told
    stood_rad, place_rad = farthest(arm), arm.sim.true_position_rad(0, arm.sim.now_ns)
    arm.cycles(100)
    assert farthest(arm) - stood_rad < 1e-4
    assert (
        abs(arm.loop[0]["axes"][0]["commanded"]["position_rad"] - place_rad) < 3 * arm.arm.joints[0].encoder_count_rad
    )
    arm.close()


def test_a_brake_is_released_and_its_locking_is_a_fault() -> None:
    arm = VirtualArm(ARM, faults=[Disabled(f"joint{n}", 0.0) for n in range(1, 7)])
    for drive in arm.sim.drives:
        drive.settings.brake = True
    arm.cycles(3)
    assert arm.bring_up().failure is None, arm.told
    assert all(drive.brake_released and drive.mode == POSITION for drive in arm.sim.drives)
    assert farthest(arm) < 2e-4
    arm.cycles(20)
    told(arm, 2, b"\x78")
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert arm.memory["fault"]["joint"] == 2
    arm.close()


def test_a_motor_that_never_tells_of_a_brake_is_taken_as_it_is() -> None:
    arm = VirtualArm(ARM)
    for drive in arm.sim.drives:
        answers = drive._status
        drive._does[0x9A] = lambda data, answers=answers: answers(data)[:3] + b"\0" + answers(data)[4:]
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(30)
    assert arm.memory["mode"] == Mode.HOLDING
    assert all(axis["drive"]["status"] & status_bits.ENABLED for axis in arm.loop[0]["axes"][:6])
    arm.close()


@pytest.mark.parametrize(("cause", "restarted"), [("stall", True), ("temperature", False)])
def test_errors_end_when_a_person_wants_that(cause: str, restarted: bool) -> None:
    document = load_arm(ARM).model_dump(exclude_unset=True)
    document["joints"][4]["drive"]["encoder"] = "incremental"
    arm = VirtualArm(ArmConfig.model_validate(document), faults=[Protection("joint5", 0.0, 3.0, cause=cause)])
    arm.cycles(10)
    failed = failure_of(arm)
    assert "joint5 has an error" in failed and "`rtarm up … --clear-fault`" in failed
    failed = failure_of(arm, clears_protection=True)
    assert "joint5 keeps its error" in failed
    arm.cycles(600)
    assert arm.bring_up(clears_protection=True).failure is None, arm.told
    assert any("joint5: its drive is restarted" in sentence for sentence in arm.told) == restarted
    reason = arm.loop[0]["axes"][4]["reference"]["unreferenced_reason"]
    assert reason == (Unreferenced.POWER_LOST if restarted else Unreferenced.INCREMENTAL)
    assert farthest(arm) < 1e-3
    arm.close()


@pytest.mark.parametrize(
    ("error", "words", "restarted"),
    [
        (0x0800, "over-temperature of its board", False),
        (0x2000, "encoder calibration", True),
        (0x4000, "encoder data", True),
    ],
)
def test_an_error_is_named_and_whether_only_a_restart_ends_it(error: int, words: str, restarted: bool) -> None:
    """Bits of the maker's protocol V4.3."""
    arm = VirtualArm(ARM)
    drive = arm.sim.drives[1]
    drive.error, drive.cause_lasts = error, True
    failed = failure_of(arm)
    assert f"joint2 has an error ({words})" in failed
    assert ("which ends with a restart of the drive only" in failed) == restarted
    failed = failure_of(arm, clears_protection=True)
    assert ("keeps its error" in failed) and ("after a restart" in failed) == restarted
    drive.cause_lasts = False
    assert arm.bring_up(clears_protection=True).failure is None, arm.told
    assert any("joint2: its drive is restarted" in sentence for sentence in arm.told) == restarted
    arm.close()


def test_a_motor_that_is_let_go_says_so() -> None:
    arm = VirtualArm.brought_up(ARM)
    told(arm, 1, b"\x80")
    assert arm.sim.drives[1].mode == OFF
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    assert arm.memory["fault"]["joint"] == 1
    arm.close()
