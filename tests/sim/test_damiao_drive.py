"""The simulated Damiao motor: golden frames, its modes, its registers, what lets it go, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md; the others follow from its tables and damiao-motor 1.0.6.
"""

from __future__ import annotations

import math
import struct

import pytest
from drive_bench import DriveBench

from sim.bus import Frame
from sim.drives.damiao import (
    ACC,
    CTRL_MODE,
    DEC,
    ENABLED,
    ESC_ID,
    LIMP,
    MIT,
    MST_ID,
    POSITION_VELOCITY,
    TIMEOUT,
    TMAX,
    VMAX,
    DamiaoDrive,
    Planning,
)
from sim.drives.servo import TURN_RAD, Load

ENABLE = "001# FF FF FF FF FF FF FF FC"  # (facts)
DISABLE, ZERO, CLEAR = (f"001# FF FF FF FF FF FF FF {last}" for last in ("FD", "FE", "FB"))
NOTHING = "001# 7F FF 7F F0 00 00 07 FF"  # all zero (facts)
TO_ONE = "001# 8A 3C 7F F0 51 33 37 FF"  # p 1.0, kp 10, kd 1 (facts)
GO_TO_ONE = "101# 00 00 80 3F 00 00 00 40"  # 1.0 rad at 2.0 rad/s (facts)
SET_MODE_2 = "7FF# 01 00 55 0A 02 00 00 00"  # (facts)
READ_MODE = "7FF# 01 00 33 0A 00 00 00 00"  # (facts)
HOW = "7FF# 01 00 CC 00 00 00 00 00"
CODE_RAD = 25.0 / 65535


def motor(rad: float = 0.0, planning: Planning = "ramp", **registers: float) -> DriveBench:
    """A DM4340 with motor ID 1 and master ID 11 (hex); registers by their names here."""
    numbers = {"acc": ACC, "dec": DEC, "mode": CTRL_MODE, "timeout": TIMEOUT, "esc": ESC_ID, "mst": MST_ID}
    held = {MST_ID: 0x11, VMAX: 10.0, TMAX: 28.0} | {numbers[name]: value for name, value in registers.items()}
    return DriveBench(DamiaoDrive(held, planning=planning, turns=rad / TURN_RAD, load=Load(0.02, 0.02, 20.0)))


def rad(bench: DriveBench) -> float:
    return bench.turns * TURN_RAD


def moved(rad_: float, rad_s: float, offset: int = 0x100) -> Frame:
    return Frame(offset + 1, struct.pack("<ff", rad_, rad_s), extended=False)


# --- golden frames --------------------------------------------------------------------------------------


def test_feedback_of_the_facts():
    bench = motor(rad=1.0)
    bench.drive.celsius = 35.0
    bench.tell(ENABLE)
    # power stage and motor the other way round there: 40 and 35 °C
    assert bench.ask(HOW) == ["011# 11 8A 3C 7F F7 FF 1E 23"]


def test_set_points_of_the_facts():
    bench = motor().tell(ENABLE, TO_ONE).after(2000)
    # friction, and what the fields of torque and velocity cut off, against 10 N·m/rad
    assert rad(bench) == pytest.approx(1.0, abs=(0.02 + 28.0 / 4095 + 10.0 / 4095) / 10.0 + CODE_RAD)
    assert bench.tell(NOTHING).after(1000).turns_s == 0.0  # free to turn, and friction has stopped it


def test_targets_of_the_facts():
    bench = motor(acc=4.0, dec=-4.0)
    assert bench.ask(SET_MODE_2) == ["011# 01 00 55 0A 02 00 00 00"]
    assert bench.ask(READ_MODE) == ["011# 01 00 33 0A 02 00 00 00"]
    bench.tell(ENABLE, GO_TO_ONE)
    assert bench.after(250).turns_s * TURN_RAD == pytest.approx(4.0 * 0.25, rel=0.01)  # the ramp
    assert bench.after(250).turns_s * TURN_RAD == pytest.approx(2.0, rel=0.01)  # as fast as told
    assert rad(bench.after(2000)) == pytest.approx(1.0, abs=1e-6)
    assert bench.turns_s == 0.0


def test_an_id_of_sixteen_or_more_spoils_the_status():
    """Why an arm file takes motor_id up to 15 alone: limp, this motor says what an enabled one with ID 1 says."""
    bench = motor(esc=0x11)
    assert bench.ask("7FF# 11 00 CC 00 00 00 00 00")[0][5:7] == "11"
    assert (bench.drive.status, bench.drive.enabled) == (LIMP, False)
    sound = motor()
    sound.tell(ENABLE)
    assert sound.ask(HOW)[0][5:7] == "11"


