"""The simulated ODrive axis: golden frames, its states, what moves it, and what it ignores.

Frames marked (facts) are the vectors of other-drives.md; the others follow from its tables and the firmware's layout,
those of firmware 0.6 from can_simple_messages.hpp and odrive_enums.h in odriverobotics/ros_odrive.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from drive_bench import DriveBench

from sim.bus import Frame
from sim.drives.odrive import (
    CLOSED_LOOP,
    ESTOP_REQUESTED,
    IDLE,
    INVALID_STATE,
    NOT_CALIBRATED,
    OdriveDrive,
    Settings,
)
from sim.drives.servo import Load, Spin

CLOSE = "027# 08 00 00 00 00 00 00 00"  # node 1 closed loop (facts)
LET_GO = "027# 01 00 00 00"
PASSTHROUGH = "02B# 03 00 00 00 01 00 00 00"  # node 1 position + passthrough (facts)
TRAPEZOID = "02B# 03 00 00 00 05 00 00 00"
RAMPED = "02B# 02 00 00 00 02 00 00 00"


def quiet(node_id: int = 1, **changes) -> Settings:
    return Settings(
        **{"node_id": node_id, "heartbeat_ms": 0, "estimates_ms": 0, "top": 20.0, "ampere": 100.0} | changes
    )


def axis(turns: float = 0.0, **changes) -> DriveBench:
    return DriveBench(OdriveDrive(quiet(**changes), turns=turns, load=Load(1e-4, 0.01, 4.0)))


def position(turns: float, ahead: int = 0, torque: int = 0, node: int = 1) -> Frame:
    return Frame(node << 5 | 0x0C, struct.pack("<fhh", turns, ahead, torque), extended=False)


def floats(node: int, command: int, *values: float) -> Frame:
    return Frame(node << 5 | command, struct.pack(f"<{len(values)}f", *values), extended=False)


# --- golden frames --------------------------------------------------------------------------------------


def test_position_of_the_facts():
    bench = axis(node_id=3)
    bench.tell("067# 08 00 00 00 00 00 00 00", "06C# 00 00 80 3F 00 00 00 00")  # node 3 to 1 rev (facts)
    assert bench.after(2000).turns == pytest.approx(1.0, abs=1e-6)


def test_estimates_of_the_facts():
    bench = axis(node_id=2, turns=0.25, encoder_cpr=4096).tell("047# 08 00 00 00", "047# 01 00 00 00")
    bench.drive.shaft.obey(Spin(-0.5, 1e9))
    assert bench.after(0.1).ask("049# remote") == ["049# 00 00 80 3E 00 00 00 BF"]  # 0.25 rev, -0.5 rev/s (facts)


@pytest.mark.parametrize(
    ("request_text", "answer"),
    [
        ("023# remote", "023# 00 00 00 00 00 00 00 00"),
        ("024# remote", "024# 00 00 00 00 00 00 00 00"),
        ("025# remote", "025# 00 00 00 00 00 00 00 00"),
        ("029# remote", "029# 00 00 40 3F 00 00 00 00"),
        ("029#", "029# 00 00 40 3F 00 00 00 00"),  # the firmware takes a frame without data for a request
        ("02A# remote", "02A# 00 18 00 00 00 18 00 00"),
        ("034# remote", "034# 00 00 00 00 00 00 00 00"),
        ("037# remote", "037# 00 00 C0 41 CD CC 4C 3D"),  # 24 V, 0.05 A
        ("03D# 01", "03D# 00 00 00 00 00 00 00 00"),
    ],
)
def test_reads(request_text, answer):
    assert axis(turns=0.75).tell(CLOSE, LET_GO).ask(request_text) == [answer]


def test_estimates_of_0_5_6_are_zeros_until_the_loop_was_closed_once_since_power_came():
    """can_simple.cpp and start_closed_loop_control in axis.cpp of fw-v0.5.6; the count is true all the time."""
    bench = axis(turns=0.75, absolute=True)
    for _ in range(2):
        assert bench.ask("029# remote") == ["029# 00 00 00 00 00 00 00 00"]
        assert bench.ask("02A# remote") == ["02A# 00 18 00 00 00 18 00 00"]
        bench.tell(CLOSE, LET_GO)
        assert bench.ask("029# remote") == ["029# 00 00 40 3F 00 00 00 00"]
        bench.restart()


# --- firmware 0.6 ---------------------------------------------------------------------------------------


def newer(**changes) -> DriveBench:
    return axis(firmware="0.6", **{"heartbeat_ms": 100} | changes)


@pytest.mark.parametrize("question", ["020# remote", "020#"])
def test_0_6_tells_its_version_and_0_5_6_is_silent(question):
    assert newer().ask(question) == ["020# 02 04 04 3A 00 06 0A 00"]
    assert axis().ask(question) == []


def test_estimates_of_0_6_are_true_before_any_loop_is_closed():
    assert newer(turns=0.75).ask("029# remote") == ["029# 00 00 40 3F 00 00 00 00"]


def test_a_heartbeat_of_0_6_has_the_procedures_result_and_whether_the_trajectory_is_done():
    bench = newer()
    assert bench.wait(100) == ["021# 00 00 00 00 01 00 01 00"]
    assert bench.tell(CLOSE).wait(100) == ["021# 00 00 00 00 08 01 01 00"]
    assert bench.tell(LET_GO).wait(100) == ["021# 00 00 00 00 01 00 01 00"]
    assert bench.tell("022#").wait(100) == ["021# 00 00 00 02 01 03 01 00"]
    assert bench.ask("023# remote") == ["023# 00 00 00 02 00 00 00 02"]
    assert bench.tell("038#", CLOSE).wait(100) == ["021# 00 00 00 00 08 01 01 00"]


@pytest.mark.parametrize(("cause", "error"), [("stall", 0x0400_0000), ("temperature", 0x2000), ("current", 0x1000)])
def test_errors_of_0_6_are_one_word(cause, error):
    bench = newer().tell(CLOSE)
    bench.drive.protect(bench.now_ns, cause)
    assert bench.wait(100) == [f"021# {struct.pack('<I', error).hex(' ').upper()} 01 03 01 00"]


def test_what_0_6_cannot_do_is_a_result_and_no_error():
    bench = newer(calibrated=False).tell(CLOSE)
    assert (bench.drive.state, bench.drive.axis_error, bench.drive.result) == (IDLE, 0, NOT_CALIBRATED)


@pytest.mark.parametrize("gone", ["024# remote", "025# remote", "02A# remote", "035# remote", "03D# 01"])
def test_what_0_6_does_not_know_any_more_meets_silence(gone):
    assert newer(heartbeat_ms=0).ask(gone) == []


# --- both -----------------------------------------------------------------------------------------------


def test_a_remote_request_of_any_length_is_answered():
    bench = axis()
    for length in range(9):
        assert len(bench.ask(Frame(0x029, bytes(length), extended=False, remote=True))) == 1


def test_heartbeats_and_estimates_come_by_themselves():
    bench = DriveBench(OdriveDrive(Settings(node_id=1)))
    said = bench.wait(1000)
    assert said.count("021# 00 00 00 00 01 00 00 80") == 10  # idle, trajectory done
    assert said.count("029# 00 00 00 00 00 00 00 00") == 100
    bench.tell(CLOSE)
    assert "021# 00 00 00 00 08 00 00 80" in bench.wait(100)
    bench.tell("022#")
    assert "021# 00 40 00 00 01 00 00 80" in bench.wait(100)


# --- states ---------------------------------------------------------------------------------------------


def test_an_axis_that_is_not_calibrated_must_be_first():
    bench = axis(calibrated=False).tell(CLOSE)
    assert (bench.drive.state, bench.drive.axis_error) == (IDLE, INVALID_STATE)
    bench.tell("027# 03 00 00 00")
    assert bench.drive.state == IDLE  # an error stands
    bench.tell("038#", "027# 03 00 00 00")
    states, most = [], 0.0
    for _ in range(120):
        bench.wait(100)
        states.append(bench.drive.state)
        most = max(most, bench.turns)
    assert list(dict.fromkeys(states)) == [4, 7, IDLE]
    assert most == pytest.approx(8 / 7, abs=1e-6)
    assert bench.turns == pytest.approx(0.0, abs=1e-6)
    bench.tell(CLOSE)
    assert (bench.drive.state, bench.drive.axis_error) == (CLOSED_LOOP, 0)


def test_an_error_opens_the_loop_and_clearing_does_not_close_it():
    bench = axis().tell(CLOSE, "022#")
    assert (bench.drive.state, bench.drive.axis_error) == (IDLE, ESTOP_REQUESTED)
    bench.tell(CLOSE)
    assert bench.drive.axis_error == ESTOP_REQUESTED | INVALID_STATE
    bench.tell("038#")
    assert (bench.drive.state, bench.drive.axis_error) == (IDLE, 0)
    bench.tell(CLOSE)
    assert bench.drive.state == CLOSED_LOOP


@pytest.mark.parametrize(
    ("cause", "motor", "controller"), [("stall", 0, 0x80), ("temperature", 0, 0), ("current", 0x1000, 0)]
)
def test_which_part_failed_can_be_read(cause, motor, controller):
    bench = axis()
    bench.drive.protect(bench.now_ns, cause)
    assert bench.ask("023# remote") == [f"023# {struct.pack('<Q', motor).hex(' ').upper()}"]
    assert bench.ask("03D# remote") == [f"03D# {struct.pack('<Q', controller).hex(' ').upper()}"]


# --- motion ---------------------------------------------------------------------------------------------


def test_passthrough_with_velocity_ahead_follows_without_lag():
    bench = axis().tell(PASSTHROUGH, CLOSE)
    for tick in range(500):
        bench.tell(position(tick * 0.002, ahead=1000)).wait(2)
    assert bench.turns == pytest.approx(500 * 0.002, abs=3e-3)
    assert bench.turns_s == pytest.approx(1.0, rel=0.05)
    assert bench.tell(position(1.0)).after(2000).turns == pytest.approx(1.0, abs=1e-6)


def test_torque_ahead_accelerates_at_once():
    bench = axis(velocity_gain=1e-6).tell(PASSTHROUGH, CLOSE, position(0.0, torque=50))
    assert bench.after(10).turns_s * 2 * np.pi == pytest.approx(0.05 / 1e-4 * 0.01, rel=0.05)


def test_a_trapezoid_keeps_the_velocity_limit_too_and_says_when_it_is_done():
    bench = axis(heartbeat_ms=10)
    bench.tell(TRAPEZOID, floats(1, 0x0F, 2.0, 100.0), floats(1, 0x11, 3.0), floats(1, 0x12, 10.0, 5.0))
    bench.tell(CLOSE, position(5.0))
    assert bench.wait(500)[-1] == "021# 00 00 00 00 08 00 00 00"
    assert bench.turns_s == pytest.approx(2.0)
    assert bench.wait(5000)[-1] == "021# 00 00 00 00 08 00 00 80"


def test_velocity_control_with_a_ramp_and_without():
    bench = axis(ramp=4.0).tell(RAMPED, CLOSE, floats(1, 0x0D, 2.0, 0.0))
    assert bench.after(250).turns_s == pytest.approx(1.0, abs=0.01)
    bench.tell("02B# 02 00 00 00 01 00 00 00", floats(1, 0x0D, -5.0, 0.0))
    assert bench.after(500).turns_s == pytest.approx(-5.0, rel=0.01)


def test_torque_control_and_the_current_it_takes():
    bench = axis().tell("02B# 01 00 00 00 01 00 00 00", CLOSE, floats(1, 0x0E, 0.05))
    assert bench.after(50).turns_s * 2 * np.pi == pytest.approx((0.05 - 0.01) / 1e-4 * 0.05, rel=0.01)
    (answer,) = bench.ask("034# remote")
    assert struct.unpack("<ff", bytes.fromhex(answer[5:])) == pytest.approx((0.05 / 0.04, 0.05 / 0.04))


def test_limits_hold_for_velocity_and_current():
    bench = axis().tell(PASSTHROUGH, floats(1, 0x0F, 1.5, 1.0), CLOSE, position(3.0)).after(1000)
    speeds = bench.drive.shaft.history(np.arange(0, 10**9, 250_000))[1] / 60.0
    assert 1.4 < speeds.max() <= 1.5 + 1e-9
    most = 1.0 * 0.04 / 1e-4 * 250e-6 / (2 * np.pi)
    assert np.diff(speeds).max() <= most * (1 + 1e-9)


def test_modes_that_do_not_go_together_are_an_error_when_the_loop_is_closed():
    bench = axis().tell("02B# 03 00 00 00 02 00 00 00")
    assert bench.drive.axis_error == 0
    bench.tell(CLOSE)
    assert (bench.drive.state, bench.drive.axis_error, bench.drive.controller_error) == (IDLE, 0x200, 0x02)


def test_a_count_that_is_set_under_a_closed_loop_moves_the_shaft():
    bench = axis(turns=1.0).tell(CLOSE, LET_GO, "039# 00 40 00 00")
    assert bench.ask("029# remote") == ["029# 00 00 00 40 00 00 00 00"]
    assert bench.tell(CLOSE, "039# 00 00 00 00").after(2000).turns == pytest.approx(3.0, abs=1e-6)


# --- power ----------------------------------------------------------------------------------------------


def test_rebooting_is_like_power():
    bench = axis(turns=2.5).tell(floats(1, 0x0F, 1.5, 1.0), CLOSE, "036#")
    assert (bench.drive.state, bench.drive.counted, bench.drive.settings.top) == (IDLE, 0.0, 20.0)


def test_a_new_node_is_heard_at_once_and_kept():
    bench = axis().tell("026# 09 00 00 00")
    assert bench.ask("029# remote") == []
    assert len(bench.ask("129# remote")) == 1
    bench.tell("126# 40 00 00 00")  # there is no node 64
    bench.restart()
    assert len(bench.ask("129# remote")) == 1


# --- what it ignores ------------------------------------------------------------------------------------

NONE = struct.pack("<f", float("nan")).hex(" ")


@pytest.mark.parametrize(
    "text",
    [
        *(f"{0x20 | command:03X}# {NONE} 00 00 80 3F" for command in (0x0C, 0x0D, 0x0E, 0x0F, 0x11, 0x12, 0x1A, 0x1B)),
        *(f"{0x20 | command:03X}# 00 00 80 3F {NONE}" for command in (0x0D, 0x0F, 0x12, 0x1B)),
        *(f"{0x20 | command:03X}# 00 00 00 00 00 00 00 00" for command in (0x0F, 0x11, 0x12, 0x1A, 0x1B)),
        *(f"{0x20 | command:03X}# 05 00 00" for command in (0x06, 0x07, 0x0B, 0x0C, 0x0E, 0x0F, 0x19, 0x1A, 0x1B)),
        *(f"{0x20 | command:03X}# 01 00 00 00 01 00 00 00" for command in (0x00, 0x01, 0x08, 0x10, 0x13, 0x1E, 0x1F)),
    ],
)
def test_what_is_no_command_changes_nothing_and_meets_silence(text):
    bench = axis(turns=0.5).tell(PASSTHROUGH, CLOSE)
    before = repr((bench.drive.settings, bench.drive.state, bench.drive.axis_error, bench.drive._input))
    assert bench.ask(text) == [] and bench.wait(100) == []
    assert repr((bench.drive.settings, bench.drive.state, bench.drive.axis_error, bench.drive._input)) == before
    assert bench.turns == 0.5
