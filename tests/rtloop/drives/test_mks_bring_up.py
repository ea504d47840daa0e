"""MKS drives from the first question on: what is asked, set and refused, and their homing runs, in virtual time."""

import math

import numpy as np
import pytest
from bring_up_rig import failure_of, farthest, tell, way
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.drives.mks_setup import write_setting
from rtloop.memory import status
from rtloop.memory.frame_words import STANDARD
from rtloop.service.port import Frame as PortFrame
from shm.words import Answer, Fault, Mode, Outcome, Request, Unreferenced
from sim.drives.mks import MksDrive, checksum
from sim.faults import Disabled, PowerLoss, Silent

JOINT2 = 0b000010
NEAR_STOPS_DEG = (-176.0, -86.0, -79.0, -25.0, -105.0, -20.0)
WITHIN_RAD = 0.002


def arm_of(start_deg=NEAR_STOPS_DEG, *, overrides=None, **options) -> VirtualArm:
    return VirtualArm(load_arm("mks6", overrides=overrides or {}), start_rad=np.radians(start_deg), **options)


def drives(arm: VirtualArm) -> list[MksDrive]:
    return arm.sim.drives


def told(arm: VirtualArm, joint: int, *data: int) -> None:
    """Somebody else's command reaches a drive."""
    tell(arm, joint, joint + 1, bytes((*data, checksum(joint + 1, bytes(data)))))


def brought_up(arm: VirtualArm, **options) -> VirtualArm:
    assert arm.bring_up(**options).failure is None, arm.told
    return arm


def referenced(start_deg=NEAR_STOPS_DEG, **options) -> VirtualArm:
    arm = brought_up(arm_of(start_deg, **options))
    assert arm.ask(Request.REFERENCE, joint_mask=0b111111, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    return arm


def settings_told(arm: VirtualArm) -> list[int]:
    """Codes of the settings that drives are told from now on."""
    codes: list[int] = []
    for drive in drives(arm):
        take = drive._set

        def note(code, arguments, take=take):
            codes.append(code)
            return take(code, arguments)

        drive._set = note
    return codes


# --- settings -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acknowledge", [False, True])
def test_drives_as_from_the_factory_are_set_as_the_arm_file_says(acknowledge):
    arm = arm_of(overrides={"bus": {"acknowledge": acknowledge}})
    for drive in drives(arm):
        drive.settings |= {0x82: b"\x02", 0x8C: b"\x01\x01"}
        drive.enabled = False
    brought_up(arm)
    arm.cycles(20)
    assert {drive.settings[0x82] for drive in drives(arm)} == {b"\x05"}
    assert {drive.settings[0x8C] for drive in drives(arm)} == {bytes((acknowledge, 0))}
    assert any("SR_vFOC" in sentence for sentence in arm.told)
    assert any(f"acknowledgements turned {'on' if acknowledge else 'off'}" in sentence for sentence in arm.told)
    assert all(drive.enabled for drive in drives(arm))
    assert farthest(arm) == 0.0
    arm.close()


def test_what_is_right_already_is_not_written_again():
    arm = arm_of()
    for drive in drives(arm):
        drive.settings[0x8C] = b"\x00\x00"
    codes = settings_told(arm)
    brought_up(arm)
    assert codes == []
    arm.close()


def test_firmware_that_cannot_be_asked_is_told():
    arm = arm_of()
    for drive in drives(arm):
        obey = drive._obey
        drive._obey = lambda code, arguments, obey=obey: None if code == 0x00 else obey(code, arguments)
    codes = settings_told(arm)
    brought_up(arm)
    assert sorted(codes) == [0x82] * 6 + [0x8C] * 6
    assert {drive.settings[0x8C] for drive in drives(arm)} == {b"\x00\x00"}
    arm.close()


def test_an_echo_of_a_setting_is_not_its_answer():
    """82 05 88 is as long as what answers it, 82 01 84."""
    question = next(write_setting(load_arm("mks6").joints[0], 0x82, 0x05))
    assert question.receive(PortFrame(1, bytes.fromhex("820588"), kind=STANDARD), False) is None
    assert question.receive(PortFrame(1, bytes.fromhex("820184"), kind=STANDARD), False) is not None


def test_microsteps_that_make_another_speed_are_refused():
    arm = arm_of()
    drives(arm)[3].settings[0x84] = b"\x08"
    sentence = failure_of(arm)
    assert "joint4" in sentence and "8 microsteps" in sentence and "16, 32 or 64" in sentence
    arm.close()


@pytest.mark.parametrize(("rate_hz", "fits"), [(150, True), (180, False)])
def test_a_drive_that_keeps_acknowledging(rate_hz, fits):
    arm = arm_of(overrides={"control": {"rate_hz": rate_hz}})
    drive = drives(arm)[1]
    take = drive._set
    drive._set = lambda code, arguments: 0 if code == 0x8C else take(code, arguments)
    if fits:
        brought_up(arm)
        assert any("joint2: its drive keeps its acknowledgements on" in sentence for sentence in arm.told)
    else:
        assert "the bus carries 155 Hz, not 180 Hz" in failure_of(arm)
    arm.close()


# --- what the drive does when it is met ------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [(0xF6, 0x80, 60, 250), (0xF5, 0, 60, 250, 0x40, 0, 0)],
    ids=["with a speed", "to a position"],
)
def test_a_drive_on_its_way_is_stopped(command):
    arm = arm_of((0.0,) * 6)
    arm.cycles(3)
    told(arm, 1, *command)
    brought_up(arm)
    arm.cycles(5)
    stood_ns = arm.sim.now_ns
    arm.cycles(50)
    assert way(arm, 1, stood_ns) == 0.0
    assert drives(arm)[1].enabled
    arm.close()


