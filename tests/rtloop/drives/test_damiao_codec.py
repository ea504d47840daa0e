"""Damiao frames beyond `tests/golden/damiao.yaml`: numbers against struct, what fields lose, holds and questions."""

import math
import struct

import pytest
from codec_rig import Rig, data_of, frame_of, word
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.drives import damiao, fields
from rtloop.drives.damiao_setup import Feedback, feedback_of, setpoint_bytes, status_words

relaxed = settings(deadline=None)
RIG, PLANNING = Rig.named("damiao", "mit"), Rig.named("damiao", "position_velocity")
RANGES = RIG.config.drive.ranges
gains = (st.floats(1.0, 500.0), st.floats(0.0, 5.0))


def row_with(kp: float, kd: float):
    RIG.row["stiffness_nm_rad"], RIG.row["damping_nm_s_rad"] = kp, kd
    return RIG.row


@relaxed
@given(st.floats(-100.0, 100.0), st.floats(0.0, 100.0))
def test_targets_are_packed_as_struct_does(rad: float, rad_s: float) -> None:
    expected = word(struct.pack("<ff", rad, rad_s))
    assert damiao.target_data(rad, rad_s) == expected


@relaxed
@given(st.floats(-12.5, 12.5), *gains)
def test_bring_up_and_cycle_make_the_same_set_points(rad: float, kp: float, kd: float) -> None:
    drive = RIG.config.drive.model_copy(update={"kp": kp, "kd": kd})
    assert setpoint_bytes(drive, rad) == data_of(damiao.setpoint_data(row_with(kp, kd), rad, 0.0, 0.0))


@relaxed
@given(st.floats(-3.0, 3.0), st.floats(-9.0, 9.0), *gains)
def test_what_position_and_velocity_lose_is_in_the_torque(rad: float, rad_s: float, kp: float, kd: float) -> None:
    """What the motor makes of it beside what was meant, as an error of position: less than a step of each field's."""
    packed = int.from_bytes(data_of(damiao.following_data(row_with(kp, kd), rad, rad_s)), "big")
    told_kp, told_kd = (packed >> 24 & 0xFFF) * 500 / 4095, (packed >> 12 & 0xFFF) * 5 / 4095
    nm = fields.of_field(packed & 0xFFF, RANGES.nm, 12)
    nm += told_kp * fields.of_field(packed >> 48, RANGES.rad, 16)
    nm += told_kd * fields.of_field(packed >> 36 & 0xFFF, RANGES.rad_s, 12)
    of_gains = (kp - told_kp) * 2.0 * RANGES.rad / 65535 + (kd - told_kd) * 2.0 * RANGES.rad_s / 4095
    off = told_kp * rad + told_kd * rad_s - nm
    assert -1e-6 * 56.0 - of_gains <= off <= 56.0 / 4095 + 1e-6 + of_gains


def test_feedback_is_read_in_a_conversation_too() -> None:
    here = Feedback(1, 0x8A3C * 25.0 / 65535 - 12.5, 2047 * 20 / 4095 - 10, 2047 * 56 / 4095 - 28)
    assert feedback_of(bytes.fromhex("118A3C7FF7FF2823"), RANGES) == here


@relaxed
@given(st.binary(min_size=8, max_size=8))
def test_no_bytes_make_a_reading_out_of_range(data: bytes) -> None:
    rig = Rig.named("damiao")
    rig.takes(0x11, b"\x11" + data[1:])
    told = rig.told()
    if "position_rad" in told:
        most = {"position_rad": 12.5, "velocity_rad_s": RANGES.rad_s, "effort_nm": RANGES.nm, "temperature_c": 255.0}
        assert all(abs(told[name]) <= reaches + 1e-9 for name, reaches in most.items())
        assert told["temperature_c"] >= 0.0


@pytest.mark.parametrize(("joint", "identifier"), [("mit", "001"), ("position_velocity", "101")])
def test_a_drive_that_was_led_is_not_asked_as_well(joint: str, identifier: str) -> None:
    rig = Rig.named("damiao", joint).stands(0.0)
    (sent,) = rig.sends("lead")
    assert sent.startswith(identifier) and rig.sends("ask_position") == []
    assert rig.axis["reply"]["questions"] == 1  # its feedback is an answer
    rig.record["timing"]["cycle"] += 1
    assert rig.sends("ask_position") == ["7FF# 01 00 CC 00 00 00 00 00"]


@pytest.mark.parametrize("joint", ["mit", "position_velocity"])
def test_a_stop_is_a_hold_and_never_lets_go(joint: str) -> None:
    """In mode mit where it is measured; with a ramp of its own where that ramp ends, at the speed that it has."""
    rig = Rig.named("damiao", joint, max_acceleration_rad_s2=1.0)
    rig.axis["measured"]["position_rad"], rig.axis["measured"]["readings"], rig.axis["drive"]["velocity_rad_s"] = (
        0.5,
        1,
        -3.0,
    )
    (sent,) = rig.sends("stop")
    data = frame_of(sent)[0].data
    if joint == "mit":
        assert data[:4].hex() == f"{fields.field(0.5, 12.5, 16):04x}7ff6"  # no velocity; stiffness 200 is 666
    else:
        target, speed = struct.unpack("<ff", data)
        way = 3.0**2 / (2.0 * rig.row["silence_deceleration_rad_s2"]) + 3.0 * rig.period_s
        assert target == pytest.approx(0.5 - way)
        assert speed == pytest.approx(3.0)
        rig.axis["drive"]["velocity_rad_s"] = math.nan
        target, speed = struct.unpack("<ff", frame_of(*rig.sends("stop"))[0].data)
        assert (target, speed) == (0.5, pytest.approx(0.25 * rig.config.max_velocity_rad_s))


def test_status_codes_are_told_in_words() -> None:
    assert [status_words(code) for code in (0, 1, 0xD, 0xE, 0x7)] == [
        "limp",
        "enabled",
        "communication lost",
        "overload",
        "0x7",
    ]
