"""The simulated CiA 402 drive: golden frames, its states, its process data, what moves it, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md; transitions are numbered as in CiA 402.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from drive_bench import MILLISECOND, DriveBench
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.bus import Frame
from sim.drives import canopen
from sim.drives.cia402 import (
    CSP,
    FAULT,
    OPERATION_ENABLED,
    PROFILE_POSITION,
    QUICK_STOP,
    READY,
    SWITCH_ON_DISABLED,
    SWITCHED_ON,
    Cia402Drive,
)

COUNTS = 10_000
START, PRE_OPERATIONAL, STOP, RESET = "000# 01 01", "000# 80 01", "000# 02 01", "000# 81 01"
WORDS = {0x06: "06 00", 0x07: "07 00", 0x0F: "0F 00", 0x00: "00 00", 0x02: "02 00", 0x80: "80 00"}
SYNC = "080# "


def drive(turns: float = 0.0, **options) -> DriveBench:
    bench = DriveBench(Cia402Drive(1, counts=COUNTS, turns=turns, **options))
    bench.drive.reply_delay_ns = (0, 0)
    return bench


def put(bench: DriveBench, index: int, value: int, size: int, sub: int = 0) -> None:
    """Write an object, which must be taken."""
    data = (value % (1 << 8 * size)).to_bytes(size, "little").ljust(4, b"\0")
    request = bytes((0x2F, 0x2B, 0x27, 0x23)[size - 1 : size]) + struct.pack("<HB", index, sub) + data
    (answer,) = [said for said in bench.ask(Frame(0x601, request, False)) if said.startswith("581")]
    assert answer.startswith("581# 60"), answer


def got(bench: DriveBench, index: int, sub: int = 0) -> int:
    """An object's value, without its sign."""
    (answer,) = bench.ask(Frame(0x601, struct.pack("<BHBI", 0x40, index, sub, 0), False))
    data = bytes.fromhex(answer[5:])
    assert data[0] & 0xE3 == 0x43, answer
    return int.from_bytes(data[4 : 8 - (data[0] >> 2 & 3)], "little")


def control(bench: DriveBench, *words: int) -> int:
    """Tell controlwords; the state then."""
    for word in words:
        put(bench, 0x6040, word, 2)
    assert got(bench, 0x6041) & 0x6F == bench.drive.power & 0x6F
    return bench.drive.power


def mapped(bench: DriveBench) -> None:
    """Map RPDO1 and TPDO1 as rtarm does, and start the node."""
    for pdo, identifier, objects in (
        (0x1400, 0x201, (0x6040_0010, 0x607A_0020)),
        (0x1800, 0x181, (0x6041_0010, 0x6064_0020)),
    ):
        put(bench, pdo, identifier | 1 << 31, 4, 1)
        put(bench, pdo, 1, 1, 2)
        put(bench, pdo + 0x200, 0, 1)
        for number, one in enumerate(objects, 1):
            put(bench, pdo + 0x200, one, 4, number)
        put(bench, pdo + 0x200, len(objects), 1)
        put(bench, pdo, identifier, 4, 1)
    bench.tell(START)


def following(beat_ms: int = 4) -> DriveBench:
    """A drive that is enabled in CSP, where it stands at 0."""
    bench = drive()
    mapped(bench)
    put(bench, 0x60C2, beat_ms, 1, 1)
    put(bench, 0x6060, CSP, 1)
    assert control(bench, 0x06, 0x07, 0x0F) == OPERATION_ENABLED
    bench.heard()
    return bench


def aim(bench: DriveBench, counts: int) -> None:
    bench.tell(Frame(0x201, struct.pack("<Hi", 0x0F, counts), False), SYNC)


