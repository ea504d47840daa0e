"""MyActuator frames in the cycle: the vectors of the facts in both directions, numbers against struct, hostile bytes.

(facts) marks vectors of other-drives.md (2b-t/myactuator_rmd and its tests), (V4.2) those of the maker's Motor Motion
Protocol V4.2; all are of motor 1.
"""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.budget import budget
from config.loader import load_arm
from config.schema import ArmConfig
from rtloop import status
from rtloop.beginning import new_loop
from rtloop.drives import myactuator
from rtloop.drives.myactuator_setup import error_words, ramp_dps_s
from rtloop.measured import take_frame
from rtloop.wire.frame_words import EXTENDED, REMOTE, STANDARD
from shm import layout

relaxed = settings(deadline=None)
DRIVE = {"family": "myactuator", "motor_id": 1, "nm_per_ampere": 2.0}


def arm_of(*drives, **joint):
    """Joints that differ only in their drives."""
    usual = {"ratio": 1, "lower_deg": -170, "upper_deg": 170, "motor_rpm": 60, "max_acceleration_rad_s2": 5.0}
    joints = [{"name": f"joint{n}", "drive": drive, **usual, **joint} for n, drive in enumerate(drives, 1)]
    bus = {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 1_000_000}
    return ArmConfig.model_validate({"name": "arm", "control": {"rate_hz": 100}, "bus": bus, "joints": joints})


class Cycle:
    """A loop of one motor, which is told to send and hears frames."""

    def __init__(self, drive=DRIVE, **joint):
        self.arm = arm_of(drive, **joint)
        self.loop = new_loop(self.arm, 0, 0)
        self.shared = np.zeros(1, layout.STATE)
        self.core, self.axis = self.loop[0]["core"], self.loop[0]["axes"][0]
        self.core["cycle"] = self.core["shown_cycle"] = 4

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
        assert self.core["tx_frames"] == 1
        assert (self.loop[0]["tx_kinds"][0], self.loop[0]["tx_sizes"][0]) == (STANDARD, 8)
        data = int(self.loop[0]["tx_data"][0]).to_bytes(8, "little", signed=True)
        return f"{int(self.loop[0]['tx_ids'][0]):03X}# {data.hex(' ').upper()}"

    def take(self, frame_id, data, kind=STANDARD):
        """A frame that comes from the bus."""
        word = int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)
        take_frame(self.loop[0], self.shared[0], frame_id, kind, len(data), word, 1_000_000_000)

    def hears(self, text):
        self.take(0x241, bytes.fromhex(text))
        return self.axis


def read_target(text):
    """(dps, angle in 0.01°) of A4."""
    data = bytes.fromhex(text.partition("# ")[2])
    assert data[:2] == b"\xa4\x00"
    return struct.unpack_from("<Hi", data, 2)


# --- golden frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "text"),
    [(360, "A4 00 F4 01 A0 8C 00 00"), (-360, "A4 00 F4 01 60 73 FF FF")],  # (facts), (V4.2)
)
def test_a_target_of_the_facts(degrees, text):
    data = int(myactuator.target_with_speed(degrees * 100, 500))
    assert (data % 2**64).to_bytes(8, "little") == bytes.fromhex(text)


def test_short_commands():
    cycle = Cycle()
    assert cycle.sends(myactuator.ask_position) == "141# 92 00 00 00 00 00 00 00"
    assert cycle.sends(myactuator.ask_status) == "141# 9A 00 00 00 00 00 00 00"
    cycle.core["cycle"] += 1
    assert cycle.sends(myactuator.ask_status) == "141# 9C 00 00 00 00 00 00 00"
    assert cycle.sends(myactuator.stop) == "141# 81 00 00 00 00 00 00 00"
    assert cycle.loop[0]["tx_stops"][0] == 0


@pytest.mark.parametrize("command", ["A4", "9C"])
def test_feedback_of_the_facts(command):
    """50 °C, 1 A, 500 dps (facts; 9C in V4.2)."""
    axis = Cycle().hears(f"{command} 32 64 00 F4 01 2D 00")
    assert axis["temperature_c"] == 50.0
    assert axis["effort_nm"] == pytest.approx(2.0)
    assert axis["told_velocity_rad_s"] == pytest.approx(math.radians(500))
    assert axis["heard"] == 0  # whole degrees are no position


def test_feedback_backwards():
    """-1 A, -500 dps (V4.2)."""
    axis = Cycle().hears("A4 32 9C FF 0C FE D3 FF")
    assert axis["effort_nm"] == pytest.approx(-2.0)
    assert axis["told_velocity_rad_s"] == pytest.approx(-math.radians(500))


def test_status_of_the_facts():
    """50 °C, brake released, 48.5 V, low voltage (facts)."""
    axis = Cycle().hears("9A 32 00 01 E5 01 04 00")
    assert axis["temperature_c"] == 50.0 and axis["voltage_v"] == pytest.approx(48.5)
    assert axis["status"] == status.ENABLED | status.PROTECTED | status.UNDER_VOLTAGE | status.ANSWERED


