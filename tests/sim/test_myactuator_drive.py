"""The simulated MyActuator motor: golden frames, what moves it, its errors, brake and ROM, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md, (V4.2) those of the maker's protocol.
"""

from __future__ import annotations

import pytest
from drive_bench import DriveBench

from sim.drives.myactuator import OFF, RESTART_NS, SPEED, MyactuatorDrive, Settings
from sim.drives.servo import Load

TARGET = "141# A4 00 F4 01 A0 8C 00 00"  # 360° at 500 dps (facts)
SPIN = "141# A2 00 00 00 10 27 00 00"  # 100 dps (facts)
TIMEOUT = "141# B3 00 00 00 E8 03 00 00"  # 1000 ms (facts)
ANGLE = "141# 92 00 00 00 00 00 00 00"
STATUS = "141# 9A 00 00 00 00 00 00 00"
SHUT_DOWN = "141# 80 00 00 00 00 00 00 00"
STOP = "141# 81 00 00 00 00 00 00 00"
RESTART = "141# 76 00 00 00 00 00 00 00"


def motor(turns: float = 0.0, **changes) -> DriveBench:
    bench = DriveBench(MyactuatorDrive(Settings(**changes), turns=turns, load=Load(1e-3, 0.02, 10.0), seed=1))
    bench.drive.celsius, bench.drive.supply_v = 50.0, 48.5
    return bench


# --- golden frames --------------------------------------------------------------------------------------


def test_a_target_of_the_facts():
    bench = motor()
    assert bench.ask(TARGET)[0].startswith("241# A4 32 ")
    assert bench.after(400).turns_s * 360 == pytest.approx(500)
    assert bench.after(1000).turns == pytest.approx(1.0, abs=1e-6)
    assert bench.ask(ANGLE) == ["241# 92 00 00 00 A0 8C 00 00"]  # (V4.2)


def test_a_speed_of_the_facts():
    bench = motor().tell(SPIN)
    assert bench.after(500).turns_s * 360 == pytest.approx(100)


def test_status_of_the_facts():
    bench = motor().tell(TARGET)
    bench.drive.error = 0x0004
    bench.drive.cause_lasts = True
    assert bench.ask(STATUS) == ["241# 9A 32 00 01 E5 01 04 00"]


def test_feedback_is_laid_out_as_in_the_facts():
    bench = motor(45 / 360, absolute=True)
    assert bench.ask("141# 9C 00 00 00 00 00 00 00") == ["241# 9C 32 00 00 00 00 2D 00"]


def test_ramps_as_the_maker_reads_and_writes_them():
    bench = motor()
    assert bench.ask("141# 42 01 00 00 00 00 00 00") == ["241# 42 01 00 00 10 27 00 00"]  # (V4.2)
    assert bench.ask("141# 43 01 00 00 C8 00 00 00") == ["241# 43 01 00 00 C8 00 00 00"]
    assert bench.ask("141# 42 01 00 00 00 00 00 00") == ["241# 42 01 00 00 C8 00 00 00"]
    assert bench.drive.rom_writes == 1
    bench.tell("141# 43 01 00 00 05 00 00 00")
    assert bench.drive.settings.ramps_dps_s[1] == 200 and bench.drive.rom_writes == 1


def test_model_and_version_of_the_maker():
    bench = motor()
    assert bench.ask("141# B5 00 00 00 00 00 00 00") == ["241# B5 58 38 53 32 56 31 30"]  # (V4.2)
    assert bench.ask("141# B2 00 00 00 00 00 00 00") == ["241# B2 00 00 00 2E 89 34 01"]  # (V4.2)


# --- what moves it --------------------------------------------------------------------------------------


def test_its_ramps_are_those_that_were_set():
    bench = motor(ramps_dps_s=[200, 100, 10_000, 10_000]).tell(TARGET)
    assert bench.after(500).turns_s * 360 == pytest.approx(100, rel=0.01)
    assert bench.after(5000).turns == pytest.approx(1.0, abs=1e-6)


