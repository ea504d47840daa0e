"""The simulated MKS drive: golden frames, what moves it, what it tells by itself, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md, (manual) those of the maker's CAN manual V1.0.6 or V1.0.9.
"""

from __future__ import annotations

import numpy as np
import pytest
from drive_bench import DriveBench

from sim.bus import Frame
from sim.drives.mks import STALL_NS, MksDrive, checksum
from sim.drives.ramp import GRAINS_PER_REVOLUTION

COUNTS = 16_384
READ = "001# 31 32"
BUS_MODE = {0x82: b"\x05"}


def drive(turns: float = 0.0, enabled: bool = True, **options) -> DriveBench:
    options.setdefault("settings", BUS_MODE)
    bench = DriveBench(MksDrive(position=round(turns * GRAINS_PER_REVOLUTION), **options))
    if enabled:
        assert bench.ask("001# F3 01 F5") == ["001# F3 01 F5"]  # (facts)
    return bench


def told(*data: int, can_id: int = 1) -> Frame:
    return Frame(can_id, bytes((*data, checksum(can_id, bytes(data)))), extended=False)


def said(*data: int, can_id: int = 1) -> str:
    return f"{can_id:03X}# " + bytes((*data, checksum(can_id, bytes(data)))).hex(" ").upper()


def counts(bench: DriveBench) -> int:
    (answer,) = bench.ask(READ)
    return int.from_bytes(bytes.fromhex(answer[5:])[1:7], "big", signed=True)


# --- golden frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_text", "answer"),
    [
        ("001# 30 31", "001# 30 00 00 00 00 00 00 31"),  # (manual)
        (READ, "001# 31 00 00 00 00 00 00 32"),  # (facts)
        ("001# 32 33", "001# 32 00 00 33"),
        ("001# 33 34", "001# 33 00 00 00 00 34"),
        ("001# 34 35", "001# 34 07 3C"),
        ("001# 39 3A", "001# 39 00 00 00 00 3A"),
        ("001# 3A 3B", "001# 3A 01 3C"),
        ("001# 3B 3C", "001# 3B 00 3C"),
        ("001# 3D 3E", "001# 3D 01 3F"),
        ("001# 3E 3F", "001# 3E 00 3F"),
        ("001# 40 41", "001# 40 12 01 00 09 5D"),  # calibrated, board 2, 1.0.9 (manual V1.0.9, 5.1.11)
        ("001# 82 05 88", "001# 82 01 84"),  # (facts)
        ("001# 00 82 83", "001# 82 05 88"),
        ("001# 00 8C 8D", "001# 8C 01 01 8F"),
        ("001# 00 83 84", "001# 83 06 40 CA"),  # 1600 mA
        ("001# 00 11 12", "001# 11 FF FF 10"),  # nothing that it knows (manual)
        ("001# F1 F2", "001# F1 01 F3"),
        ("001# F7 F8", "001# F7 01 F9"),  # (facts)
        ("001# FF C8 C8", "001# FF 01 01"),  # (manual)
    ],
)
def test_answers(request_text, answer):
    assert drive().ask(request_text) == [answer]


@pytest.mark.parametrize(
    ("command", "turns", "rpm"),
    [
        ("001# F5 02 58 02 00 40 00 92", 1.0, 600),  # (facts)
        ("001# F5 02 58 02 FF C0 00 11", -1.0, 600),  # (facts)
        ("001# F4 02 58 02 00 40 00 91", 1.0, 600),  # (facts)
        ("001# F4 02 58 02 FF C0 00 10", -1.0, 600),  # (manual, whose last byte, 09, is not the sum)
        ("001# FD 01 40 02 00 FA 00 3B", 20.0, 320),  # (facts): 64000 pulses of 1/3200 turn
        ("001# FD 81 40 02 00 FA 00 BB", -20.0, 320),  # (manual)
        ("001# FE 02 58 02 00 40 00 9B", 5.12, 600),  # (manual): 0x4000 pulses
        ("001# FE 02 58 02 FF C0 00 1A", -5.12, 600),  # (manual)
    ],
)
def test_positions(command, turns, rpm):
    bench = drive()
    assert bench.ask(command) == [said(int(command[5:7], 16), 1)]
    assert bench.wait(20_000) == [said(int(command[5:7], 16), 2)]
    assert bench.turns == pytest.approx(turns, abs=1e-9)
    _, speeds = bench.drive.shaft.history(np.arange(0, bench.now_ns, 1_000_000))
    assert np.abs(speeds).max() <= rpm


