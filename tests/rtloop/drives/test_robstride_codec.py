"""RobStride frames beyond `tests/golden/robstride.yaml`: bring-up, holds, questions, and what is refused.

(facts) marks frames of other-drives.md (host AA, motor 1; sirwart/robstride).
"""

import math
import struct

import pytest
from codec_rig import Rig, arm_of, golden, text_of
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import ConfigError
from config.schema import ArmConfig
from rtloop.drives import robstride_setup
from rtloop.drives.robstride_protocol import RUN_MODES
from rtloop.service.port import Frame

CONTROL, POSITION = (golden("robstride")["joints"][name]["drive"] for name in ("control", "position"))


def told(frame: Frame) -> str:
    return text_of(frame.id, frame.kind, frame.data, len(frame.data))


def test_what_bring_up_says_of_the_facts():
    joint = arm_of(POSITION).joints[0]
    assert told(robstride_setup._frame(joint.drive, 3)) == "0300AA01# 00 00 00 00 00 00 00 00"  # enable (facts)
    mode = next(robstride_setup._prepare(0, joint, 1.0)).frames[0]
    assert told(mode) == "1200AA01# 05 70 00 00 01 00 00 00"  # (facts)
    hold = robstride_setup._hold(arm_of(CONTROL).joints[0].drive, 1.0)
    assert told(hold) == "017FFF01# 8A 2F 7F FF 0F 5C 33 33"  # (facts)
    assert RUN_MODES == {"control": 0, "position": 1, "csp": 5}


@pytest.mark.parametrize("joint", ["control", "position"])
def test_a_stop_is_where_it_is_measured(joint):
    rig = Rig.named("robstride", joint)
    heard = rig.hears("028001AA# 8A 2F 90 00 7F FF 01 31")
    assert rig.sends("stop") == []  # nobody has said yet whether that can be
    rig.axis["measured"]["position_rad"], rig.axis["measured"]["readings"] = heard["position_rad"], 1
    *_, sent = rig.sends("stop")
    if joint == "control":
        assert sent in ("017FFF01# 8A 2F 7F FF 0F 5C 33 33", "017FFF01# 8A 2E 7F FF 0F 5C 33 33")
    else:
        target = struct.pack("<f", heard["position_rad"]).hex(" ").upper()
        assert sent == f"1200AA01# 16 70 00 00 {target}"


@pytest.mark.parametrize("joint", ["control", "position"])
def test_a_motor_that_is_led_is_not_asked_as_well(joint):
    rig = Rig.named("robstride", joint).stands(0.0)
    rig.sends("lead")
    assert rig.sends("ask_position") == []
    assert rig.sends("ask_status") == ["1100AA01# 1C 70 00 00 00 00 00 00"]
    rig.record["timing"]["cycle"] += 1
    assert len(rig.sends("ask_position")) == 1


# --- beyond the end of the position field (RobStrides' manuals of 2026, 4.2.3) ----------------------------


def feedback(rad: float) -> str:
    """Motor 1 runs and stands at so many radians; a field of ±4π goes on at its other end."""
    place = int((rad + 4 * math.pi) / (8 * math.pi) * 65535 % 65535)
    return f"028001AA# {place.to_bytes(2, 'big').hex(' ')} 7F FF 7F FF 01 31"


def measure(rig: Rig, rad: float) -> float:
    """Let a motor tell where it stands; where the joint is measured then."""
    rig.axis["measured"]["position_rad"] = rig.hears(feedback(rad))["position_rad"]
    rig.axis["measured"]["readings"] += 1
    return float(rig.axis["measured"]["position_rad"])