def test_without_ramps_it_follows_at_once():
    bench = motor(ramps_dps_s=[0, 0, 10_000, 10_000]).tell(TARGET)
    assert bench.after(40).turns_s * 360 == pytest.approx(500, rel=0.02)


def test_stop_keeps_the_loop_closed():
    bench = motor().tell(SPIN)
    assert bench.ask(STOP) == ["241# 81 00 00 00 00 00 00 00"]
    assert bench.ask("141# 70 00 00 00 00 00 00 00") == ["241# 70 00 00 00 00 00 00 02"]


def test_by_a_way_and_by_current():
    bench = motor(0.5, absolute=True).tell("141# A8 00 F4 01 28 23 00 00")
    assert bench.after(2000).turns == pytest.approx(0.75, abs=1e-6)
    assert bench.tell("141# A1 00 00 00 64 00 00 00").after(10).turns_s > 0.1


def test_all_motors_hear_one_identifier():
    assert motor(motor_id=7).ask("280# 92 00 00 00 00 00 00 00") == ["247# 92 00 00 00 00 00 00 00"]


# --- errors, brake, power and silence -------------------------------------------------------------------


def test_a_restart_is_not_answered_and_takes_a_while():
    bench = motor()
    assert bench.ask(RESTART) == []
    bench.wait(RESTART_NS / 2e6)
    assert not bench.drive.listening
    assert bench.after(RESTART_NS / 1e6).drive.listening


def test_it_restarts_in_as_long_as_real_ones_take():
    """1.1 s (drives-checked.md, D6)."""
    bench = motor().tell(RESTART)
    assert not bench.after(1_050).drive.listening
    assert bench.after(60).drive.listening


@pytest.mark.parametrize(("error", "stays"), [(0x0800, False), (0x1000, False), (0x2000, True), (0x4000, True)])
def test_what_of_its_errors_only_a_restart_ends(error, stays):
    """Board and motor cool down; the encoder's errors do not recover by themselves (V4.3)."""
    bench = motor()
    bench.drive.error = error
    kept = f"241# 9A 32 00 00 E5 01 {error.to_bytes(2, 'little').hex(' ')}" if stays else "241# 9A 32 00 00 E5 01 00 00"
    assert bench.ask(STATUS) == [kept]
    bench.tell(RESTART).after(1_200)
    assert bench.ask(STATUS) == ["241# 9A 32 00 00 E5 01 00 00"]


def test_a_brake_holds_what_is_shut_down():
    for brake, stays in ((True, True), (False, False)):
        bench = motor(brake=brake).tell(SPIN)
        assert bench.after(100).ask(SHUT_DOWN) == ["241# 80 00 00 00 00 00 00 00"]
        bench.wait(1)
        before = bench.turns
        bench.wait(10)
        assert (bench.turns == before) == stays
        assert bench.ask(STATUS)[0].split()[4] == "00"


def test_the_next_command_ends_what_silence_began():
    bench = motor().tell(TIMEOUT, SPIN)
    assert bench.after(1100).drive.mode == OFF and bench.drive.rom_writes == 1
    bench.tell(SPIN)
    assert bench.drive.mode == SPEED


def test_a_new_zero_counts_after_a_restart_alone():
    bench = motor(0.25, absolute=True)
    assert bench.ask("141# 64 00 00 00 00 00 00 00") == ["241# 64 00 00 00 28 23 00 00"]
    assert bench.ask(ANGLE) == ["241# 92 00 00 00 28 23 00 00"]


# --- what it ignores ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "241# 92 00 00 00 00 00 00 00",
        "141# 55 00 00 00 00 00 00 00",
        "141# 42 09 00 00 00 00 00 00",
    ],
)
def test_frames_that_are_not_for_it(text):
    assert motor().ask(text) == []