def test_a_drive_that_does_not_say_whether_it_stands_does_not_come_up():
    """It may move: to enable it then would make what it does now what it holds."""
    arm = arm_of()
    drive = drives(arm)[1]
    obey = drive._obey
    drive._obey = lambda code, arguments: None if code == 0xF1 else obey(code, arguments)
    assert "state" in failure_of(arm)
    arm.close()


def test_a_homing_run_that_somebody_left_is_ended():
    arm = arm_of((0.0,) * 6)
    arm.cycles(3)
    told(arm, 1, 0x91)
    brought_up(arm)
    assert arm.loop[0]["axes"][1]["reference"]["unreferenced_reason"] == Unreferenced.NOT_HOMED
    stood_ns = arm.sim.now_ns
    arm.cycles(50)
    assert way(arm, 1, stood_ns) == 0.0
    arm.close()


def test_a_drive_that_calibrates_is_left_alone():
    arm = arm_of()
    arm.cycles(3)
    told(arm, 1, 0x80, 0)
    assert "is calibrating" in failure_of(arm)
    arm.close()


def test_a_limp_drive_is_enabled_where_it_was_led_to():
    """Its target of before is forgotten: it holds where the shaft is."""
    arm = arm_of(faults=[Disabled("joint2", 0.0)])
    arm.cycles(3)
    brought_up(arm)
    axis = arm.loop[0]["axes"][1]
    assert axis["drive"]["status"] & status.ENABLED
    assert abs(axis["commanded"]["position_rad"] - math.radians(NEAR_STOPS_DEG[1])) < WITHIN_RAD
    arm.close()


