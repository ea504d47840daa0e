"""Derived figures: acc bytes of the facts, braking in silence, coast, and what `config check` shows."""

from __future__ import annotations

import io
import math
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from rich.console import Console

from config.check import figures, notes, render_check, render_errors
from config.derived import acc_byte, braking_deceleration_rad_s2, derived_table, silence_acc_byte
from config.errors import ConfigError
from config.loader import ARMS_FOLDER, load_arm
from config.ramp import (
    coast_rad,
    nearest_silence_byte,
    nearest_usable_acceleration_rad_s2,
    ramp_rad_s2,
    ramp_rpm_s,
    smallest_acc_byte,
    stop_time_s,
)
from config.schema import ArmConfig


def test_ramps_of_the_manual() -> None:
    assert ramp_rpm_s(255) == 20_000
    assert ramp_rpm_s(100) == pytest.approx(128, abs=0.3)  # one rpm every 7.8 ms
    for none in (0, 256):
        with pytest.raises(ValueError, match="1 to 255"):
            ramp_rpm_s(none)


def test_the_smallest_acc_bytes_are_those_of_the_facts() -> None:
    assert [acc_byte(joint) for joint in load_arm("episode1").joints] == [215, 152, 215, 215, 204, 152]


@given(ratio=st.floats(0.1, 200), acceleration=st.floats(1e-3, 1e5))
def test_the_smallest_byte_reaches_and_the_one_below_does_not(ratio: float, acceleration: float) -> None:
    byte = smallest_acc_byte(ratio, acceleration)
    if byte is None:
        assert ramp_rad_s2(ratio, 255) < acceleration
        return
    assert ramp_rad_s2(ratio, byte) >= acceleration
    assert byte == 1 or ramp_rad_s2(ratio, byte - 1) < acceleration


def test_silence_brakes_each_joint_between_1_5_and_2_times_its_limit() -> None:
    arm = load_arm("episode1")
    bytes_ = [silence_acc_byte(joint, arm.limits) for joint in arm.joints]
    assert bytes_ == [232, 196, 232, 232, 226, 196]
    for joint, byte in zip(arm.joints, bytes_, strict=True):
        factor = braking_deceleration_rad_s2(joint, byte) / joint.max_acceleration_rad_s2
        assert factor == pytest.approx(1.75, abs=0.03)
        assert byte > acc_byte(joint)


@given(ratio=st.floats(0.1, 200), acceleration=st.floats(1e-2, 1e4), factor=st.floats(1.5, 2.0))
def test_the_silence_byte_is_in_range_and_nearest(ratio: float, acceleration: float, factor: float) -> None:
    factors = {byte: ramp_rad_s2(ratio, byte) / acceleration for byte in range(1, 256)}
    allowed = {byte: reached for byte, reached in factors.items() if 1.5 <= reached <= 2.0}
    byte = nearest_silence_byte(ratio, acceleration, factor)
    if byte is None:
        assert not allowed
    else:
        assert abs(allowed[byte] - factor) == min(abs(reached - factor) for reached in allowed.values())


@given(ratio=st.floats(0.1, 200), acceleration=st.floats(1e-2, 1e4))
def test_the_nearest_usable_limit_is_usable(ratio: float, acceleration: float) -> None:
    usable = nearest_usable_acceleration_rad_s2(ratio, acceleration)
    has_byte = any(1.5 - 1e-9 <= ramp_rad_s2(ratio, byte) / usable <= 2.0 + 1e-9 for byte in range(1, 256))
    assert has_byte
    if nearest_silence_byte(ratio, acceleration, 1.75) is not None:
        assert usable == pytest.approx(acceleration)


@given(velocity=st.floats(-20, 20), deceleration=st.floats(0.1, 100))
def test_coast_is_what_integrating_the_braking_gives(velocity: float, deceleration: float) -> None:
    assume(abs(velocity) > 1e-3)
    duration = stop_time_s(velocity, deceleration)
    steps = 1000
    times = [duration * (step + 0.5) / steps for step in range(steps)]
    way = sum(abs(velocity) - deceleration * t for t in times) * duration / steps
    assert coast_rad(velocity, deceleration) == pytest.approx(way, rel=1e-6)


def test_the_derived_table_of_episode1() -> None:
    rows = derived_table(load_arm("episode1"))
    assert [row.name for row in rows] == [f"joint{number}" for number in range(1, 7)]
    assert [row.acc_byte for row in rows] == [215, 152, 215, 215, 204, 152]
    pulses = [0.0045, 0.005625, 0.0045, 0.01125, 0.028125, 0.1125]
    assert [row.command_pulse_deg for row in rows] == pytest.approx(pulses)
    assert [row.max_velocity_deg_s for row in rows] == pytest.approx([24, 18, 48, 120, 300, 600])
    coasts = [row.silence.coast_deg for row in rows if row.silence is not None]
    assert coasts == pytest.approx([1.84, 1.92, 6.56, 16.4, 50.0, 100.0], rel=1e-6)
    for row in rows:
        assert row.encoder_count_deg == pytest.approx(row.command_pulse_deg / 20.48)
        assert math.degrees(row.upper_rad) == pytest.approx(row.upper_deg)