def test_a_speed_and_how_it_ends():
    bench = drive()
    assert bench.ask("001# F6 01 40 02 3A") == ["001# F6 01 F8"]  # CCW, 320 rpm, acc 2 (facts)
    assert bench.after(100).ask("001# F1 F2") == ["001# F1 02 F4"]
    assert bench.after(5000).turns_s == pytest.approx(320 / 60)
    assert bench.ask("001# 32 33") == ["001# 32 01 40 74"]
    assert bench.ask("001# F1 F2") == ["001# F1 04 F6"]
    assert bench.ask("001# F6 00 00 02 F9") == ["001# F6 01 F8"]  # (manual)
    assert bench.after(100).ask("001# F1 F2") == ["001# F1 03 F5"]
    assert bench.wait(5000) == ["001# F6 02 F9"]
    assert bench.turns_s == 0.0
    bench.tell("001# F6 81 40 02 BA")  # (manual): the other way round
    assert bench.after(5000).turns_s == pytest.approx(-320 / 60)


@pytest.mark.parametrize(
    ("stop", "within_s"),
    [
        ("001# F5 00 00 04 00 00 00 FA", 600 * 252 * 50e-6),  # (facts)
        ("001# F5 00 00 00 00 00 00 F6", 0.0),  # (manual)
        ("001# F4 00 00 00 00 00 00 F5", 0.0),  # (manual)
        ("001# FE 00 00 04 00 00 00 03", 600 * 252 * 50e-6),  # (manual)
        ("001# F7 F8", 0.0),  # (facts)
    ],
)
def test_stops_hold(stop, within_s):
    bench = drive().tell(told(0xF5, 2, 0x58, 246, 0x40, 0, 0))
    assert bench.after(1000).turns_s == pytest.approx(10.0)
    bench.tell(stop).wait(within_s * 1000 - 20 if within_s else 0)
    assert (bench.turns_s > 0.0) == (within_s > 0.0)
    bench.wait(40)
    stood = bench.turns
    assert bench.after(5000).turns == stood and bench.drive.enabled
    assert bench.ask("001# 39 3A") == ["001# 39 00 00 00 00 3A"]


def test_the_ramp_is_the_manuals():
    """acc 236: 1 rpm a millisecond (manual 6.1)."""
    bench = drive().tell(told(0xF6, 0, 100, 236))
    _, speeds = zip(*((bench.wait(1), bench.drive.shaft.past(bench.now_ns)[1]) for _ in range(150)), strict=True)
    assert np.abs(np.diff(speeds)).max() == 1.0
    assert speeds[-1] == 100.0 and 98 <= np.count_nonzero(np.diff(speeds)) <= 100


# --- retargeting ----------------------------------------------------------------------------------------


def test_older_firmware_refuses_a_target_in_mid_move():
    bench = drive(retargets=False).tell("001# F5 02 58 02 00 40 00 92")
    assert bench.after(300).ask("001# F5 02 58 02 FF C0 00 11") == [said(0xF5, 0)]
    assert counts(bench.after(10_000)) == COUNTS


# --- answers --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("respond", "active"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_what_is_told_of_motion_is_as_it_is_set(respond, active):
    bench = drive()
    assert bench.ask(told(0x8C, respond, active)) == [said(0x8C, 1)]
    assert bench.ask(told(0xF5, 2, 0x58, 246, 0, 0x40, 0)) == ([said(0xF5, 1)] if respond else [])
    assert bench.wait(5000) == ([said(0xF5, 2)] if respond and active else [])
    assert bench.ask("001# F3 01 F5") == ["001# F3 01 F5"]  # all else is answered