def test_an_angle_is_not_known_until_it_is_said():
    arm = brought_up(arm_of())
    axes = arm.loop[0]["axes"][:6]
    assert not axes["reference"]["referenced"].any()
    assert {int(reason) for reason in axes["reference"]["unreferenced_reason"]} == {Unreferenced.INCREMENTAL}
    assert arm.ask(Request.REFERENCE, joint_mask=0b111111, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    assert axes["reference"]["referenced"].all()
    arm.close()


# --- stalls ---------------------------------------------------------------------------------------------

OFF = {0x88: b"\x00", 0x9D: bytes(5)}
ON = pytest.mark.parametrize(
    "settings",
    [OFF | {0x88: b"\x01"}, OFF | {0x9D: b"\x01\x00\x64\x00\x64"}],
    ids=["Protect", "guard of the error"],
)


def told_of_a_stall(settings: dict[int, bytes], **options) -> VirtualArm:
    """An arm that holds, joint 2 of which then tells a stall (3E)."""
    arm = arm_of((0.0,) * 6, **options)
    drives(arm)[1].settings |= settings
    brought_up(arm)
    assert arm.ask(Request.REFERENCE, joint_mask=0b111111, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    drives(arm)[1].stalled = True
    arm.cycles(40)
    return arm


def test_a_stall_without_protection_is_no_trip():
    """3E tells it all the same (manual V1.0.9), but the drive goes on holding."""
    arm = told_of_a_stall(OFF)
    bits = arm.loop[0]["axes"][1]["drive"]["status"]
    assert bits & status.STALLED and not bits & status.PROTECTED
    assert (arm.memory["mode"], arm.memory["fault"]["code"]) == (Mode.HOLDING, Fault.NONE)
    arm.close()


@ON
def test_a_stall_with_protection_is_a_trip(settings):
    arm = told_of_a_stall(settings)
    assert (arm.memory["fault"]["code"], arm.memory["fault"]["joint"]) == (Fault.DRIVE_FAULT, 1)
    assert int(arm.memory["fault"]["value"]) & status.PROTECTED
    arm.close()


def test_what_cannot_be_asked_is_taken_for_a_protection_that_is_on():
    arm = arm_of((0.0,) * 6)
    drive = drives(arm)[1]
    drive.settings |= OFF
    obey = drive._obey
    drive._obey = lambda code, arguments: None if code == 0x00 else obey(code, arguments)
    brought_up(arm)
    assert arm.loop[0]["axes"][1]["drive"]["holds_stalled"] == 0
    assert all(axis["drive"]["holds_stalled"] == 0 for axis in arm.loop[0]["axes"][:6])
    arm.close()


def test_a_firmware_without_a_guard_of_the_error_has_none_that_is_on():
    arm = arm_of((0.0,) * 6)
    drive = drives(arm)[1]
    drive.settings |= OFF
    del drive.settings[0x9D]
    brought_up(arm)
    assert arm.loop[0]["axes"][1]["drive"]["holds_stalled"] == 1
    arm.close()


def test_the_mark_of_a_stall_without_protection_keeps_nothing_from_coming_up():
    arm = arm_of()
    drives(arm)[1].settings |= OFF
    drives(arm)[1].stalled = True
    brought_up(arm)
    assert not drives(arm)[1].stalled
    arm.close()


@ON
def test_a_tripped_protection_waits_for_a_person(settings):
    arm = arm_of()
    drives(arm)[1].settings |= settings
    drives(arm)[1].stalled = True
    assert "joint2 has tripped its protection (stall)" in failure_of(arm)
    brought_up(arm, clears_protection=True)
    assert not drives(arm)[1].stalled
    arm.close()


# --- stops ----------------------------------------------------------------------------------------------


def told_since(arm: VirtualArm, first: int, can_id: int) -> list[bytes]:
    """Data of the frames to a drive among what the cycle has sent since."""
    lines = b"".join(data for _, data in arm.sent[first:]).split(b"\r")
    return [bytes.fromhex(line[5:].decode()) for line in lines if line[:4] == f"t{can_id:03X}".encode()]


def test_a_drive_that_was_away_is_halted_along_its_ramp_and_holds():
    arm = referenced((0.0,) * 6)
    joints = np.zeros((2, 6, 3))
    joints[1, :, 0] = 0.5
    arm.send_goal(np.array([0, 5_000_000_000]), joints)
    arm.cycles(150)
    arm.sim.inject(Silent("joint2", 0.0, 0.3), since_ns=arm.sim.now_ns)
    first = len(arm.sent)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=0.5)
    arm.cycles(150)
    acc = int(arm.loop[0]["joints"][1]["acc_byte"])
    halt = bytes((0xF5, 0, 0, acc, 0, 0, 0))
    assert halt + bytes((checksum(2, halt),)) in told_since(arm, first, 2)
    assert b"\xf7\xf9" not in told_since(arm, first, 2)  # at once, which is hard on the gear
    stood_ns = arm.sim.now_ns
    arm.cycles(50)
    assert way(arm, 1, stood_ns) == 0.0 and drives(arm)[1].enabled
    arm.close()


# --- homing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("counted", [True, False], ids=["counts on", "was just switched on"])
def test_a_whole_arm_is_homed(counted):
    arm = brought_up(arm_of(homed=counted))
    assert arm.ask(Request.HOME) == Answer.DONE
    assert arm.reference().failure is None, arm.told
    assert (arm.memory["mode"], arm.memory["fault"]["code"]) == (Mode.HOLDING, Fault.NONE)
    for joint, config in enumerate(arm.arm.joints):
        true_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        assert abs(true_rad - config.lower_rad) < WITHIN_RAD
        assert arm.loop[0]["axes"][joint]["reference"]["referenced"] == 1
        assert abs(arm.loop[0]["axes"][joint]["measured"]["position_rad"] - true_rad) < WITHIN_RAD
        assert f"{config.name}: homed." in arm.told
    assert arm.lost == dict.fromkeys(range(6))
    assert arm.end_of(arm.send_shift(), at_most_s=8.0) == Outcome.SUCCEEDED
    arm.close()


@pytest.mark.parametrize("ask", ["stop", "hold"])
def test_a_homing_run_is_ended_at_once_when_somebody_asks(ask):
    arm = referenced((0.0,) * 6)
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    cycles = []

    def stop():
        cycles.append(arm.now_ns)
        if len(cycles) == 60:
            assert drives(arm)[1].stepper.moving
            getattr(arm.writer, ask)()

    assert arm.reference(each_cycle=stop, at_most_s=3.0).failure is None
    axis = arm.loop[0]["axes"][1]
    assert (axis["reference"]["referenced"], axis["reference"]["unreferenced_reason"]) == (0, Unreferenced.NOT_HOMED)
    assert arm.lost[1] == Unreferenced.NOT_HOMED
    ended_ns = arm.sim.now_ns
    arm.cycles(60)
    assert farthest(arm, ended_ns) == 0.0
    arm.close()


def failed_run(arm: VirtualArm, **options) -> str:
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    failure = arm.reference(**options).failure
    assert failure is not None and arm.memory["fault"]["code"] == Fault.HOMING
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 0
    ended_ns = arm.sim.now_ns
    arm.cycles(60)
    assert way(arm, 1, ended_ns) == 0.0
    return str(failure)


def test_a_stop_elsewhere_is_none():
    arm = referenced((0.0,) * 6)
    drives(arm)[1].block_shaft(arm.sim.now_ns)
    sentence = failed_run(arm)
    assert "joint2 met something at" in sentence and "-90.0°" in sentence
    arm.close()


def test_a_run_that_finds_nothing_is_ended():
    arm = referenced((0.0,) * 6, overrides={"homing": {"timeout_s": 2}})
    drives(arm)[1].settings[0x90] = b"\x00\x01\x00\x02\x00\x01"  # the wrong way round, slowly
    assert "has not found its homing stop within 2 s" in failed_run(arm)
    arm.close()


@pytest.mark.parametrize("off_s", [0.1, 0.15, 1.0])
@pytest.mark.parametrize("boots_enabled", [False, True])
def test_power_lost_amid_a_run_is_no_stop_that_was_found(off_s, boots_enabled):
    """It counts 0 where it stands, as a drive does that has found its stop, and may hold there too."""
    arm = brought_up(arm_of((0.0,) * 6))  # nobody knows where its stop is
    drive = drives(arm)[1]
    boot = drive.boot

    def enabled() -> None:
        boot()
        drive.enabled = boots_enabled

    drive.boot = enabled
    arm.sim.inject(PowerLoss("joint2", 1.0, off_s=off_s), since_ns=arm.sim.now_ns)
    assert "joint2" in failed_run(arm)
    arm.close()


@pytest.mark.parametrize("rate_hz", [20, 150])
def test_a_slow_cycle_and_a_lossy_bus_home_too(rate_hz):
    arm = referenced(overrides={"control": {"rate_hz": rate_hz}})
    drives(arm)[1].reply_loss = 0.02
    assert arm.ask(Request.HOME, joint_mask=JOINT2) == Answer.DONE
    assert arm.reference().failure is None, arm.told
    assert arm.loop[0]["axes"][1]["reference"]["referenced"] == 1
    arm.close()


def test_a_drive_that_refuses_to_home():
    arm = referenced((0.0,) * 6)
    drives(arm)[1]._home = lambda: 0
    assert "does not begin its homing run" in failed_run(arm)
    arm.close()


def test_a_drive_that_lets_go_at_its_stop():
    arm = referenced()
    drive = drives(arm)[1]
    end = drive._end_run

    def let_go(result):
        end(result)
        drive.enabled = False

    drive._end_run = let_go
    assert "set EndLimit" in failed_run(arm)
    arm.close()