# --- golden frames --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("601# 2B 40 60 00 06 00 00 00", "581# 60 40 60 00 00 00 00 00"),  # (facts)
        ("601# 2F 60 60 00 08 00 00 00", "581# 60 60 60 00 00 00 00 00"),  # (facts)
        ("601# 23 00 14 01 01 02 00 80", "581# 60 00 14 01 00 00 00 00"),  # (facts)
        ("601# 40 64 60 00 00 00 00 00", "581# 43 64 60 00 FE 3F 00 00"),  # (facts) position 16382
        ("601# 40 00 10 00 00 00 00 00", "581# 43 00 10 00 92 01 02 00"),
        ("601# 40 60 60 00 00 00 00 00", "581# 4F 60 60 00 00 00 00 00"),
        ("601# 40 41 60 00 00 00 00 00", "581# 4B 41 60 00 50 00 00 00"),
        ("601# 40 00 20 00 00 00 00 00", "581# 80 00 20 00 00 00 02 06"),
        ("601# 40 18 10 09 00 00 00 00", "581# 80 18 10 09 11 00 09 06"),
        ("601# 2F 41 60 00 00 00 00 00", "581# 80 41 60 00 02 00 01 06"),
        ("601# 2F 40 60 00 06 00 00 00", "581# 80 40 60 00 13 00 07 06"),
        ("601# 23 40 60 00 06 00 00 00", "581# 80 40 60 00 12 00 07 06"),
        ("601# A0 08 10 00 00 00 00 00", "581# 80 08 10 00 01 00 04 05"),  # block transfer
    ],
)
def test_service_data_as_in_the_facts(request_: str, answer: str) -> None:
    bench = drive(turns=16_382 / COUNTS)
    assert bench.ask(request_) == [answer]


def test_a_map_is_taken_apart_and_put_together_as_in_the_facts() -> None:
    bench = drive()
    assert bench.ask("601# 2F 00 16 00 00 00 00 00") == ["581# 80 00 16 00 22 00 00 08"], "it is on"
    for request, answer in (
        ("601# 23 00 14 01 01 02 00 80", "581# 60 00 14 01 00 00 00 00"),
        ("601# 2F 00 16 00 00 00 00 00", "581# 60 00 16 00 00 00 00 00"),
        ("601# 23 00 16 01 10 00 40 60", "581# 60 00 16 01 00 00 00 00"),
        ("601# 23 00 16 02 10 00 08 10", "581# 80 00 16 02 41 00 04 06"),
        ("601# 2F 00 16 00 02 00 00 00", "581# 80 00 16 00 41 00 04 06"),
        ("601# 23 00 16 02 20 00 7A 60", "581# 60 00 16 02 00 00 00 00"),
        ("601# 2F 00 16 00 02 00 00 00", "581# 60 00 16 00 00 00 00 00"),
    ):
        assert bench.ask(request) == [answer]


def test_a_name_comes_in_segments() -> None:
    bench = drive()
    assert bench.ask("601# 40 08 10 00 00 00 00 00") == ["581# 41 08 10 00 23 00 00 00"]
    name, toggle = b"", 0
    while True:
        (answer,) = bench.ask(f"601# {0x60 | toggle << 4:02X} 00 00 00 00 00 00 00")
        data = bytes.fromhex(answer[5:])
        assert data[0] >> 4 == toggle
        name += data[1 : 8 - (data[0] >> 1 & 7)]
        toggle ^= 1
        if data[0] & 1:
            break
    assert name == b"rtarm simulated CiA 402 servo drive"
    assert bench.ask("601# 60 00 00 00 00 00 00 00") == ["581# 80 00 00 00 01 00 04 05"], "it is over"
    bench.ask("601# 40 08 10 00 00 00 00 00")
    assert bench.ask("601# 70 00 00 00 00 00 00 00") == ["581# 80 08 10 00 00 00 03 05"], "the toggle bit"


@settings(deadline=None)
@given(st.integers(-(2**31), 2**31 - 1))
def test_numbers_are_read_back(value: int) -> None:
    bench = drive()
    put(bench, 0x607A, value, 4)
    assert got(bench, 0x607A) == value % 2**32


# --- the node -------------------------------------------------------------------------------------------------


def test_the_node_goes_where_it_is_ordered_and_says_so() -> None:
    bench = drive()
    put(bench, 0x1017, 100, 2)
    assert set(bench.wait(250)) == {"701# 7F"}
    bench.tell("000# 01 00")
    assert bench.wait(500) == ["701# 05"] * 5
    bench.tell(STOP)
    assert bench.ask("601# 40 41 60 00 00 00 00 00") == []
    assert set(bench.wait(250)) == {"701# 04"}
    bench.tell(START, "000# 80 02")
    assert set(bench.wait(250)) == {"701# 05"}
    bench.tell(RESET)
    assert bench.wait(1000) == ["701# 00"], "the boot-up message, and no heartbeat any more"
    assert got(bench, 0x1017) == 0


