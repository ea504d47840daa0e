"""Bringing RobStride motors up: nothing moves whatever they were told before, and what is not as the arm file says."""

import math
import struct
from dataclasses import replace
from types import SimpleNamespace

import pytest
from bring_up_rig import failure_of, farthest, tell, way
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives import fields
from rtloop.drives.robstride_setup import CREEP_RAD_S, _hold_as_it_is
from rtloop.service.port import Frame as PortFrame
from shm.words import Answer, Mode, Request
from sim.drives.robstride import RESET, RUN
from sim.faults import Disabled, Protection

CONTROL = "robstride6"
POSITION = "robstride6_position"
both = pytest.mark.parametrize("name", [CONTROL, POSITION])


def told(arm: VirtualArm, joint: int, kind: int, data: bytes) -> None:
    """Somebody else says something to a motor."""
    can_id = kind << 24 | 0xEE00 | arm.sim.drives[joint].settings.motor_id
    tell(arm, joint, can_id, data.ljust(8, b"\0"), extended=True)


def led_elsewhere(arm: VirtualArm) -> None:
    """Every motor was told to be somewhere else, and then stopped."""
    for joint in range(6):
        told(arm, joint, 4, b"")
        told(arm, joint, 18, struct.pack("<Hxxf", 0x7016, 2.0))
        told(arm, joint, 18, struct.pack("<Hxxf", 0x7017, 9.0))
        told(arm, joint, 1, bytes.fromhex("E0 00 7F FF FF FF 33 33"))


@both
def test_nothing_moves_whatever_stopped_motors_were_told_before(name: str) -> None:
    arm = VirtualArm(name, faults=[Disabled(f"joint{n}", 0.0) for n in range(1, 7)])
    arm.cycles(3)
    led_elsewhere(arm)
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(100)
    assert all(drive.state == RUN for drive in arm.sim.drives)
    assert farthest(arm) <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_motor_that_takes_no_set_point_while_it_is_stopped_is_brought_up_as_well() -> None:
    arm = VirtualArm(CONTROL)
    for drive in arm.sim.drives:
        control = drive._does[1]
        drive._does[1] = lambda data16, data, drive=drive, control=control: (
            control(data16, data) if drive.state == RUN else None
        )
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(50)
    assert all(drive.state == RUN for drive in arm.sim.drives)
    assert farthest(arm) <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_motor_that_forgets_its_target_when_it_is_enabled_creeps() -> None:
    """What becomes of a target that was written before is unproven, so the speed limit alone keeps it in place."""
    arm = VirtualArm(POSITION)
    drive = arm.sim.drives[0]
    enable = drive._does[3]

    def forgetful(data16: int, data: bytes) -> None:
        drive.parameters[0x7016] = 2.0
        enable(data16, data)

    drive._does[3] = forgetful
    assert arm.bring_up().failure is None, arm.told
    assert 0.0 < farthest(arm) <= CREEP_RAD_S * 0.5
    arm.close()


@both
def test_a_motor_that_runs_already_is_neither_stopped_nor_enabled_again(name: str) -> None:
    arm = VirtualArm.brought_up(name)
    arm.cycles(10)
    said_before, way_before = len(arm.sent), farthest(arm)
    assert arm.bring_up().failure is None
    arm.cycles(20)
    said = b"".join(data for _, data in arm.sent[said_before:])
    assert b"T1100FD01" in said and b"T03" not in said and b"T04" not in said
    assert farthest(arm) <= way_before + arm.arm.joints[0].encoder_count_rad
    arm.close()


@both
@pytest.mark.parametrize("away_rad", [-20.0, 20.0])
def test_a_motor_beyond_what_its_frames_reach_is_left_alone(name: str, away_rad: float) -> None:
    """It would go to the end of its field if it were told to stay."""
    arm = VirtualArm(name, faults=[Disabled("joint2", 0.0)])
    arm.sim.drives[1].origin -= away_rad / (2 * math.pi)
    failed = failure_of(arm)
    assert "joint2 stands at" in failed and "by hand" in failed
    arm.cycles(50)
    assert arm.sim.drives[1].state == RESET and farthest(arm) <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_motor_that_was_told_to_turn_or_to_be_limp_holds_after_it_was_brought_up() -> None:
    """Set-points without stiffness: 1.8 rad/s, and nothing at all."""
    arm = VirtualArm(CONTROL)
    arm.cycles(3)
    for joint, set_point in ((0, "8000 87D0 0000 3333"), (1, "8000 8000 0000 0000")):
        told(arm, joint, 3, b"")
        told(arm, joint, 1, bytes.fromhex(set_point))
    assert arm.bring_up().failure is None, arm.told
    arm.cycles(40)
    since_ns = arm.sim.now_ns
    arm.cycles(100)
    assert way(arm, 0, since_ns) < 0.001
    assert all(drive._set_point.kp > 0.0 for drive in arm.sim.drives[:2])
    arm.close()


