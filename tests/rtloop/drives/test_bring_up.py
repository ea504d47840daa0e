"""What bring-up of every family says of a drive that is not there, by its number, and that nothing moves."""

import pytest
from bring_up_rig import failure_of, way
from virtual import VirtualArm

from shm.words import Mode
from sim.faults import Protection

NUMBER = {
    "episode1": "address 3",
    "odrive6": "node 3",
    "mks6": "CanID 3",
    "damiao6": "motor_id 0x3",
    "damiao6_pv": "motor_id 0x3",
    "cia402_6": "node 3",
    "myactuator6": "motor_id 3",
    "robstride6": "motor_id 3",
    "robstride6_position": "motor_id 3",
    "vesc6": "controller_id 3",
}


@pytest.mark.parametrize("name", NUMBER)
def test_a_drive_that_is_not_there_is_said(name: str) -> None:
    arm = VirtualArm(name)
    arm.sim.drives[2].power_off(arm.sim.now_ns)
    failed = failure_of(arm)
    assert f"joint3 ({NUMBER[name]}) does not answer" in failed and f"{arm.arm.bus.bitrate} bit/s" in failed
    assert arm.memory["mode"] == Mode.FAULT
    for joint, config in enumerate(arm.arm.joints):
        assert way(arm, joint) <= config.encoder_count_rad + config.command_pulse_rad
    arm.close()


@pytest.mark.parametrize(
    ("cause", "words", "remedy"),
    [
        ("stall", "stall", "free what blocks the joint"),
        ("temperature", "over-temperature", "let the drive cool"),
        ("current", "over-current", "find what draws it"),
    ],
)
def test_why_a_zdt_drive_has_tripped_is_said(cause: str, words: str, remedy: str) -> None:
    """A drive that has tripped before the start (3B of zdt-emm-v5.md)."""
    arm = VirtualArm(faults=[Protection("joint4", 0.0, 1e6, cause)])
    arm.cycles(2)
    assert f"joint4 has tripped its protection ({words}) and holds nothing: {remedy}, then start" in failure_of(arm)
    failed = failure_of(arm, clears_protection=True)
    assert "joint4 stays in protection after it was cleared" in failed
    assert f"({words}) is still there: {remedy}, then `rtarm clear-fault`" in failed
    arm.close()
