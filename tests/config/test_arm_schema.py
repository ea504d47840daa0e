"""The schema: golden figures of the Episode1 arm, units that agree with each other, frozen models."""

from __future__ import annotations

import math
import termios
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from config.bus import SERIAL_BAUDS, BusConfig
from config.drives.mock import MockDrive
from config.drives.zdt import ZdtDrive
from config.errors import ConfigError
from config.geometry import DhRow, KinematicsConfig
from config.joint import JointConfig
from config.loader import load_arm
from config.schema import ArmConfig
from config.sections import ControlConfig, FrontConfig, LimitsConfig, RealtimeConfig, TrajectoryConfig

# Facts of the Episode1 arm: joint, ratio, zero, lower, upper, motor rpm, velocity, acceleration, pulse.
EPISODE1 = [
    ("joint1", 25, 180, -180, 140, 100, 0.4188790205, 2.0, 0.0045),
    ("joint2", 20, 90, -90, 90, 60, 0.3141592654, 1.0, 0.005625),
    ("joint3", 25, 83, -83, 80, 200, 0.837758, 2.0, 0.0045),
    ("joint4", 10, 30, -30, 270, 200, 2.094395, 5.0, 0.01125),
    ("joint5", 4, 110, -110, 110, 200, 5.235988, 10.0, 0.028125),
    ("joint6", 1, 30, -30, 290, 100, 10.471976, 20.0, 0.1125),
]

SECTIONS: list[type[BaseModel]] = [
    ArmConfig, BusConfig, ControlConfig, DhRow, FrontConfig, JointConfig, KinematicsConfig, LimitsConfig, MockDrive,
    RealtimeConfig, TrajectoryConfig, ZdtDrive,
]  # fmt: skip


@pytest.mark.parametrize("arm_name", ["episode1", "mock"])
def test_the_arm_files_hold_the_facts_of_the_arm(arm_name: str) -> None:
    for joint, facts in zip(load_arm(arm_name).joints, EPISODE1, strict=True):
        name, ratio, zero, lower, upper, rpm, velocity, acceleration, _ = facts
        assert (joint.name, joint.ratio, joint.zero_deg) == (name, ratio, zero)
        assert (joint.lower_deg, joint.upper_deg, joint.motor_rpm) == (lower, upper, rpm)
        assert joint.max_velocity_rad_s == pytest.approx(velocity, abs=1e-6)
        assert joint.max_acceleration_rad_s2 == acceleration


def test_episode1_is_six_zdt_drives_on_slcan() -> None:
    arm = load_arm("episode1")
    assert [joint.drive.model_dump(exclude_none=True) for joint in arm.joints] == [
        {"family": "zdt", "address": address, "microsteps": 16, "firmware": "auto"} for address in range(1, 7)
    ]
    assert (arm.bus.interface, arm.bus.resolved_channel, arm.bus.bitrate) == (
        "slcan",
        "/dev/ttyUSB1",
        500_000,
    )
    assert (arm.control.rate_hz, arm.control.period_ns, arm.control.init_mode) == (120.0, 8_333_333, 1)
    assert (arm.bus.serial_baud, arm.bus.acknowledge) == (1_000_000, False)
    assert (arm.front.controller_name, arm.front.frame_id) == ("episode_arm_controller", "base_link")