def test_what_was_stored_is_there_after_a_reset() -> None:
    bench = drive()
    save = "601# 23 10 10 01 73 61 76 65"
    assert got(bench, 0x1010, 1) == 1
    put(bench, 0x1017, 100, 2)
    assert bench.ask("601# 23 10 10 01 73 61 76 66")[-1] == "581# 80 10 10 01 20 00 00 08", "another word"
    assert bench.ask(save) == ["581# 60 10 10 01 00 00 00 00"]
    put(bench, 0x6080, 3000, 4)
    bench.tell(RESET).after(1000)
    assert (got(bench, 0x1017), got(bench, 0x6080)) == (100, 600)
    control(bench, 0x06, 0x07, 0x0F)
    assert bench.ask(save) == ["581# 80 10 10 01 22 00 00 08"], "not while it holds"


@pytest.mark.parametrize(
    ("code", "power"), [(0, OPERATION_ENABLED), (1, FAULT), (2, SWITCH_ON_DISABLED), (3, QUICK_STOP)]
)
def test_a_node_that_leaves_its_operation_does_what_6007_says(code: int, power: int) -> None:
    bench = following()
    put(bench, 0x6007, code, 2)
    bench.tell(PRE_OPERATIONAL)
    assert bench.drive.power == power


def test_it_fails_when_the_host_it_monitors_is_silent() -> None:
    bench = following()
    put(bench, 0x1016, 0x007F_0064, 4, 1)
    assert bench.after(500).drive.power == OPERATION_ENABLED, "the first heartbeat begins that"
    bench.tell("77F# 05").wait(90)
    assert bench.tell("77F# 05").after(90).drive.power == OPERATION_ENABLED
    assert next(said for said in bench.wait(20) if said.startswith("081")) == "081# 30 81 10 00 00 00 00 00"
    assert (bench.drive.power, bench.drive.state) == (FAULT, canopen.PRE_OPERATIONAL)


# --- power states ---------------------------------------------------------------------------------------------


TRANSITIONS = [
    ((), 0x06, READY),  # 2
    ((), 0x07, SWITCH_ON_DISABLED),
    ((), 0x0F, SWITCH_ON_DISABLED),
    ((0x06,), 0x07, SWITCHED_ON),  # 3
    ((0x06,), 0x0F, OPERATION_ENABLED),  # 3 and 4
    ((0x06,), 0x00, SWITCH_ON_DISABLED),  # 7
    ((0x06,), 0x02, SWITCH_ON_DISABLED),  # 7
    ((0x06, 0x07), 0x0F, OPERATION_ENABLED),  # 4
    ((0x06, 0x07), 0x06, READY),  # 6
    ((0x06, 0x07), 0x00, SWITCH_ON_DISABLED),  # 10
    ((0x06, 0x07, 0x0F), 0x07, SWITCHED_ON),  # 5
    ((0x06, 0x07, 0x0F), 0x06, READY),  # 8
    ((0x06, 0x07, 0x0F), 0x00, SWITCH_ON_DISABLED),  # 9
    ((0x06, 0x07, 0x0F), 0x02, QUICK_STOP),  # 11
    ((0x06, 0x07, 0x0F, 0x02), 0x00, SWITCH_ON_DISABLED),  # 12
    ((0x06, 0x07, 0x0F, 0x02), 0x06, QUICK_STOP),
]


@pytest.mark.parametrize(("before", "word", "power"), TRANSITIONS)
def test_controlwords_lead_from_state_to_state(before: tuple[int, ...], word: int, power: int) -> None:
    bench = drive()
    assert control(bench, *before, word) == power
    assert bench.drive.enabled == (power in (OPERATION_ENABLED, QUICK_STOP))


@pytest.mark.parametrize(
    ("code", "then", "again"), [(2, SWITCH_ON_DISABLED, SWITCH_ON_DISABLED), (6, QUICK_STOP, OPERATION_ENABLED)]
)
def test_a_quick_stop_ends_as_605a_says(code: int, then: int, again: int) -> None:
    bench = drive()
    put(bench, 0x605A, code, 2)
    put(bench, 0x6060, PROFILE_POSITION, 1)
    put(bench, 0x607A, 100 * COUNTS, 4)
    control(bench, 0x06, 0x07, 0x0F, 0x1F)
    assert bench.after(300).turns_s > 1.0
    assert control(bench, 0x02) == QUICK_STOP
    bench.wait(200)
    assert (bench.drive.power, bench.turns_s) == (then, 0.0)
    assert control(bench, 0x0F) == again  # 16


