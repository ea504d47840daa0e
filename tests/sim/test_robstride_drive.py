"""The simulated RobStride motor: golden frames, its run modes, what moves it, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md (host AA, motor 1); the others follow from its tables, how
RobStrides count from the manuals in RobStride/Product_Information (EL05User Manual260428.pdf, 4.1.14 and 4.2).
"""

from __future__ import annotations

import math
import struct

import pytest
from drive_bench import DriveBench

from sim.bus import Frame
from sim.drives.robstride import RESET, RobstrideDrive, Settings
from sim.drives.servo import TURN_RAD, Load

ENABLE = "0300AA01# 00 00 00 00 00 00 00 00"  # (facts)
POSITION_MODE = "1200AA01# 05 70 00 00 01 00 00 00"  # (facts)
TARGET = "1200AA01# 16 70 00 00 00 00 80 3F"  # 1.0 rad (facts)
READ_POSITION = "1100AA01# 19 70 00 00 00 00 00 00"  # (facts)
SET_POINT = "017FFF01# 8A 2F 7F FF 0F 5C 33 33"  # p 1.0, kp 30, kd 1 (facts)
AT_ONE = "028001AA# 8A 2F 7F FF 7F FF 01 31"  # run, 1.0 rad, 30.5 °C (facts)
LET_GO = "0400AA01# 00 00 00 00 00 00 00 00"
CLEAR = "0400AA01# 01 00 00 00 00 00 00 00"


def motor(turns: float = 0.0, **changes) -> DriveBench:
    bench = DriveBench(
        RobstrideDrive(Settings(**{"motor_id": 1} | changes), turns=turns, load=Load(1e-3, 0.02, 10.0), seed=1)
    )
    bench.drive.celsius = 30.5
    return bench


def write(index: int, value: float) -> Frame:
    return Frame(0x1200AA01, struct.pack("<Hxxf", index, value))


def radians(bench: DriveBench) -> float:
    return bench.turns * TURN_RAD


# --- golden frames --------------------------------------------------------------------------------------


def test_feedback_of_the_facts():
    bench = motor(1.0 / TURN_RAD, absolute=True)
    assert bench.ask(ENABLE)[0].startswith("028001AA# 8A 2F ")
    bench.ask("1200AA01# 0A 70 00 00 00 00 00 00")
    assert bench.after(10).ask(ENABLE) == [AT_ONE]


def test_position_of_the_facts():
    bench = motor(1.0 / TURN_RAD, absolute=True)
    assert bench.ask(READ_POSITION) == ["110001AA# 19 70 00 00 00 00 80 3F"]


def test_a_parameter_as_in_the_makers_manual():
    """Motor 7F, host FD: loc_kp is 30 (the manual of RobStride 03, on reading parameters)."""
    asked = "1100FD7F# 1E 70 00 00 00 00 00 00"
    assert motor(motor_id=0x7F).ask(asked) == ["11007FFD# 1E 70 00 00 00 00 F0 41"]


def test_a_target_of_the_facts():
    bench = motor().tell(POSITION_MODE, ENABLE, TARGET)
    assert radians(bench.after(3000)) == pytest.approx(1.0, abs=1e-5)


def test_a_set_point_of_the_facts():
    bench = motor().tell(ENABLE, SET_POINT)
    assert radians(bench.after(2000)) == pytest.approx(
        1.0, abs=0.02 / 30 + 4e-4
    )  # friction over stiffness, and the position's step


def test_what_a_robstride_lacks_it_says_in_its_identifier_and_a_cybergear_is_silent():
    """Bits 16 to 23 of the answer are 01 where the reading failed (RS00 manual of 2026-04-28, 4.1.6)."""
    question = "1100AA01# 99 70 00 00 00 00 00 00"
    assert motor(robstride=True).ask(question) == ["110101AA# 99 70 00 00 00 00 00 00"]
    assert motor().ask(question) == []


def test_type_22_stores_in_a_robstride_and_sets_the_bit_rate_of_a_cybergear():
    """01 to 08 (RS00 manual, 4.1.9); 01 is 1 Mbit/s to a CyberGear (facts)."""
    save = "1600AA01# 01 02 03 04 05 06 07 08"
    robstride = motor(robstride=True).tell(write(0x701E, 50.0), write(0x700A, 1.0)).tell(save).restart()
    assert (robstride.drive.parameters[0x701E], robstride.drive.parameters[0x700A]) == (50.0, 0.0)
    assert robstride.drive.bitrate_code is None
    halfway = motor(robstride=True).tell(write(0x701E, 50.0), "1600AA01# 01 02 03 04 05 06 07 00").restart()
    assert halfway.drive.parameters[0x701E] == 30.0
    cybergear = motor().tell(write(0x701E, 50.0), save)
    assert cybergear.drive.bitrate_code == 1 and cybergear.restart().drive.parameters[0x701E] == 30.0


def test_its_id_is_told_to_anybody():
    assert motor().ask("0000AA01# 00 00 00 00 00 00 00 00")[0].startswith("000001FE# ")
    assert motor().ask("0707AA01# 01 00 00 00 00 00 00 00")[0].startswith("000007FE# ")


# --- what moves it --------------------------------------------------------------------------------------