def test_a_broadcast_is_obeyed_and_not_answered():
    bench = drive(enabled=False)
    assert bench.ask(told(0xF3, 1, can_id=0)) == []
    assert bench.drive.enabled
    assert bench.ask(told(0x8D, 0, 0x50)) == [said(0x8D, 1)]
    assert bench.ask(told(0xF3, 0, can_id=0x50)) == []
    assert not bench.drive.enabled


@pytest.mark.parametrize(
    "frame",
    [
        "001# 31 33",  # wrong sum
        "001# 01",
        told(0x31, 0),
        told(0xF5, 2, 0x58, 2, 0, 0x40),
        told(0xAA),
        told(0x91, 1, 2),
    ],
)
def test_what_is_no_command_meets_silence(frame):
    bench = drive()
    assert bench.ask(frame) == [] and bench.wait(1000) == []
    assert bench.turns == 0.0


# --- settings -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "result"),
    [
        ((0x82, 5), 1),
        ((0x82, 6), 0),
        ((0x8C, 2, 0), 0),
        ((0x8A, 3), 1),
        ((0x8A, 4), 0),
        ((0x8B, 0x08, 0), 0),
        ((0x8B, 0, 0), 0),
        ((0x84, 32), 1),
        ((0x83, 3, 0xE8), 1),
    ],
)
def test_settings_are_kept_or_refused(setting, result):
    bench = drive()
    before = bench.drive.settings[setting[0]]
    assert bench.ask(told(*setting)) == [said(setting[0], result)]
    assert bench.ask(told(0, setting[0])) == [said(setting[0], *(setting[1:] if result else before))]
    bench.restart()
    assert bench.drive.settings[setting[0]] == (bytes(setting[1:]) if result else before), "it is in flash"


def test_a_new_identifier_counts_from_the_next_frame():
    bench = drive()
    assert bench.ask(told(0x8B, 7, 0xFF)) == [said(0x8B, 1)]
    assert bench.ask(READ) == []
    assert bench.ask(told(0x31, can_id=0x7FF)) == [said(0x31, *bytes(6), can_id=0x7FF)]


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_without_a_bus_mode_it_obeys_nobody(mode):
    bench = drive(enabled=False, settings={0x82: bytes((mode,))})
    assert bench.ask("001# F1 F2") == ["001# F1 00 F2"]
    assert bench.ask("001# F3 01 F5") == [said(0xF3, 0)]
    assert bench.ask("001# F5 02 58 02 00 40 00 92") == [said(0xF5, 0)]
    assert bench.after(1000).turns == 0.0


# --- protection, power ----------------------------------------------------------------------------------


def test_a_blocked_shaft_trips_the_protection_where_that_is_on():
    bench = drive(turns=0.25, settings=BUS_MODE | {0x88: b"\x01"}).after(1)
    bench.drive.block_shaft(bench.now_ns)
    bench.tell(told(0xF5, 0, 60, 0, 0, 0x40, 0))
    assert bench.after(STALL_NS * 1e-6 - 100).ask("001# 3E 3F") == [said(0x3E, 0)]
    assert bench.after(400).ask("001# 3E 3F") == [said(0x3E, 1)]
    assert bench.ask("001# 3A 3B") == [said(0x3A, 0)]
    assert bench.ask("001# F3 01 F5") == [said(0xF3, 0)]
    assert bench.ask("001# F5 02 58 02 00 40 00 92") == [said(0xF5, 0)]
    bench.drive.cause_lasts = True
    assert bench.ask("001# 3D 3E") == [said(0x3D, 0)]
    bench.drive.cause_lasts = False
    assert bench.ask("001# 3D 3E") == [said(0x3D, 1)]
    assert bench.ask("001# F3 01 F5") == ["001# F3 01 F5"]
    assert bench.turns == 0.25


def test_a_stall_is_told_where_the_protection_is_off_too():
    """And the shaft is held all the same (manual V1.0.9)."""
    bench = drive(turns=0.25).after(1)
    bench.drive.block_shaft(bench.now_ns)
    bench.tell(told(0xF5, 0, 60, 0, 0, 0x40, 0))
    assert bench.after(STALL_NS * 1e-6 + 300).ask("001# 3E 3F") == [said(0x3E, 1)]
    assert bench.ask("001# 3A 3B") == [said(0x3A, 1)]
    assert bench.ask("001# 3D 3E") == [said(0x3D, 1)]
    assert bench.ask("001# 3E 3F") == [said(0x3E, 0)]


