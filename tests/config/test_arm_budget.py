"""The budget: golden values of the facts, what fits, and the sentences with the arithmetic."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.budget import Budget, budget, check_budget, cycle_of, shown_rate
from config.bus import BusConfig
from config.drives.zdt import ZdtDrive
from config.errors import ConfigError
from config.frames import CycleFrames, frame_bits, slcan_chars
from config.loader import load_arm


def zdt_cycle(
    drives: int, acknowledge: bool, *, reported: bool = False, fast_targets: bool = False
) -> tuple[CycleFrames, ...]:
    bus = BusConfig(
        interface="slcan",
        channel="/dev/ttyACM0",
        acknowledge=acknowledge,
        positions="reported" if reported else "polled",
        position_command="FC" if fast_targets else "FD",
    )
    return cycle_of([ZdtDrive(family="zdt", address=number + 1) for number in range(drives)], bus)


def episode1(**changes: dict[str, Any]) -> Budget:
    return budget(load_arm("episode1", overrides=changes))


def test_frame_bits_are_those_of_the_facts() -> None:
    assert [frame_bits(True, n) for n in range(9)] == [80, 90, 100, 110, 120, 130, 140, 150, 160]
    assert [frame_bits(False, n) for n in range(9)] == [55, 65, 75, 85, 95, 105, 115, 125, 135]


def test_slcan_frames_are_as_long_as_the_vectors_of_the_protocol() -> None:
    assert slcan_chars(True, 2) == len("T12ABCDEF2AA55\r")
    assert slcan_chars(False, 3) == len("t4563112233\r")
    assert slcan_chars(True, 8) == 27


@pytest.mark.parametrize("data_bytes", [-1, 9])
def test_a_classic_frame_has_at_most_8_bytes(data_bytes: int) -> None:
    with pytest.raises(ValueError, match="0 to 8"):
        frame_bits(True, data_bytes)
    with pytest.raises(ValueError, match="0 to 8"):
        slcan_chars(True, data_bytes)


@pytest.mark.parametrize(("acknowledge", "bits"), [(True, 3900), (False, 3240)])
def test_a_cycle_of_six_axes_is_that_of_the_facts_plus_one_status(acknowledge: bool, bits: int) -> None:
    frames = zdt_cycle(6, acknowledge)
    without_status = [frame for frame in frames if "status" not in frame.what]
    assert sum(frame.bits for frame in without_status) == bits
    assert sum(frame.bits for frame in frames) == bits + 100 + 110


def test_reported_positions_come_without_requests_and_at_most_once_a_cycle() -> None:
    """FD and one report, 6 · (290 + 150), and one status; in the facts' table FC and a report are 6 · (140 + 150)."""
    frames = zdt_cycle(6, False, reported=True)
    assert [frame.what for frame in frames if "position re" in frame.what] == ["position report"]
    assert sum(frame.bits for frame in frames) == 6 * (290 + 150) + 100 + 110
    found = episode1(bus={"positions": "reported"})
    assert found.bus_load == pytest.approx(2850 * 120 / 500_000)
    assert shown_rate(found.highest_rate_hz) == "149.1"
    assert found.chars_out_per_cycle == 6 * (27 + 21) + 15
    assert found.chars_in_per_cycle == 6 * 25 + 17 + 2 * (6 * 2 + 1)