def test_episode1_on_a_can_interface_of_the_system() -> None:
    """Naming the interface is enough: the serial line's speed in the file means nothing then."""
    arm = load_arm("episode1", overrides={"bus": {"interface": "socketcan"}})
    assert (arm.bus.interface, arm.bus.resolved_channel, arm.bus.serial_baud) == ("socketcan", "can1", "cdc")
    arm = load_arm("episode1", overrides={"bus": {"interface": "socketcan", "channel": "vcan0"}})
    assert (arm.bus.resolved_channel, arm.bus.usb_index) == ("vcan0", None)


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        ({}, "interface socketcan needs the name of the CAN interface"),
        ({"channel": "/dev/ttyUSB0"}, "has a name of 1 to 15 characters without /"),
        ({"channel": "a-name-too-long-0"}, "has a name of 1 to 15 characters"),
        ({"channel": "can 0"}, "has a name of 1 to 15 characters"),
        ({"channel": ".."}, "has a name of 1 to 15 characters"),
        ({"channel": "can0", "serial_baud": 1_000_000}, "interface socketcan has no serial line"),
        ({"channel": "can0", "usb_index": 0}, r"usb_index 0 \(can0\) and channel can0 both"),
        ({"channel": "can0", "bitrate": 2_000_000}, "classic CAN has 10000 to 1000000 bit/s"),
    ],
)
def test_what_no_can_interface_can_be_is_refused(bus: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        BusConfig(interface="socketcan", **bus)


def test_a_can_interface_offers_rates_that_serial_adapters_disagree_about() -> None:
    assert BusConfig(interface="socketcan", channel="can0", bitrate=800_000).bitrate == 800_000


@pytest.mark.parametrize(
    "overrides_of", [lambda move: {"homing": {"then": move}}, lambda move: {"parking": move}], ids=["homing", "parking"]
)
@pytest.mark.parametrize(
    ("move", "said"),
    [
        ({"joints_deg": [0.0] * 5}, r"joints_deg has 5 angles, but the arm has 6 joints; give one a joint"),
        ({"joints_deg": [0.0, 90.1, 0.0, 0.0, 0.0, 0.0]}, r"joints_deg\[1\] is 90.1, but joint2 goes from -90 to 90"),
        ({"joints_deg": [0.0] * 6, "speed_ratio": 0.0}, r"speed_ratio is 0"),
        ({"joints_deg": [0.0] * 6, "speed_ratio": 1.1}, r"speed_ratio is 1.1"),
    ],
)
def test_a_pose_that_the_arm_cannot_take_is_refused(overrides_of, move, said) -> None:
    with pytest.raises(ConfigError, match=said):
        load_arm("episode1", overrides=overrides_of(move))


def test_mock_runs_at_100_hz_without_a_bus() -> None:
    arm = load_arm("mock")
    assert (arm.control.rate_hz, arm.bus.interface, arm.bus.resolved_channel) == (100.0, "mock", "mock")
    assert {joint.drive.family for joint in arm.joints} == {"mock"}


def test_a_command_pulse_is_the_angle_of_the_facts() -> None:
    for joint, facts in zip(load_arm("episode1").joints, EPISODE1, strict=True):
        assert math.degrees(joint.command_pulse_rad) == pytest.approx(facts[-1], rel=1e-12)


def test_a_pulse_is_20_48_counts() -> None:
    for joint in load_arm("episode1").joints:
        assert joint.encoder_counts_per_rad / joint.command_pulses_per_rad == pytest.approx(20.48, rel=1e-12)


def test_the_zero_pose_is_the_motor_turns_of_the_facts() -> None:
    turns = [math.degrees(joint.zero_rad) * joint.ratio / 360 for joint in load_arm("episode1").joints]
    assert turns == pytest.approx([12.5, 5, 5.764, 0.833, 1.222, 0.083], abs=5e-4)


@st.composite
def joints(draw: st.DrawFn) -> JointConfig:
    lower = draw(st.floats(-3600, 3599))
    return JointConfig(
        name="joint",
        drive=ZdtDrive(family="zdt", address=1, microsteps=draw(st.integers(1, 256))),
        ratio=draw(st.floats(0.01, 1000)),
        direction=draw(st.sampled_from([1, -1])),
        zero_deg=draw(st.floats(-3600, 3600)),
        lower_deg=lower,
        upper_deg=draw(st.floats(lower + 1e-3, 3600)),
        motor_rpm=draw(st.floats(0.1, 3000)),
        max_acceleration_rad_s2=1.0,
    )


@given(joint=joints(), angle_rad=st.floats(-100, 100))
def test_units_round_trip(joint: JointConfig, angle_rad: float) -> None:
    pulses = angle_rad * joint.command_pulses_per_rad
    assert pulses * joint.command_pulse_rad == pytest.approx(angle_rad, rel=1e-12, abs=1e-12)
    counts = angle_rad * joint.encoder_counts_per_rad
    assert counts * joint.encoder_count_rad == pytest.approx(angle_rad, rel=1e-12, abs=1e-12)
    motor_turns = pulses / (200 * joint.drive.model_dump()["microsteps"])
    assert motor_turns * 2 * math.pi / joint.ratio == pytest.approx(angle_rad, rel=1e-12, abs=1e-12)
    assert math.degrees(joint.lower_rad) == pytest.approx(joint.lower_deg, rel=1e-12, abs=1e-12)
    assert joint.lower_rad < joint.upper_rad


@given(joint=joints())
def test_a_minute_at_full_speed_is_rpm_turns_of_the_motor(joint: JointConfig) -> None:
    pulses = joint.max_velocity_rad_s * 60 * joint.command_pulses_per_rad
    microsteps = joint.drive.model_dump()["microsteps"]
    assert pulses == pytest.approx(joint.motor_rpm * 200 * microsteps, rel=1e-12)


@given(rate_hz=st.floats(10, 2000))
def test_the_period_is_the_rate_in_whole_nanoseconds(rate_hz: float) -> None:
    assert abs(ControlConfig(rate_hz=rate_hz).period_ns - 1e9 / rate_hz) <= 0.5


@pytest.mark.parametrize(("joint_states_hz", "every"), [(None, 1), (120.0, 1), (60.0, 2)])
def test_joint_states_follow_every_nth_cycle(joint_states_hz: float | None, every: int) -> None:
    arm = load_arm("episode1", overrides={"front": {"joint_states_hz": joint_states_hz}})
    assert arm.joint_states_every_cycles == every


def test_an_arm_cannot_be_changed() -> None:
    arm = load_arm("mock")
    with pytest.raises(ValidationError, match="frozen"):
        arm.control.rate_hz = 10.0


def test_every_field_says_what_it_means_and_numbers_say_their_unit() -> None:
    for model in SECTIONS:
        assert model.__doc__
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}"
    units = {
        "_hz": "(Hz)",
        "_mm": "(mm)",
        "_rad": "(rad)",
        "_deg": "(degrees",
        "_s": "(s)",
        "_rpm": "(rpm)",
        "_ma": "(mA)",
        "_ms": "(ms)",
        "_rad_s2": "(rad/s²)",
    }
    for model in SECTIONS:
        for name, field in model.model_fields.items():
            ending = next((unit for unit in sorted(units, key=len, reverse=True) if name.endswith(unit)), None)
            if ending is None or name.endswith("_rad_s"):
                continue
            assert units[ending] in str(field.description), f"{model.__name__}.{name}"


def test_serial_speeds_are_those_the_kernel_names() -> None:
    assert all(hasattr(termios, f"B{baud}") for baud in SERIAL_BAUDS)


def test_models_built_in_memory_need_no_file() -> None:
    values: dict[str, Any] = load_arm("episode1").model_dump()
    arm = ArmConfig.model_validate(values)
    assert arm.source is None
    assert arm.model_dump() == values
