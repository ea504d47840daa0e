"""RobStride frames in the cycle: the vectors of the facts in both directions, numbers against struct, hostile bytes.

(facts) marks vectors of other-drives.md (host AA, motor 1; sirwart/robstride), (manual) what follows from the tables of
the CyberGear's manual in belovictor/cybergear-docs.
"""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import ConfigError
from config.schema import ArmConfig
from rtloop import status
from rtloop.beginning import new_loop
from rtloop.drives import robstride, robstride_setup
from rtloop.drives.robstride_setup import RUN_MODES
from rtloop.measured import take_frame
from rtloop.wire.frame_words import EXTENDED, REMOTE, STANDARD
from shm import layout

relaxed = settings(deadline=None)


def arm_of(*drives, **joint):
    """Joints of CyberGears that differ only in what is given."""
    joints = [
        {
            "name": f"joint{number}",
            "drive": {"family": "robstride", "host_id": 0xAA, **drive},
            **{"ratio": 1, "lower_deg": -170, "upper_deg": 170, "motor_rpm": 60, "max_acceleration_rad_s2": 5.0},
            **joint,
        }
        for number, drive in enumerate(drives, 1)
    ]
    bus = {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 1_000_000}
    return ArmConfig.model_validate({"name": "arm", "control": {"rate_hz": 100}, "bus": bus, "joints": joints})


CONTROL = {"motor_id": 1, "mode": "control", "kp": 30.0, "kd": 1.0}
POSITION = {"motor_id": 1, "mode": "position"}


class Cycle:
    """A loop of one motor, which is told to send and hears frames."""

    def __init__(self, drive=CONTROL, **joint):
        self.arm = arm_of(drive, **joint)
        self.loop = new_loop(self.arm, 0, 0)
        self.shared = np.zeros(1, layout.STATE)
        self.core, self.axis = self.loop[0]["core"], self.loop[0]["axes"][0]
        self.core["cycle"] = self.core["shown_cycle"] = 5

    def stands(self, position_rad, velocity_rad_s=0.0):
        """Command the joint to move evenly, and measure it there."""
        axis, period_s = self.axis, self.arm.control.period_ns * 1e-9
        axis["position_rad"] = axis["measured_rad"] = axis["reference_rad"] = position_rad
        axis["next_position_rad"] = position_rad + velocity_rad_s * period_s
        axis["velocity_rad_s"] = axis["next_velocity_rad_s"] = velocity_rad_s
        return self

    def sends(self, function):
        """What one of the family's functions sends, as text."""
        self.core["tx_frames"] = self.core["tx_length"] = 0
        function(self.loop[0], 0, self.shared[0])
        frames = []
        for number in range(self.core["tx_frames"]):
            assert self.loop[0]["tx_kinds"][number] == EXTENDED
            data = int(self.loop[0]["tx_data"][number]).to_bytes(8, "little", signed=True)
            size = self.loop[0]["tx_sizes"][number]
            frames.append(f"{int(self.loop[0]['tx_ids'][number]):08X}# {data[:size].hex(' ').upper()}")
        return frames

    def hears(self, text, kind=EXTENDED):
        """A frame that comes from the bus."""
        ident, _, data = text.partition("#")
        self.take(int(ident, 16), bytes.fromhex(data), kind)

    def take(self, frame_id, data, kind=EXTENDED):
        word = int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)
        take_frame(self.loop[0], self.shared[0], frame_id, kind, len(data), word, 1_000_000_000)


def floats(text):
    return struct.unpack("<f", bytes.fromhex(text.partition("# ")[2])[4:])[0]


# --- golden frames --------------------------------------------------------------------------------------


def test_a_set_point_of_the_facts():
    """p 1.0, kp 30, kd 1 (facts)."""
    assert Cycle().stands(1.0).sends(robstride.lead) == ["017FFF01# 8A 2F 7F FF 0F 5C 33 33"]


def test_a_target_of_the_facts():
    """Target 1.0 rad (facts), behind its speed limit."""
    limit, target = Cycle(POSITION).stands(1.0).sends(robstride.lead)
    assert target == "1200AA01# 16 70 00 00 00 00 80 3F"
    assert limit.startswith("1200AA01# 17 70 00 00 ")


def test_questions_of_the_facts():
    assert Cycle().sends(robstride.ask_position) == ["1100AA01# 19 70 00 00 00 00 00 00"]  # read position (facts)
    cycle = Cycle()
    asked = set()
    for turn in range(2):
        cycle.core["cycle"] = 10 + turn
        asked |= set(cycle.sends(robstride.ask_status))
    assert asked == {"1100AA01# 1C 70 00 00 00 00 00 00", "1200AA01# 0A 70 00 00 00 00 00 00"}  # (manual)