def test_an_angle_as_the_maker_tells_it():
    """360° (V4.2)."""
    axis = Cycle().hears("92 00 00 00 A0 8C 00 00")
    assert axis["heard"] == 1 and axis["heard_rad"] == pytest.approx(2 * math.pi)


@pytest.mark.parametrize(
    ("error", "bits"),
    [
        (0x0000, 0),
        (0x0002, status.PROTECTED | status.STALLED),
        (0x0004, status.PROTECTED | status.UNDER_VOLTAGE),
        (0x0008, status.PROTECTED | status.OVER_VOLTAGE),
        (0x0010, status.PROTECTED | status.OVER_CURRENT),
        (0x0040, status.PROTECTED | status.OVER_CURRENT),
        (0x0080, status.PROTECTED),
        (0x0100, status.PROTECTED),
        (0x1000, status.PROTECTED | status.OVER_TEMPERATURE),
        (0x2000, status.PROTECTED | status.ENCODER),
        (0x8000, status.PROTECTED),
        (0x0016, status.PROTECTED | status.STALLED | status.UNDER_VOLTAGE | status.OVER_CURRENT),
    ],
)
def test_errors(error, bits):
    axis = Cycle().hears("9A 32 00 01 E5 01 " + error.to_bytes(2, "little").hex())
    assert axis["status"] == bits | status.ENABLED | status.ANSWERED


def test_errors_in_words():
    assert error_words(0x0016) == "stall, low voltage, over-current"
    assert error_words(0x8002) == "stall, 0x8000"
    assert error_words(0) == "none"


@pytest.mark.parametrize(
    ("frames", "enabled"),
    [
        (["9A 32 00 00 E5 01 00 00"], True),  # a motor without a brake may say so
        (["9A 32 00 01 E5 01 00 00"], True),
        (["9A 32 00 01 E5 01 00 00", "9A 32 00 00 E5 01 00 00"], False),  # its brake was released, and is locked
        (["80 00 00 00 00 00 00 00", "9A 32 00 01 E5 01 00 00"], False),
        (["80 00 00 00 00 00 00 00", "A4 32 64 00 F4 01 2D 00", "9A 32 00 01 E5 01 00 00"], True),
        (["80 00 00 00 00 00 00 00", "9C 32 64 00 F4 01 2D 00", "9A 32 00 01 E5 01 00 00"], False),
    ],
)
def test_whether_it_holds(frames, enabled):
    cycle = Cycle()
    for text in frames:
        axis = cycle.hears(text)
    assert bool(axis["status"] & status.ENABLED) == enabled


# --- numbers --------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(-(2**31), 2**31 - 1), st.sampled_from([1, -1]), st.floats(0.5, 20.0))
def test_any_angle_is_what_struct_says(angle, direction, ratio):
    cycle = Cycle(direction=direction, ratio=ratio, zero_deg=10.0)
    cycle.take(0x241, struct.pack("<Bxxxi", 0x92, angle))
    assert cycle.axis["heard_rad"] == pytest.approx(direction * math.radians(angle / 100) / ratio - math.radians(10))


@relaxed
@given(st.integers(-128, 127), st.integers(-32768, 32767), st.integers(-32768, 32767), st.integers(-32768, 32767))
def test_any_feedback_is_what_struct_says(celsius, current, dps, degrees):
    cycle = Cycle(direction=-1, ratio=3.0)
    cycle.take(0x241, struct.pack("<Bbhhh", 0xA4, celsius, current, dps, degrees))
    assert cycle.axis["temperature_c"] == celsius
    assert cycle.axis["effort_nm"] == pytest.approx(-3.0 * 2.0 * current / 100)
    assert cycle.axis["told_velocity_rad_s"] == pytest.approx(-math.radians(dps) / 3.0)
    assert cycle.axis["heard"] == 0


@relaxed
@given(st.floats(-2.9, 2.9), st.floats(-6.28, 6.28), st.sampled_from([1, -1]), st.floats(0.5, 10.0))
def test_a_target_lies_ahead_but_never_beyond_the_limits(place, speed, direction, ratio):
    cycle = Cycle(direction=direction, ratio=ratio, motor_rpm=60 * ratio).stands(place, speed)
    dps, angle = read_target(cycle.sends(myactuator.lead))
    config, target = cycle.arm.joints[0], direction * math.radians(angle / 100) / ratio
    slack = 3 * config.command_pulse_rad
    assert config.lower_rad - slack <= target <= config.upper_rad + slack
    assert 1 <= dps <= 1.05 * math.degrees(config.max_velocity_rad_s) * ratio + 1
    ahead = target - cycle.axis["next_position_rad"]
    if config.lower_rad < target < config.upper_rad and abs(speed) > 0.05:
        brake = speed * speed / (2 * 1.75 * config.max_acceleration_rad_s2)
        assert ahead * speed > 0 and abs(ahead) >= 0.99 * brake