@settings(deadline=None)
@given(
    st.floats(-12.0, 12.0),
    st.lists(st.floats(-3.0, 3.0), max_size=12),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 30.0, -90.0]),
)
def test_a_motor_that_leaves_its_field_is_measured_where_it_is(
    rad: float, steps: list[float], direction: int, zero_deg: float
) -> None:
    rig = Rig.named("robstride", direction=direction, zero_deg=zero_deg)
    for step in [0.0, *steps]:
        if abs(rad + step) < 18.0:  # further than a turn beyond its field no joint gets
            rad += step
            expected = direction * rad - math.radians(zero_deg)
            assert measure(rig, rad) == pytest.approx(expected, abs=4e-4)


@given(st.floats(-12.5, 12.5), st.floats(-math.pi, 2 * math.pi))
@settings(deadline=None)
def test_what_a_motor_counts_after_power_came_is_not_taken_for_that(before: float, after: float) -> None:
    rig = Rig.named("robstride")
    measure(rig, before)
    assert measure(rig, after) == pytest.approx(after, abs=4e-4)


@pytest.mark.parametrize("joint", ["control", "position"])
def test_a_motor_beyond_its_field_is_told_to_stay_and_not_to_turn_back_by_twice_its_field(joint: str) -> None:
    rig = Rig.named("robstride", joint)
    for rad in (12.5, 12.6):
        measure(rig, rad)
    *_, sent = rig.sends("stop")
    if joint == "control":
        assert sent.startswith("017FFF01# FF FF ")  # the end of the field, 0.03 rad from there
    else:
        assert struct.unpack("<f", bytes.fromhex(sent[-11:]))[0] == pytest.approx(12.6, abs=4e-4)


# --- what the arm file refuses --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kp": None}, "kp is missing"),
        ({"kd": None}, "kd is missing"),
        ({"mode": "position"}, "gains of its own"),
        ({"kp": 501.0}, "field reaches to 500"),
        ({"kd": 5.5}, "field reaches to 5"),
        ({"position_gain_1_s": 20.0}, "position loop is not used"),
        ({"motor_id": 0xAA}, "host an ID that no motor has"),
    ],
)
def test_drives_that_are_refused(change, said):
    drive = {key: value for key, value in {**CONTROL, **change}.items() if value is not None}
    with pytest.raises((ConfigError, ValueError), match=said):
        arm_of(drive)


@pytest.mark.parametrize(
    ("drives", "joint", "said"),
    [
        ((CONTROL, CONTROL), {}, "motor_id 1 is used by joint1 and joint2"),
        ((CONTROL, {**CONTROL, "motor_id": 2, "host_id": 1}), {}, "CAN identifiers"),
        ((CONTROL,), {"motor_rpm": 300}, "at most 286.4"),
        ((CONTROL,), {"lower_deg": -800}, "commanded within 2; "),
        ((CONTROL,), {"ratio": 5}, "commanded within 2; "),
        (({**CONTROL, "encoder": "absolute"},), {"upper_deg": 190}, "range is 1.00 motor turns and a RobStride drive"),
        (({**CONTROL, "encoder": "absolute"},), {"ratio": 1.1}, "range is 1.04 motor turns"),
    ],
)
def test_arms_that_are_refused(drives, joint, said):
    with pytest.raises((ConfigError, ValueError), match=said):
        arm_of(*drives, **joint)


def test_a_zdt_drive_with_the_same_number_is_refused_and_another_is_not():
    def joints(address):
        common = {"ratio": 20, "lower_deg": -90, "upper_deg": 90, "motor_rpm": 60, "max_acceleration_rad_s2": 1.0}
        robstride_joint = {**common, "name": "a", "ratio": 1, "drive": CONTROL}
        return [robstride_joint, {**common, "name": "b", "drive": {"family": "zdt", "address": address}}]

    arm = {"name": "arm", "control": {"rate_hz": 100}, "bus": {"interface": "slcan", "channel": "/dev/ttyACM0"}}
    assert len(ArmConfig.model_validate({**arm, "joints": joints(2)}).joints) == 2
    with pytest.raises(ValueError, match="CAN identifiers"):
        ArmConfig.model_validate({**arm, "joints": joints(1)})