def test_what_bring_up_says_of_the_facts():
    joint = arm_of(POSITION).joints[0]
    frame = robstride_setup._frame(joint.drive, 3)
    assert (f"{frame.id:08X}", frame.data) == ("0300AA01", bytes(8))  # enable (facts)
    mode = next(robstride_setup._prepare(0, joint, 1.0)).frames[0]
    assert (f"{mode.id:08X}", mode.data.hex(" ").upper()) == ("1200AA01", "05 70 00 00 01 00 00 00")  # (facts)
    hold = robstride_setup._hold(arm_of(CONTROL).joints[0].drive, 1.0)
    assert (f"{hold.id:08X}", hold.data.hex(" ").upper()) == ("017FFF01", "8A 2F 7F FF 0F 5C 33 33")  # (facts)
    assert RUN_MODES == {"control": 0, "position": 1, "csp": 5}


def test_a_feedback_of_the_facts():
    """Run, 1.0 rad, 30.5 °C (facts)."""
    cycle = Cycle()
    cycle.hears("028001AA# 8A 2F 7F FF 7F FF 01 31")
    axis = cycle.axis
    assert axis["heard"] == 1 and axis["heard_rad"] == pytest.approx(1.0, abs=2e-4)
    assert axis["told_velocity_rad_s"] == pytest.approx(0.0, abs=30 / 65535)
    assert axis["effort_nm"] == pytest.approx(0.0, abs=12 / 65535)
    assert axis["temperature_c"] == pytest.approx(30.5)
    assert axis["status"] == status.ENABLED | status.ANSWERED


@pytest.mark.parametrize(
    ("flags", "bits"),
    [
        (0x80, status.ENABLED),
        (0x00, 0),
        (0x40, 0),  # calibrating
        (0x81, status.ENABLED | status.PROTECTED | status.UNDER_VOLTAGE),
        (0x02, status.PROTECTED | status.OVER_CURRENT),
        (0x04, status.PROTECTED | status.OVER_TEMPERATURE),
        (0x08, status.PROTECTED | status.ENCODER),
        (0x10, status.PROTECTED | status.ENCODER),
        (0x20, status.PROTECTED | status.ENCODER),
        (0x07, status.PROTECTED | status.UNDER_VOLTAGE | status.OVER_CURRENT | status.OVER_TEMPERATURE),
    ],
)
def test_flags_of_a_feedback(flags, bits):
    """Bits 16 to 23 of its identifier (facts)."""
    cycle = Cycle()
    cycle.take(0x020001AA | flags << 16, bytes(8))
    assert cycle.axis["status"] == bits | status.ANSWERED


@pytest.mark.parametrize(
    ("fault", "bits"),
    [
        (0x0001, status.OVER_TEMPERATURE),
        (0x0002, 0),  # driver chip
        (0x0004, status.UNDER_VOLTAGE),
        (0x0008, status.OVER_VOLTAGE),
        (0x0010, status.OVER_CURRENT),
        (0x0020, status.OVER_CURRENT),
        (0x0080, status.ENCODER),
        (0x0100, 0),  # overload
        (0x10000, status.OVER_CURRENT),
    ],
)
@pytest.mark.parametrize("frame_id", [0x150001AA, 0x1500AA01])
def test_a_fault_that_it_says_by_itself(frame_id, fault, bits):
    """The word of type 21 (manual), whichever of motor and host stands first."""
    cycle = Cycle()
    cycle.take(frame_id, struct.pack("<II", fault, 0))
    assert cycle.axis["status"] == bits | status.PROTECTED | status.ANSWERED
    assert cycle.axis["bad_statuses"] == 1


def test_a_warning_is_no_fault():
    cycle = Cycle()
    cycle.take(0x150001AA, struct.pack("<II", 0, 1))
    assert cycle.axis["status_readings"] == 0


@pytest.mark.parametrize(
    ("index", "word"),
    [(0x7019, "heard_rad"), (0x701B, "told_velocity_rad_s"), (0x701C, "voltage_v")],
)
def test_parameters_that_are_read(index, word):
    cycle = Cycle()
    cycle.take(0x110001AA, struct.pack("<Hxxf", index, 1.25))
    assert cycle.axis[word] == pytest.approx(1.25)
    assert cycle.axis["heard"] == (index == 0x7019)


# --- numbers --------------------------------------------------------------------------------------------

places = st.floats(-2.9, 2.9)
speeds = st.floats(-6.0, 6.0)