@pytest.mark.parametrize(
    ("reported", "acknowledge", "bits", "hz_500k", "hz_1m"),
    [
        (False, True, 3000, (167, 133), (333, 267)),
        (False, False, 2340, (214, 171), (427, 342)),
        (True, True, 2400, (208, 167), (417, 333)),
        (True, False, 1740, (287, 230), (575, 460)),
    ],
)
def test_fast_targets_are_those_of_the_facts_plus_one_status(
    reported: bool, acknowledge: bool, bits: int, hz_500k: tuple[int, int], hz_1m: tuple[int, int]
) -> None:
    """The table of the facts, six axes: rates at 100 % and 80 % of 500 kbit/s and of 1 Mbit/s."""
    frames = zdt_cycle(6, acknowledge, reported=reported, fast_targets=True)
    without_status = tuple(frame for frame in frames if "status" not in frame.what)
    assert sum(frame.bits for frame in without_status) == bits
    assert sum(frame.bits for frame in frames) == bits + 100 + 110
    for bitrate, rates in ((500_000, hz_500k), (1_000_000, hz_1m)):
        for share, rate in zip((1.0, 0.8), rates, strict=True):
            found = Budget(without_status, 120.0, bitrate, share, None)
            assert found.highest_rate_hz == pytest.approx(rate, abs=0.51)


def test_fast_targets_on_the_serial_line() -> None:
    found = episode1(bus={"position_command": "FC"})
    assert found.bus_load == pytest.approx(2550 * 120 / 500_000)
    assert found.chars_out_per_cycle == 6 * (23 + 15) + 15
    both = episode1(bus={"position_command": "FC", "positions": "reported"}, control={"rate_hz": 200.0})
    assert both.bus_load == pytest.approx(1950 * 200 / 500_000)
    assert both.fits


def test_a_rate_beyond_the_bus_with_both() -> None:
    changes = {"control": {"rate_hz": 250.0}, "bus": {"position_command": "FC", "positions": "reported"}}
    with pytest.raises(ConfigError) as caught:
        check_budget(load_arm("episode1", overrides=changes))
    assert "1950 bits a cycle × 250 Hz = 487500 bit/s is 97.5% of the 500000 bit/s bus" in caught.value.problem
    assert "the highest rate that fits is 217.9 Hz" in caught.value.problem


@pytest.mark.parametrize(("field", "value"), [("positions", "reported"), ("position_command", "FC")])
def test_mock_drives_have_neither(field: str, value: str) -> None:
    with pytest.raises(ConfigError, match=f"{field} is {value}, but interface mock has no drives that could do that"):
        load_arm("mock", overrides={"bus": {field: value}})


@given(st.floats(10, 2000))
def test_a_cycle_is_shorter_than_the_time_between_two_reports(rate_hz: float) -> None:
    control = load_arm("episode1", overrides={"control": {"rate_hz": rate_hz}}).control
    assert control.period_ns < control.report_period_ms * 1_000_000 <= control.period_ns + 1_000_000
    assert control.report_period_ms <= 0xFFFF


def test_episode1_loads_the_bus_to_83_percent() -> None:
    found = check_budget(load_arm("episode1"))
    assert (found.bits_per_cycle, found.frames_per_cycle) == (3450, 26)
    assert found.bus_load == pytest.approx(0.828)
    assert found.bus_highest_rate_hz == pytest.approx(500_000 * 0.85 / 3450)
    assert found.highest_rate_hz == found.bus_highest_rate_hz


def test_with_acknowledgements_100_hz_is_what_fits() -> None:
    found = episode1(bus={"acknowledge": True})
    assert not found.fits
    assert 100 < found.highest_rate_hz < 104


def test_serial_characters_and_baud() -> None:
    found = episode1()
    assert found.chars_out_per_cycle == 6 * (27 + 21 + 15) + 15
    assert found.chars_in_per_cycle == 6 * 25 + 17 + 2 * (6 * 3 + 1)
    assert found.serial_load == pytest.approx(0.4716)
    assert found.serial_baud_needed == pytest.approx(393 * 10 * 120 / 0.95)


def test_cdc_sets_no_limit() -> None:
    found = episode1(bus={"serial_baud": "cdc"})
    assert found.serial_load is None
    assert found.serial_highest_rate_hz == math.inf


def test_a_can_interface_has_no_serial_line_to_fill() -> None:
    serial, socketcan = (
        load_arm("episode1", overrides={"bus": {"interface": interface}}) for interface in ("slcan", "socketcan")
    )
    assert budget(serial).serial_baud == 1_000_000
    assert budget(socketcan).serial_load is None
    assert budget(socketcan).bus_load == budget(serial).bus_load
    assert budget(socketcan).highest_rate_hz == budget(socketcan).bus_highest_rate_hz