@relaxed
@given(st.floats(0.02, 6.0))
def test_the_rounding_of_the_speed_is_carried_over(speed):
    """The mean of the whole degrees per second that are sent is the speed that was meant."""
    cycle = Cycle().stands(0.0, speed)
    sent = [read_target(cycle.sends(myactuator.lead))[0] for _ in range(200)]
    assert max(sent) - min(sent) <= 1
    assert np.mean(sent) == pytest.approx(max(math.degrees(speed), 1.0), abs=0.01)


def test_a_joint_that_stands_is_told_where_it_stands():
    assert read_target(Cycle().stands(0.5).sends(myactuator.lead)) == (1, round(math.degrees(0.5) * 100))


def test_a_motor_that_is_led_is_asked_for_its_errors_alone():
    cycle = Cycle().stands(0.0)
    for _ in range(4):
        cycle.core["cycle"] += 1
        cycle.sends(myactuator.lead)
        assert cycle.sends(myactuator.ask_status) == "141# 9A 00 00 00 00 00 00 00"


def test_the_ramp_of_silence_is_that_of_the_arm_file():
    for joint in load_arm("myactuator6").joints:
        factor = math.radians(ramp_dps_s(joint, load_arm("myactuator6"))) / joint.max_acceleration_rad_s2
        assert 1.5 <= factor <= 2.0


def test_what_a_cycle_costs():
    """Two exchanges a motor and one in turn: the angle stands beside the target, whose answer has whole degrees."""
    found = budget(load_arm("myactuator6"))
    assert found.bits_per_cycle == 6 * 4 * 135 + 2 * 135
    assert found.bus_highest_rate_hz == pytest.approx(0.85e6 / 3510)


# --- hostile bytes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame_id", "text", "kind"),
    [
        (0x241, "92 00 00 00 A0 8C 00", STANDARD),
        (0x241, "", STANDARD),
        (0x241, "92 00 00 00 A0 8C 00 00", EXTENDED),
        (0x241, "92 00 00 00 A0 8C 00 00", STANDARD | REMOTE),
        (0x242, "92 00 00 00 A0 8C 00 00", STANDARD),
        (0x141, "92 00 00 00 A0 8C 00 00", STANDARD),
        (0x141, "A4 00 F4 01 A0 8C 00 00", STANDARD),  # the echo of a target
        (0x280, "92 00 00 00 A0 8C 00 00", STANDARD),
        (0x501, "92 00 00 00 A0 8C 00 00", STANDARD),
        (0x241, "60 00 00 00 A0 8C 00 00", STANDARD),
        (0x241, "00 00 00 00 00 00 00 00", STANDARD),
        (0x241, "FF FF FF FF FF FF FF FF", STANDARD),
    ],
)
def test_frames_that_only_resemble_answers(frame_id, text, kind):
    cycle = Cycle()
    cycle.take(frame_id, bytes.fromhex(text), kind)
    assert cycle.axis["heard"] == cycle.axis["status_readings"] == 0
    assert all(
        math.isnan(cycle.axis[word]) for word in ("told_velocity_rad_s", "effort_nm", "temperature_c", "voltage_v")
    )


@relaxed
@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_any_frame_is_understood_or_left(frame_id, data):
    cycle = Cycle()
    for ident in (frame_id, 0x241):
        cycle.take(ident, data)
    for word in ("told_velocity_rad_s", "effort_nm", "temperature_c", "voltage_v"):
        assert not math.isinf(cycle.axis[word])
    assert math.isfinite(cycle.axis["heard_rad"])


def test_without_its_constant_no_effort_is_told():
    assert math.isnan(Cycle({"family": "myactuator", "motor_id": 1}).hears("A4 32 64 00 F4 01 2D 00")["effort_nm"])


# --- what the arm file refuses --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drives", "joint", "said"),
    [
        ((DRIVE, DRIVE), {}, "motor_id 1 is used by joint1 and joint2"),
        ((DRIVE, {"family": "odrive", "node_id": 32}), {}, "CAN identifiers"),  # 401 is motion mode of motor 1
        ((DRIVE,), {"max_acceleration_rad_s2": 0.5}, "nearest limit that has one is 0.8727"),
        ((DRIVE,), {"max_acceleration_rad_s2": 800.0}, "nearest limit that has one is 698.1"),
        ((DRIVE,), {"motor_rpm": 5600}, "at most 5461"),
    ],
)
def test_arms_that_are_refused(drives, joint, said):
    with pytest.raises(ValueError, match=said):
        arm_of(*drives, **joint)


def test_a_gear_behind_the_motor_makes_a_slow_joint_possible():
    assert arm_of(DRIVE, max_acceleration_rad_s2=0.5, ratio=5).joints[0].ratio == 5