def test_mock_drives_have_no_ramp() -> None:
    assert all(row.acc_byte is None and row.silence is None for row in derived_table(load_arm("mock")))


def printed(arm: ArmConfig) -> str:
    out = io.StringIO()
    Console(file=out, width=80).print(render_check(arm))
    return out.getvalue()


def test_check_fits_80_columns_and_holds_the_figures() -> None:
    text = printed(load_arm("episode1"))
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    assert "\x1b" not in text
    for figure in (
        "260759.46",
        "82.8% of 500000 bit/s, limit 85%",
        "123.1 Hz",
        "47.2% of 1000000 baud",
        "100.00",
    ):
        assert figure in text


def test_check_still_shows_an_arm_that_does_not_fit() -> None:
    text = printed(load_arm("episode1", overrides={"control": {"rate_hz": 160.0}}))
    assert "110.4% of 500000 bit/s, limit 85%: TOO MUCH" in text


def test_check_of_mock_and_of_a_slow_cycle() -> None:
    text = printed(load_arm("mock", overrides={"control": {"rate_hz": 20.0}}))
    assert "no limit on the rate" in text
    assert "MoveIt asks for 50 or more" in text


LONG = "the_turntable_at_the_very_bottom_of_the_whole_arm"


def test_names_are_folded_rather_than_cut(tmp_path: Path) -> None:
    text = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8").replace("joint1", LONG)
    file = tmp_path / "arm.yaml"
    file.write_text(text, encoding="utf-8")
    shown = printed(load_arm(file))
    first_column = "".join(
        line.split()[0] for line in shown.partition("Resolution")[0].splitlines()[3:] if line.split()
    )
    assert "…" not in shown and LONG in first_column and max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize(
    ("lower_deg", "upper_deg", "shown"),
    [(-1.57, 1.57, "3.14"), (0.0, 6.28, "6.28"), (-3.14, 2.44, "5.58"), (-7.0, 1.0, None), (-1.57, 90.0, None)],
)
def test_limits_that_look_like_radians_are_told(lower_deg: float, upper_deg: float, shown: str | None) -> None:
    arm = with_joint1(load_arm("damiao6"), lower_deg=lower_deg, upper_deg=upper_deg)
    told = [] if shown is None else [f"joint1's range is {shown}°: limits are in degrees; did you give radians?"]
    assert notes(arm) == figures(arm)["notes"] == told
    assert all(note in " ".join(printed(arm).split()) for note in told)


@pytest.mark.parametrize(
    ("name", "changes", "why"),
    [
        ("damiao6", {}, None),
        ("damiao6", {"ratio": 1.5}, "joint1 (its range is 1.33 motor turns, of which its encoder sees one)."),
        ("odrive6", {}, None),
        ("odrive6", {"drive": {"family": "odrive", "node_id": 1}}, "joint1 (no absolute encoder)."),
        ("mks6", {}, "joint1 (no absolute encoder), joint2 (no absolute encoder), "),
        ("episode1", {}, None),
        ("mock", {}, None),
    ],
)
def test_joints_that_need_a_reference_after_each_start_are_told(name: str, changes: dict, why: str | None) -> None:
    told = notes(with_joint1(load_arm(name), **changes))
    if why is None:
        assert not told
    else:
        (note,) = told
        assert note.startswith("After each start a reference is needed (`rtarm reference`, or ") and why in note


def with_joint1(arm: ArmConfig, **changes: object) -> ArmConfig:
    values = arm.model_dump()
    values["joints"][0].update(changes)
    return ArmConfig.model_validate(values)


def test_errors_are_one_a_line() -> None:
    with pytest.raises(ConfigError) as caught:
        load_arm("episode1", overrides={"control": {"rate_hz": 1.0, "init_mode": 7}})
    out = io.StringIO()
    Console(file=out, width=300).print(render_errors(caught.value))
    assert [line.split(":")[1].strip() for line in out.getvalue().splitlines()] == [
        "control.rate_hz (overridden)",
        "control.init_mode (overridden)",
    ]


def test_config_check_shows_what_is_wanted_of_drives(tmp_path):
    shown = _checked(tmp_path, "current_ma: 2500, stall_protection: false, watchdog_ms: 1000")
    assert ["joint3", "2500", "off", "-", "-", "-", "1000"] in [line.split() for line in shown.splitlines()]
    assert "Drives" not in _checked(tmp_path, "firmware: auto")


def _checked(folder, wanted):
    text = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8")
    path = folder / "arm.yaml"
    path.write_text(text.replace("address: 3,", f"address: 3, {wanted},"), encoding="utf-8")
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render_check(load_arm(path)))
    return console.export_text()