def test_an_error_is_told_while_the_shaft_is_held_back():
    bench = drive()
    bench.drive.block_shaft(bench.now_ns)
    bench.tell(told(0xF5, 0, 60, 0, 0, 0x10, 0))  # a quarter of a turn
    assert bench.after(1000).ask("001# 39 3A") == [said(0x39, 0, 0, 0x32, 0)]  # of 51200 steps


# --- homing ---------------------------------------------------------------------------------------------


def test_homing_to_a_mechanical_stop_and_away_from_it():
    bench = drive(turns=2.0)
    bench.drive.shaft.low = round(0.5 * GRAINS_PER_REVOLUTION)
    assert bench.ask("001# 90 00 00 00 64 00 01 F6") == [said(0x90, 1)]  # CW, 100 rpm, no switch (manual)
    assert bench.ask("001# 94 00 00 20 00 02 58 0F") == [said(0x94, 1)]  # back by half a turn (manual)
    assert bench.ask("001# 91 92") == [said(0x91, 1)]  # (manual)
    assert bench.after(500).ask("001# F1 F2") == [said(0xF1, 5)] and bench.ask("001# 3B 3C") == [said(0x3B, 0)]
    assert bench.ask("001# F5 02 58 02 00 40 00 92") == [said(0xF5, 0)]
    assert bench.wait(5000) == [said(0x91, 2)]
    assert bench.turns == pytest.approx(1.0, abs=1e-3) and counts(bench) == 0
    assert bench.ask("001# 3B 3C") == [said(0x3B, 1)]


@pytest.mark.parametrize("turns", [2.0, 0.4], ids=["from afar", "closed already"])
def test_homing_to_a_switch(turns):
    bench = drive(turns=turns)
    bench.drive.switch = (round(0.5 * GRAINS_PER_REVOLUTION), -1)
    assert bench.ask("001# 34 35") == [said(0x34, 0b0111 if turns > 0.5 else 0b0110)]
    bench.tell("001# 90 00 00 00 64 00 00 F5")  # (manual)
    assert bench.ask("001# 91 00 92") == [said(0x91, 1)]  # with the byte of V1.0.9
    assert bench.wait(5000) == [said(0x91, 2)]
    assert bench.turns == pytest.approx(0.5, abs=1e-6) and counts(bench) == 0


def test_a_homing_run_is_ended_by_the_emergency_stop_alone():
    bench = drive(turns=2.0).tell("001# 90 00 00 00 64 00 01 F6", "001# 91 92").after(100)
    assert bench.tell("001# F5 00 00 00 00 00 00 F6").after(100).turns_s != 0.0
    assert said(0x91, 0) in bench.ask("001# F7 F8")
    stood = bench.turns
    assert bench.after(1000).turns == stood and bench.ask("001# 3B 3C") == [said(0x3B, 2)]


def test_the_limit_stops_motion_towards_the_switch_alone():
    bench = drive(turns=1.0, settings=BUS_MODE | {0x90: b"\x00\x00\x00\x3c\x01\x00"})
    bench.drive.switch = (round(0.5 * GRAINS_PER_REVOLUTION), -1)
    assert bench.ask(told(0xF5, 0, 60, 0, 0, 0, 0)) == [said(0xF5, 1)]
    assert bench.wait(2000) == [said(0xF5, 3)]
    assert bench.turns == pytest.approx(0.5, abs=1e-6)
    assert bench.ask(told(0xF5, 0, 60, 0, 0, 0, 0)) == [said(0xF5, 3)]
    assert bench.ask(told(0xF5, 0, 60, 0, 0, 0x40, 0)) == [said(0xF5, 1)]
    assert bench.after(2000).turns == pytest.approx(1.0, abs=1e-6)


def test_calibrating_takes_a_while_and_moves_nothing():
    bench = drive()
    assert bench.ask(told(0x80, 0)) == [said(0x80, 0)]
    assert bench.ask("001# F1 F2") == [said(0xF1, 6)]
    assert bench.wait(3000) == [said(0x80, 1)]
    assert bench.turns == 0.0