# --- enabling, errors, alarm ----------------------------------------------------------------------------


def test_a_motor_that_keeps_its_targets_goes_there():
    bench = motor(mode=POSITION_VELOCITY)
    bench.drive.keeps_targets = True
    assert rad(bench.tell(GO_TO_ONE, ENABLE).after(2000)) == pytest.approx(1.0, abs=1e-6)


def test_commands_of_state_count_on_all_that_it_hears():
    bench = motor()
    assert bench.ask(ENABLE.replace("001", "101"))[0][5] == "1"
    assert bench.ask(CLEAR)[0][5] == "0"  # a sound motor lets go too


def test_only_a_limp_motor_stores():
    bench = motor().tell(ENABLE)
    assert bench.ask("7FF# 01 00 AA 01 00 00 00 00") == []


def test_no_alarm_rings_of_a_motor_that_is_limp_or_has_none():
    limp = motor(timeout=100)
    limp.tell(TO_ONE)
    limp.wait(1000)
    assert limp.drive.status == LIMP
    bench = motor(timeout=100).tell(ENABLE, "7FF# 01 00 55 09 00 00 00 00")
    assert bench.after(1000).drive.status == ENABLED


def test_power_brings_back_what_was_stored_and_the_last_turn_alone():
    bench = motor(rad=1.5 * TURN_RAD + 0.25).tell(SET_MODE_2, ENABLE)
    bench.restart()
    assert (bench.drive.registers[CTRL_MODE], bench.drive.status) == (MIT, LIMP)
    assert bench.drive.counted * TURN_RAD == pytest.approx(0.25 - 0.5 * TURN_RAD)
    assert bench.ask("7FF# 01 00 AA 01 00 00 00 00") == ["011# 01 00 AA 01"]
    bench.tell(SET_MODE_2, "7FF# 01 00 AA 01 00 00 00 00", "7FF# 01 00 55 0A 03 00 00 00")
    bench.restart()
    assert bench.drive.registers[CTRL_MODE] == POSITION_VELOCITY


# --- modes ----------------------------------------------------------------------------------------------


def test_damping_alone_turns_at_a_speed():
    bench = motor()
    code = int((2.0 + 10.0) * 4095 / 20.0)
    bench.tell(ENABLE, Frame(1, (0x7FFF << 48 | code << 36 | 0xFFF << 12 | 0x7FF).to_bytes(8, "big"), extended=False))
    assert bench.after(200).turns_s * TURN_RAD == pytest.approx(2.0 - 0.02 / 5.0, abs=20.0 / 4095)


def test_a_torque_alone_accelerates():
    bench = motor()
    code = math.ceil((1.0 + 28.0) * 4095 / 56.0)
    nm = code * 56.0 / 4095 - 28.0
    bench.tell(ENABLE, Frame(1, (0x7FFF_7FF0_0000_0000 | code).to_bytes(8, "big"), extended=False))
    assert bench.after(100).turns_s * TURN_RAD == pytest.approx((nm - 0.02) / 0.02 * 0.1, rel=0.02)


def test_commands_of_another_mode_are_answered_and_do_nothing():
    bench = motor().tell(ENABLE)
    for frame in (moved(1.0, 2.0, offset) for offset in (0x100, 0x200, 0x300, 0x400, 0x600)):
        assert len(bench.ask(frame)) == 1
    assert rad(bench.after(500)) == 0.0


@pytest.mark.parametrize("length", [4, 8])
def test_a_velocity_comes_in_four_bytes_or_eight(length):
    """Four are the firmware's (drives-checked)."""
    bench = motor(mode=3, acc=10.0).tell(ENABLE, Frame(0x201, struct.pack("<ff", -3.0, 0.0)[:length], extended=False))
    assert bench.after(500).turns_s * TURN_RAD == pytest.approx(-3.0)


def firmware(**registers: float) -> DriveBench:
    """A motor with the law of umeow0716/damiao_firmware, and its numbers: gear 10, KP_APR 54, ACC and DEC 2."""
    return motor(planning="gain", mode=POSITION_VELOCITY, **{"acc": 2.0, "dec": -2.0, **registers}).tell(ENABLE)