def test_its_position_loop_keeps_the_speed_limit_and_has_no_ramp():
    bench = motor().tell(POSITION_MODE, write(0x7017, 0.5), ENABLE, TARGET).after(100)
    assert bench.turns_s * TURN_RAD == pytest.approx(0.5, rel=1e-3)  # long since: a ramp of 10 would need 50 ms
    assert radians(bench.after(3000)) == pytest.approx(1.0, abs=1e-5)


def test_run_mode_one_of_robstrides_has_a_ramp_and_another_limit():
    bench = motor(robstride=True).tell(POSITION_MODE, write(0x7017, 0.1), ENABLE, TARGET)
    assert bench.after(100).turns_s * TURN_RAD == pytest.approx(1.0, rel=0.01)  # 10 rad/s² for 0.1 s
    assert radians(bench.after(1000)) == pytest.approx(1.0, abs=1e-5)
    bench.tell(LET_GO, Frame(0x1200AA01, struct.pack("<HxxBxxx", 0x7005, 5)), ENABLE, write(0x7016, 0.5))
    assert bench.after(1000).turns_s * TURN_RAD == pytest.approx(-0.1, rel=1e-3)


def test_a_run_mode_that_it_has_not_is_not_taken():
    bench = motor().tell(Frame(0x1200AA01, struct.pack("<HxxBxxx", 0x7005, 5)))
    assert bench.ask("1100AA01# 05 70 00 00 00 00 00 00") == ["110001AA# 05 70 00 00 00 00 00 00"]


def test_its_run_mode_stays_while_it_runs():
    bench = motor().tell(ENABLE, POSITION_MODE)
    assert bench.drive.parameters[0x7005] == 0
    bench.tell(LET_GO, POSITION_MODE)
    assert bench.drive.parameters[0x7005] == 1


def test_a_speed_of_zero_moves_nothing_in_any_mode():
    for mode in range(4):
        bench = motor(0.1, absolute=True)
        bench.tell(Frame(0x1200AA01, struct.pack("<HxxBxxx", 0x7005, mode)), write(0x7016, 0.2 * math.pi), ENABLE)
        bench.wait(300)
        before = bench.turns
        assert bench.tell(write(0x700A, 0.0)).after(300).turns == pytest.approx(before, abs=1e-6)


# --- counting -------------------------------------------------------------------------------------------

ASK_FEEDBACK = "1200AA01# 0A 70 00 00 00 00 00 00"
TENTH = 0.1 / TURN_RAD


@pytest.mark.parametrize(
    ("robstride", "turns", "field"),
    [
        (False, 2.0 + TENTH, 0xFFFF),
        (False, -2.0 - TENTH, 0x0000),
        (True, 2.0 + TENTH, 0x0104),  # -4π + 0.1
        (True, -2.0 - TENTH, 0xFEFA),
        (True, 2.0 - TENTH, 0xFEFA),
        (True, 6.0 + TENTH, 0x0104),
    ],
)
def test_the_position_field_of_robstrides_goes_on_at_its_other_end(robstride, turns, field):
    bench = motor(turns, robstride=robstride)
    (feedback,) = bench.ask(ASK_FEEDBACK)
    assert int.from_bytes(bytes.fromhex(feedback[10:15]), "big") == pytest.approx(field, abs=1)
    (answer,) = bench.ask(READ_POSITION)
    assert struct.unpack("<f", bytes.fromhex(answer[22:]))[0] == pytest.approx(turns * TURN_RAD)


@pytest.mark.parametrize(
    ("zero_sta", "turns", "counted"), [(0, -0.1, 0.9), (0, 1.7, 0.7), (1, -0.1, -0.1), (1, 0.7, -0.3)]
)
def test_after_power_came_robstrides_count_within_a_turn(zero_sta, turns, counted):
    bench = motor(turns, robstride=True, absolute=True, zero_sta=zero_sta)
    assert bench.ask("1100AA01# 29 70 00 00 00 00 00 00") == [f"110001AA# 29 70 00 00 {zero_sta:02X} 00 00 00"]
    assert bench.drive.counted == pytest.approx(turns)
    assert bench.restart().drive.counted == pytest.approx(counted)


# --- faults, power and names ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "words"),
    [("stall", "00 01 00 00"), ("temperature", "01 00 00 00"), ("current", "00 00 01 00")],
)
def test_a_fault_is_said_once_by_itself(cause, words):
    bench = motor().tell(ENABLE)
    bench.heard()
    bench.drive.protect(bench.now_ns, cause)
    assert bench.wait(1000) == [f"150001AA# {words} 00 00 00 00"]


# --- what it ignores ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "028001AA# 8A 2F 7F FF 7F FF 01 31",  # feedback
        "1F00AA01# 00 00 00 00 00 00 00 00",
        "1100AA01# 34 12 00 00 00 00 00 00",  # a parameter that it does not know
    ],
)
def test_frames_that_are_not_for_it(text):
    bench = motor()
    assert bench.ask(text) == []
    assert bench.drive.state == RESET


def test_a_limit_that_is_no_number_changes_nothing():
    bench = motor().tell(write(0x7017, math.inf))
    assert bench.drive.parameters[0x7017] == 2.0