def test_a_fault_is_reset_by_the_rising_edge_alone() -> None:
    bench = following()
    bench.drive.protect(bench.now_ns, "current")
    assert bench.heard()[0] == "081# 10 23 01 00 00 00 00 00"
    assert got(bench, 0x1001) == 1
    bench.drive.cause_lasts = True
    assert control(bench, 0x06, 0x80) == FAULT
    bench.drive.cause_lasts = False
    assert control(bench, 0x80) == FAULT, "no edge"
    assert control(bench, 0x00, 0x80) == SWITCH_ON_DISABLED  # 15
    assert got(bench, 0x1001) == 0


# --- process data ---------------------------------------------------------------------------------------------


def test_targets_wait_for_the_sync_and_answers_come_with_it() -> None:
    bench = following()
    assert bench.ask(Frame(0x201, struct.pack("<Hi", 0x0F, 77), False)) == []
    assert got(bench, 0x607A) == 0
    (answer,) = bench.ask(SYNC)
    assert answer == "181# " + struct.pack("<Hi", 0x1237, 0).hex(" ").upper().ljust(17)
    assert got(bench, 0x607A) == 77


def test_a_target_that_is_too_short_is_an_emergency_and_no_target() -> None:
    bench = following()
    assert bench.ask(Frame(0x201, b"\x0f\x00\x01", False)) == ["081# 10 82 10 00 00 00 00 00"]
    bench.tell(SYNC)
    assert got(bench, 0x607A) == 0


def test_nothing_of_it_before_the_node_is_operational() -> None:
    bench = following()
    put(bench, 0x6007, 0, 2)
    bench.tell(PRE_OPERATIONAL, Frame(0x201, struct.pack("<Hi", 0x00, 77), False))
    assert bench.ask(SYNC) == [] and bench.drive.power == OPERATION_ENABLED


def test_what_happens_is_told_by_event_driven_pdos() -> None:
    """As they are after power comes: the statusword when it changes."""
    bench = drive().tell(START)
    said = bench.ask("601# 2B 40 60 00 06 00 00 00")
    assert [one[:5] for one in said] == ["181# ", "281# ", "381# ", "581# "]


# --- motion ---------------------------------------------------------------------------------------------------


def test_it_goes_in_straight_lines_from_target_to_target() -> None:
    """CSP: 20 counts every 4 ms; within the loop's lag of the line, with hardly any ripple once it has settled."""
    bench = following()
    for step in range(1, 101):
        aim(bench, 20 * step)
        bench.wait(4)
    times = np.arange(bench.now_ns - 200 * MILLISECOND, bench.now_ns, MILLISECOND // 4)
    turns, rpm = bench.drive.shaft.history(times)
    line = 20 * (times - (bench.now_ns - 400 * MILLISECOND)) / (4 * MILLISECOND) / COUNTS
    assert np.abs(turns - line).max() * COUNTS <= 2.0
    assert np.std(rpm) <= 1e-3 * np.mean(rpm)


def test_the_line_ends_where_no_target_comes() -> None:
    bench = following()
    for step in range(1, 51):
        aim(bench, 20 * step)
        bench.wait(4)
    assert bench.after(200).turns_s == 0.0 and bench.turns == pytest.approx(1000 / COUNTS, abs=1e-6)
    assert bench.drive.power == OPERATION_ENABLED


def test_a_careless_host_is_found_out() -> None:
    """Enabled with a target that lies elsewhere it goes there, and fails where that is too far."""
    bench = drive(turns=0.1)
    put(bench, 0x6060, CSP, 1)
    control(bench, 0x06, 0x07, 0x0F)
    assert bench.after(200).turns == pytest.approx(0.0, abs=1e-4)
    bench = following()
    bench.drive.block_shaft(bench.now_ns)
    for step in range(1, 51):
        aim(bench, 100 * step)
        bench.wait(4)
    assert (bench.drive.power, bench.drive.number(0x603F)) == (FAULT, 0x8611)


def test_a_profile_move_halts_and_arrives() -> None:
    bench = drive()
    put(bench, 0x6060, PROFILE_POSITION, 1)
    put(bench, 0x607A, 5 * COUNTS, 4)
    control(bench, 0x06, 0x07, 0x0F, 0x1F)
    bench.wait(200)
    control(bench, 0x11F)
    bench.wait(500)
    stood = bench.turns
    assert 0.0 < stood < 5.0 and bench.turns_s == 0.0 and got(bench, 0x6041) & 0x400
    control(bench, 0x0F)
    assert bench.after(500).turns == pytest.approx(stood)
    control(bench, 0x1F)
    assert bench.after(3000).turns == pytest.approx(5.0) and got(bench, 0x6041) & 0x1400 == 0x1400