def test_a_speed_in_proportion_to_the_distance():
    """54 rad/s of the rotor for a radian of the output shaft, whose tenth is what that turns at."""
    bench = firmware().tell(moved(0.1, 10.0))
    assert bench.after(5).turns_s * TURN_RAD == pytest.approx(5.4 * (0.1 - rad(bench)), rel=0.01)
    assert 0.1 - rad(bench.after(185)) == pytest.approx(0.1 / math.e, rel=0.03)
    assert rad(bench.after(4000)) == pytest.approx(0.1, abs=1e-6)


def test_no_faster_than_told():
    bench = firmware().tell(moved(-5.0, 0.5))
    assert bench.after(500).turns_s * TURN_RAD == pytest.approx(-0.5)


def test_ramps_are_steps_in_a_millisecond():
    """0.1 rad/s of the rotor: 10 rad/s² of the output shaft. In rad/s² it would be 0.1."""
    bench = firmware(acc=0.1, dec=-0.2).tell(moved(5.0, 2.0))
    assert bench.after(100).turns_s * TURN_RAD == pytest.approx(1.0, rel=0.02)
    bench = firmware(acc=0.1, dec=-0.2).tell(moved(-5.0, 2.0))  # a speed that falls, so that DEC counts
    assert bench.after(50).turns_s * TURN_RAD == pytest.approx(-1.0, rel=0.02)


def test_force_position():
    bench = motor(mode=4, acc=10.0, dec=-10.0)
    bench.tell(ENABLE, Frame(0x301, struct.pack("<fHH", 1.0, 200, 10_000), extended=False))
    assert bench.after(400).turns_s * TURN_RAD == pytest.approx(2.0)
    assert rad(bench.after(1000)) == pytest.approx(1.0, abs=1e-6)


def test_another_mode_forgets_what_was_told():
    bench = motor(mode=POSITION_VELOCITY, acc=10.0, dec=-10.0).tell(ENABLE, moved(10.0, 2.0)).after(500)
    assert bench.tell("7FF# 01 00 55 0A 03 00 00 00").after(500).turns_s == 0.0
    assert rad(bench) < 2.0


def test_a_speed_of_nothing_stops_by_the_ramp():
    bench = motor(mode=POSITION_VELOCITY, acc=100.0, dec=-4.0).tell(ENABLE, moved(10.0, 2.0)).after(500)
    assert bench.tell(moved(10.0, 0.0)).after(250).turns_s * TURN_RAD == pytest.approx(1.0, rel=0.02)


# --- registers ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("register", "value", "held"),
    [
        (0x0A, "05 00 00 00", "01 00 00 00"),
        (0x0A, "00 00 00 00", "01 00 00 00"),
        (0x04, "00 00 80 BF", "00 00 A0 41"),  # an acceleration below zero
        (0x05, "00 00 80 3F", "00 00 A0 C1"),  # a deceleration above
        (0x15, "00 00 C0 7F", "00 00 48 41"),  # no number
        (0x07, "00 08 00 00", "11 00 00 00"),  # no standard identifier
        (0x14, "00 00 00 00", "00 00 20 41"),  # read only
        (0x04, "00 00 80 3F", "00 00 80 3F"),
    ],
)
def test_registers_take_what_they_may(register, value, held):
    bench = motor()
    assert bench.ask(f"7FF# 01 00 55 {register:02X} {value}") == [f"011# 01 00 55 {register:02X} {held}"]
    assert bench.ask(f"7FF# 01 00 33 {register:02X} 00 00 00 00") == [f"011# 01 00 33 {register:02X} {held}"]


def test_measured_registers():
    bench = motor(rad=0.5)
    bench.drive.celsius = 41.0
    values = [bench.ask(f"7FF# 01 00 33 {number:02X} 00 00 00 00")[0][17:] for number in (61, 80)]
    assert [struct.unpack("<f", bytes.fromhex(value))[0] for value in values] == [36.0, 0.5]


def test_another_master_id_counts_from_then_on():
    assert motor().ask("7FF# 01 00 55 07 25 00 00 00") == ["025# 01 00 55 07 25 00 00 00"]


# --- what it ignores ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame",
    [
        "081# FF FF FF FF FF FF FF FC",
        "7FF# 01 01 CC 00 00 00 00 00",
        "7FF# 01 00 33 29 00 00 00 00",  # no such register
        "7FF# 01 00 44 0A 00 00 00 00",  # no such operation
        "7FF# 01 00 55 0A 02",
        "7FF# 01 00",
        "011# 11 8A 3C 7F F7 FF 28 23",
    ],
)
def test_what_is_not_for_it_meets_silence(frame):
    bench = motor()
    assert bench.ask(frame) == []
    assert (bench.drive.status, bench.drive.registers[CTRL_MODE]) == (LIMP, MIT)