def test_a_motor_that_bears_a_load_goes_on_bearing_it() -> None:
    """2 N·m with a stiffness of kp: it is held that far ahead of where it stands, and commanded to be there."""
    config = load_arm(CONTROL).joints[0]
    host = SimpleNamespace(arm=load_arm(CONTROL))
    dialogue = _hold_as_it_is(host, 0, 1.0)
    next(dialogue)
    torque = fields.field(2.0, config.drive.torque_range_nm, 16)
    feedback = PortFrame(0x02800100 | config.drive.host_id, struct.pack(">HHHH", 0x8A2F, 0x7FFF, torque, 0x0131))
    told_to_hold = dialogue.send(feedback).packets(True)[0][0]
    held_rad = 1.0 + 2.0 / config.drive.kp
    code = fields.field(held_rad, config.drive.position_range_rad, 16)
    assert abs(struct.unpack_from(">H", told_to_hold.data)[0] - code) <= 1
    with pytest.raises(StopIteration) as end:
        dialogue.send(feedback)
    assert end.value.value == pytest.approx(held_rad, abs=1e-4)


@both
def test_a_motor_that_somebody_else_leads_is_left_alone(name: str) -> None:
    arm = VirtualArm(name)
    arm.cycles(2)
    told(arm, 3, 18, struct.pack("<HxxB", 0x7005, 2))
    told(arm, 3, 3, b"")
    failed = failure_of(arm)
    assert "joint4 runs in run mode 2" in failed and "switch the drive off" in failed
    assert arm.sim.drives[3].state == RUN and farthest(arm) <= arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_run_mode_that_the_firmware_has_not_is_said() -> None:
    arm = VirtualArm(POSITION)
    arm.sim.drives[1].settings = type(arm.sim.drives[1].settings)(motor_id=2, robstride=False)
    arm.sim.drives[1]._does[18] = lambda data16, data: arm.sim.drives[1].reply(arm.sim.drives[1]._feedback())
    failed = failure_of(arm)
    assert "joint2 does not take run mode 1" in failed and "csp for RobStrides" in failed
    arm.close()


def test_a_fault_is_said_and_cleared_only_when_a_person_wants_that() -> None:
    arm = VirtualArm(CONTROL, faults=[Protection("joint5", 0.0, 0.1)])
    arm.cycles(40)
    failed = failure_of(arm)
    assert "joint5 has a fault" in failed and "`rtarm up … --clear-fault`" in failed
    assert arm.sim.drives[4].state == RESET
    assert arm.bring_up(clears_protection=True).failure is None
    assert arm.memory["mode"] == Mode.HOLDING
    arm.close()


def csp_arm(**joint: float) -> ArmConfig:
    """Six RobStrides with their own position loop, their first joint changed."""
    given = load_arm(POSITION).model_dump(mode="json", exclude_unset=True)
    for each in given["joints"]:
        each["drive"]["mode"] = "csp"
    given["joints"][0].update(joint)
    return ArmConfig.model_validate(given)


def test_a_motor_that_counts_a_turn_off_after_power_came_is_not_referenced_and_says_why() -> None:
    """zero_sta is 0 as motors come: one that stands a little below its zero counts nearly 2π."""
    arm = VirtualArm(csp_arm(zero_deg=0.0, lower_deg=-90.0, upper_deg=90.0), start_rad=[-0.5, 0, 0, 0, 0, 0])
    drive = arm.sim.drives[0]
    assert drive.settings.zero_sta == 1, "as its owner has set it"
    drive.settings = replace(drive.settings, zero_sta=0)
    drive.power_off(arm.sim.now_ns)
    drive.power_on(arm.sim.now_ns)
    assert arm.bring_up().failure is None
    (said,) = [sentence for sentence in arm.told if "joint1" in sentence]
    assert "+5.783 rad" in said and "a motor turn off" in said and "7029 (zero_sta)" in said
    assert arm.loop[0]["axes"]["reference"]["referenced"][:6].tolist() == [0, 1, 1, 1, 1, 1]
    assert farthest(arm) <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_limp_motor_that_is_led_beyond_its_field_is_measured_there() -> None:
    """Its feedback goes on at the other end of the field, its parameter 7019 does not."""
    arm = VirtualArm.brought_up(
        csp_arm(
            zero_deg=0.0,
            lower_deg=-90.0,
            upper_deg=700.0,
            drive={
                "family": "robstride",
                "motor_id": 1,
                "mode": "csp",
            },
        ),
        start_rad=[12.0, 0, 0, 0, 0, 0],
    )
    assert arm.ask(Request.REFERENCE, joint_mask=1, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None
    drive, axis = arm.sim.drives[0], arm.loop[0]["axes"][0]
    drive.lead(arm.sim.now_ns, 0.05)
    while drive.counted < 2.1:
        arm.cycle()
        assert axis["measured"]["position_rad"] == pytest.approx(drive.counted * 2 * math.pi, abs=0.01)
        assert not axis["checks"]["suspect"], "and no reading contradicts the one before"
    assert arm.memory["mode"] == Mode.DISABLED
    arm.close()
