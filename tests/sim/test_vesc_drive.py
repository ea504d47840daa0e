"""The simulated VESC: golden frames, what it sends by itself, its time-out, its faults, and what moves it.

Bytes follow from comm/comm_can.c, comm/commands.c and documentation/comm_can.md in vedderb/bldc at b9d287b3.
"""

from __future__ import annotations

import pytest
from drive_bench import DriveBench

from sim.drives.servo import Load
from sim.drives.vesc import Settings, VescDrive

QUARTER = "00000401# 05 5D 4A 80"  # go to 90 degrees
COAST = "00000101# 00 00 00 00"
ASK_FAULT, ASK_RELEASED = "00000801# FE 00 32 00 00 80 00", "00000801# FE 00 32 00 20 00 00"
ALIVE = "00000801# FE 00 1E"
SAYS_FAULT, SAYS_RELEASED = "000008FE# 01 01 32 00 00 80 00", "000008FE# 01 01 32 00 20 00 00"


def vesc(turns: float = 0.0, **settings: float) -> DriveBench:
    found = Settings(**{"position_hz": 0, "others_hz": 0, "stiffness_nm": 10.0, "damping_nm_s": 0.5} | settings)
    return DriveBench(VescDrive(found, turns=turns, load=Load(1e-3, 0.01, 10.0)))


def test_it_sends_its_position_and_its_supply_at_their_rates() -> None:
    bench = vesc(0.25, position_hz=200, others_hz=5)
    said = bench.wait(1000)
    assert said.count("00001001# 01 2C 01 2C 00 00 11 94") == pytest.approx(200, abs=1)
    assert said.count("00001B01# 00 00 00 0A 00 F0 00 00") == pytest.approx(5, abs=1)
    assert said.count("00000901# 00 00 00 00 00 00 00 00") == pytest.approx(5, abs=1)


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("00001101# FE", ["000012FE# 01 00"]),  # ping
        ("00001102# FE", []),
        (ASK_FAULT, [f"{SAYS_FAULT} 00"]),
        (ASK_RELEASED, [f"{SAYS_RELEASED} 00"]),
        ("00003801# 00 00 00 00", ["00003801# 00 89 54 40"]),  # 90 degrees in hundred-thousandths
        ("00000801# FE 00 32 00 01 00 00", []),  # the position by mask, which takes more than one frame
        ("00000801# FE 02 32 00 00 80 00", []),  # to be done without an answer
        ("00000801# FE 00", []),
    ],
)
def test_what_it_is_asked_it_answers_to_who_asks(question: str, answer: list[str]) -> None:
    assert vesc(0.25).ask(question) == answer


@pytest.mark.parametrize(("start", "end"), [(0.1, 0.25), (0.5, 0.25), (0.7, 0.25), (0.8, 1.25), (-0.5, -0.75)])
def test_it_goes_the_shorter_way_round(start: float, end: float) -> None:
    assert vesc(start).tell(QUARTER).after(2000).turns == pytest.approx(end, abs=1e-6)


def test_it_takes_a_number_of_its_own_and_255() -> None:
    assert vesc().tell(QUARTER.replace("401", "402")).after(500).turns == 0.0
    assert vesc().tell(QUARTER.replace("401", "4FF")).after(2000).turns == pytest.approx(0.25, abs=1e-6)


def test_a_time_out_lets_go_until_something_is_commanded() -> None:
    bench = vesc(timeout_ms=100).tell(QUARTER)
    assert bench.after(99).drive.enabled
    assert not bench.after(2).drive.enabled
    assert bench.ask(ASK_RELEASED) == [f"{SAYS_RELEASED} 01"]
    bench.tell(QUARTER)
    assert bench.drive.enabled and bench.ask(ASK_RELEASED) == [f"{SAYS_RELEASED} 00"]


def test_being_said_to_be_alive_is_enough_and_being_asked_is_not() -> None:
    for frame, holds in ((ALIVE, True), (ASK_FAULT, False)):
        bench = vesc(timeout_ms=100).tell(QUARTER)
        for _ in range(10):
            bench.after(60).tell(frame)
        assert bench.drive.enabled == holds


def test_what_it_is_told_during_a_fault_is_ignored_and_obeyed_half_a_second_after_its_cause() -> None:
    bench = vesc()
    bench.drive.protect(bench.now_ns, "current")
    assert bench.tell(QUARTER).after(400).turns == 0.0
    assert bench.ask(ASK_FAULT) == [f"{SAYS_FAULT} 04"]
    bench.after(200)
    assert bench.ask(ASK_FAULT) == [f"{SAYS_FAULT} 00"]
    assert bench.tell(QUARTER).after(2000).turns == pytest.approx(0.25, abs=1e-6)


def test_a_kill_switch_lets_go_and_what_is_told_meanwhile_counts_for_nothing() -> None:
    bench = vesc().tell(QUARTER).after(10)
    bench.drive.kill(bench.now_ns, pressed=True)
    assert bench.drive.limp and bench.tell(QUARTER).drive.limp
    assert bench.ask(ASK_RELEASED) == [f"{SAYS_RELEASED} 02"]
    bench.drive.kill(bench.now_ns, pressed=False)
    assert bench.drive.limp and not bench.tell(QUARTER).drive.limp


def test_no_current_lets_it_coast_and_some_turns_it() -> None:
    assert vesc().tell(QUARTER, COAST).drive.limp
    assert vesc().tell("00000101# 00 00 01 F4").after(100).turns > 0.0  # half an ampere
    assert vesc().tell("00000101# FF FF FE 0C").after(100).turns < 0.0
    assert vesc().tell("00000301# 00 00 01 A4").after(3000).turns_s == pytest.approx(1.0)  # 420 ERPM, 7 pole pairs