def test_mock_drives_need_no_bus() -> None:
    found = check_budget(load_arm("mock", overrides={"control": {"rate_hz": 2000.0}}))
    assert (found.bits_per_cycle, found.bus_load, found.highest_rate_hz) == (0, 0.0, math.inf)


def test_a_rate_beyond_the_bus() -> None:
    arm = load_arm("episode1", overrides={"control": {"rate_hz": 160.0}})
    with pytest.raises(ConfigError) as caught:
        check_budget(arm)
    assert str(caught.value) == (
        "episode1.yaml: control.rate_hz (overridden): rate_hz is 160, but 3450 bits a cycle × 160 Hz = "
        "552000 bit/s is 110.4% of the 500000 bit/s bus, above its load_limit of 85%; the highest rate that "
        "fits is 123.1 Hz: lower rate_hz to 123.1, or use a faster bus (bus.bitrate, up to 1000000)."
    )


def test_a_rate_beyond_the_bus_because_of_acknowledgements() -> None:
    with pytest.raises(ConfigError) as caught:
        check_budget(load_arm("episode1", overrides={"bus": {"acknowledge": True}}))
    error = caught.value
    assert "the highest rate that fits is 103.4 Hz" in error.problem
    assert "or turn bus.acknowledge off" in error.problem
    assert (error.file, error.line, error.location) == ("episode1.yaml", 12, "control.rate_hz")


def test_a_rate_beyond_the_serial_link() -> None:
    with pytest.raises(ConfigError) as caught:
        check_budget(load_arm("episode1", overrides={"bus": {"serial_baud": 115_200}}))
    assert caught.value.problem == (
        "rate_hz is 120, but 393 characters a cycle × 10 bits × 120 Hz = 471600 bit/s is 409.4% of the "
        "115200 baud serial line, above its limit of 95%; the highest rate that fits is 27.8 Hz: lower "
        "rate_hz to 27.8, or set adapter and bus.serial_baud to 500000."
    )


def test_a_rate_beyond_both_gives_both_sentences_and_one_highest_rate() -> None:
    arm = load_arm("episode1", overrides={"control": {"rate_hz": 200.0}, "bus": {"serial_baud": 115_200}})
    with pytest.raises(ConfigError) as caught:
        check_budget(arm)
    bus, serial = caught.value.errors
    assert "bit/s bus" in bus.problem
    assert "baud serial line" in serial.problem
    for error in (bus, serial):
        assert "the highest rate that fits is 27.8 Hz" in error.problem


def test_a_bus_too_slow_for_any_rate() -> None:
    arm = load_arm("episode1", overrides={"bus": {"bitrate": 10_000}})
    with pytest.raises(ConfigError, match=r"2\.4 Hz, below the lowest allowed 10 Hz: use a faster bus"):
        check_budget(arm)


@given(
    rate_hz=st.floats(10, 2000),
    bitrate=st.sampled_from([125_000, 250_000, 500_000, 1_000_000]),
    baud=st.sampled_from([115_200, 500_000, 1_000_000, 4_000_000, None]),
    drives=st.integers(1, 32),
    acknowledge=st.booleans(),
)
def test_the_highest_rate_fits_and_no_higher_one_does(
    rate_hz: float, bitrate: int, baud: int | None, drives: int, acknowledge: bool
) -> None:
    def at(rate: float) -> Budget:
        return Budget(zdt_cycle(drives, acknowledge), rate, bitrate, 0.85, baud)

    highest = at(rate_hz).highest_rate_hz
    assert at(highest).fits
    assert at(float(shown_rate(highest))).fits
    assert not at(highest * 1.001).fits
    loads = (at(highest).bus_load / 0.85, (at(highest).serial_load or 0.0) / 0.95)
    assert max(loads) == pytest.approx(1.0)