@relaxed
@given(places, st.sampled_from([1, -1]), st.floats(0.5, 2.7), st.floats(-90.0, 90.0))
def test_a_set_point_is_read_back_as_it_was_meant(place, direction, ratio, zero_deg):
    cycle = Cycle(direction=direction, ratio=ratio, zero_deg=zero_deg).stands(place)
    (text,) = cycle.sends(robstride.lead)
    position, velocity, kp, kd = struct.unpack(">HHHH", bytes.fromhex(text.partition("# ")[2]))
    turned = direction * ratio * (place + math.radians(zero_deg))
    most = 4 * math.pi
    meant = min(max(turned, -most), most)
    assert position / 65535 * 2 * most - most == pytest.approx(meant, abs=2 * most / 65535)
    assert (velocity, kp, kd) == (0x7FFF, 3932, 13107)


@relaxed
@given(speeds)
def test_the_velocity_goes_ahead_of_a_set_point(speed):
    (text,) = Cycle().stands(0.0, speed).sends(robstride.lead)
    velocity = struct.unpack(">H", bytes.fromhex(text.partition("# ")[2])[2:4])[0]
    assert velocity / 65535 * 60.0 - 30.0 == pytest.approx(speed, abs=60 / 65535)


@relaxed
@given(st.integers(0, 65535), st.integers(0, 65535), st.integers(0, 65535), st.integers(-400, 1500), st.booleans())
def test_any_feedback_is_what_struct_says(position, velocity, torque, tenths, backwards):
    cycle = Cycle(direction=-1 if backwards else 1, ratio=2.0, zero_deg=10.0)
    cycle.take(0x028001AA, struct.pack(">HHHh", position, velocity, torque, tenths))
    sign = -1 if backwards else 1
    turned = position / 65535 * 8 * math.pi - 4 * math.pi
    assert cycle.axis["heard_rad"] == pytest.approx(sign * turned / 2.0 - math.radians(10.0))
    assert cycle.axis["told_velocity_rad_s"] == pytest.approx(sign * (velocity / 65535 * 60 - 30) / 2.0)
    assert cycle.axis["effort_nm"] == pytest.approx(sign * (torque / 65535 * 24 - 12) * 2.0)
    assert cycle.axis["temperature_c"] == pytest.approx(tenths / 10)


@relaxed
@given(places, st.floats(-6.2, 6.2), st.floats(-0.2, 0.2), st.sampled_from([1, -1]))
def test_a_target_lies_ahead_but_never_beyond_the_limits(place, speed, error, direction):
    cycle = Cycle(POSITION, direction=direction, ratio=2.0).stands(place, speed)
    cycle.axis["measured_rad"] = place - error
    cycle.axis["error_before_rad"] = error
    limit, target = cycle.sends(robstride.lead)
    found_rad = direction * floats(target) / 2.0
    config, pace = cycle.arm.joints[0], floats(limit) / 2.0
    slack = 2 * config.command_pulse_rad
    assert config.lower_rad - slack <= found_rad <= config.upper_rad + slack
    assert 0.0 <= pace <= 1.05 * config.max_velocity_rad_s * (1 + 1e-6)
    ahead = found_rad - cycle.axis["next_position_rad"]
    if config.lower_rad < found_rad < config.upper_rad and speed != 0.0:
        # so far that the loop does not slow down within the period, nor within the next if one frame is lost
        assert abs(ahead) >= pace * (1 / 30 + cycle.arm.control.period_ns * 1e-9) - 1e-6


def test_a_motor_that_stands_is_told_where_it_stands():
    limit, target = Cycle(POSITION).stands(0.5).sends(robstride.lead)
    assert floats(target) == pytest.approx(0.5, abs=1e-7)
    assert floats(limit) == pytest.approx(0.25 * 2 * math.pi)


@pytest.mark.parametrize("drive", [CONTROL, POSITION])
def test_a_stop_is_where_it_is_measured(drive):
    cycle = Cycle(drive)
    assert cycle.sends(robstride.stop) == []
    cycle.hears("028001AA# 8A 2F 90 00 7F FF 01 31")
    assert cycle.sends(robstride.stop) == []  # nobody has said yet whether that can be
    cycle.axis["measured_rad"], cycle.axis["readings"] = cycle.axis["heard_rad"], 1
    *_, told = cycle.sends(robstride.stop)
    if drive == CONTROL:
        assert told in ("017FFF01# 8A 2F 7F FF 0F 5C 33 33", "017FFF01# 8A 2E 7F FF 0F 5C 33 33")
    else:
        assert told.startswith("1200AA01# 16 70 00 00 ") and floats(told) == pytest.approx(1.0, abs=2e-4)
    assert cycle.loop[0]["tx_stops"][cycle.core["tx_frames"] - 1] == 0


@pytest.mark.parametrize(("drive", "answers"), [(CONTROL, 1), (POSITION, 2)])
def test_a_motor_that_is_led_is_not_asked_as_well(drive, answers):
    cycle = Cycle(drive).stands(0.0)
    cycle.sends(robstride.lead)
    assert cycle.axis["questions"] == answers
    assert cycle.sends(robstride.ask_position) == []
    cycle.core["cycle"] += 1
    assert len(cycle.sends(robstride.ask_position)) == 1


# --- hostile bytes --------------------------------------------------------------------------------------


def untouched(axis):
    return (
        axis["heard"] == 0
        and axis["status_readings"] == 0
        and all(math.isnan(axis[word]) for word in ("told_velocity_rad_s", "effort_nm", "temperature_c", "voltage_v"))
    )


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("028001AA# 8A 2F 7F FF 7F FF 01", EXTENDED),  # too short
        ("028001AA# ", EXTENDED),
        ("028001AA# 8A 2F 7F FF 7F FF 01 31", STANDARD),
        ("028001AA# 8A 2F 7F FF 7F FF 01 31", EXTENDED | REMOTE),
        ("028002AA# 8A 2F 7F FF 7F FF 01 31", EXTENDED),  # another motor
        ("028001AB# 8A 2F 7F FF 7F FF 01 31", EXTENDED),  # another host
        ("068001AA# 8A 2F 7F FF 7F FF 01 31", EXTENDED),  # another type
        ("128001AA# 8A 2F 7F FF 7F FF 01 31", EXTENDED),
        ("017FFF01# 8A 2F 7F FF 0F 5C 33 33", EXTENDED),  # the echo of a set-point
        ("1200AA01# 16 70 00 00 00 00 80 3F", EXTENDED),
        ("1100AA01# 19 70 00 00 00 00 00 00", EXTENDED),
        ("000001AA# 01 02 03 04 05 06 07 08", EXTENDED),  # its unique number
        ("00000100# 36 01 00 01 00 00 6B", EXTENDED),  # a ZDT drive of address 1
        ("110001AA# 19 70 00 00 00 00 C0 7F", EXTENDED),  # a position that is no number
        ("110001AA# 19 70 00 00 00 00 80 7F", EXTENDED),
        ("110001AA# 1C 70 00 00 00 00 C0 FF", EXTENDED),
        ("110001AA# 19 70 00 00 00 00 80", EXTENDED),
        ("110101AA# 19 70 00 00 00 00 80 3F", EXTENDED),  # a parameter that it does not know
        ("110001AA# 16 70 00 00 00 00 80 3F", EXTENDED),
        ("150001AA# 01 00 00 00 00 00 00", EXTENDED),
    ],
)
def test_frames_that_only_resemble_answers(text, kind):
    cycle = Cycle()
    cycle.hears(text, kind)
    assert untouched(cycle.axis)


@relaxed
@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.sampled_from([CONTROL, POSITION]))
def test_any_frame_is_understood_or_left(frame_id, data, drive):
    cycle = Cycle(drive)
    cycle.take(frame_id & ~0xFFFF | 0x01AA, data)
    cycle.take(frame_id, data)
    if cycle.axis["heard"]:
        assert math.isfinite(cycle.axis["heard_rad"])
    for word in ("told_velocity_rad_s", "effort_nm", "temperature_c", "voltage_v"):
        assert not math.isinf(cycle.axis[word])


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
    ],
)
def test_arms_that_are_refused(drives, joint, said):
    with pytest.raises((ConfigError, ValueError), match=said):
        arm_of(*drives, **joint)


def test_a_zdt_drive_with_the_same_number_is_refused_and_another_is_not():
    def joints(address):
        common = {"ratio": 20, "lower_deg": -90, "upper_deg": 90, "motor_rpm": 60, "max_acceleration_rad_s2": 1.0}
        robstride_joint = {**common, "name": "a", "ratio": 1, "drive": {"family": "robstride", **CONTROL}}
        return [robstride_joint, {**common, "name": "b", "drive": {"family": "zdt", "address": address}}]

    arm = {"name": "arm", "control": {"rate_hz": 100}, "bus": {"interface": "slcan", "channel": "/dev/ttyACM0"}}
    assert len(ArmConfig.model_validate({**arm, "joints": joints(2)}).joints) == 2
    with pytest.raises(ValueError, match="CAN identifiers"):
        ArmConfig.model_validate({**arm, "joints": joints(1)})
