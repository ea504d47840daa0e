"""Serial adapters in an arm file: their speeds, their bit rates, what they carry, and bytes against the protocols."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from config.budget import budget, check_budget
from config.errors import ConfigError
from config.loader import ARMS_FOLDER, load_arm
from config.serial_adapters import SERIAL_ADAPTERS, at_bytes, seeed_bytes


def on(interface: str, name: str = "episode1", **bus: Any) -> Any:
    return load_arm(name, overrides={"bus": {"interface": interface, "bitrate": 1_000_000, **bus}})


def written(tmp_path: Path, name: str = "episode1", **bus: Any) -> Path:
    """An arm file with these keys in its section bus; None takes one out."""
    values = yaml.safe_load((ARMS_FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))
    values["bus"].update(bus)
    values["bus"] = {key: value for key, value in values["bus"].items() if value is not None}
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(values), encoding="utf-8")
    return file


def test_frames_are_as_long_as_the_vectors_of_the_protocols() -> None:
    assert seeed_bytes(False, 8) == len(bytes.fromhex("AA C8 23 01 11 22 33 44 55 66 77 88 55"))
    assert seeed_bytes(True, 8) == 15
    assert at_bytes(True, 8) == len(bytes.fromhex("41 54 18 07 E8 0C 08 00 00 00 00 00 00 00 00 0D 0A"))
    assert at_bytes(True, 1) == len(bytes.fromhex("41 54 00 07 E8 0C 01 00 0D 0A"))


@pytest.mark.parametrize("frame_bytes", [seeed_bytes, at_bytes])
@pytest.mark.parametrize("data_bytes", [-1, 9])
def test_a_classic_frame_has_at_most_8_bytes(frame_bytes: Any, data_bytes: int) -> None:
    with pytest.raises(ValueError, match="0 to 8"):
        frame_bytes(True, data_bytes)


@pytest.mark.parametrize(("interface", "baud"), [("seeedstudio", 2_000_000), ("ch340-at", 921_600)])
def test_an_adapter_runs_at_its_own_speed_unless_the_file_says_another(
    tmp_path: Path, interface: str, baud: int
) -> None:
    assert on(interface).bus.serial_baud == baud
    assert load_arm(written(tmp_path, interface=interface, bitrate=1_000_000, serial_baud=None)).bus.serial_baud == baud
    assert load_arm(written(tmp_path, interface=interface, bitrate=1_000_000)).bus.serial_baud == 1_000_000
    assert on(interface, serial_baud=460_800).bus.serial_baud == 460_800
    assert on(interface, serial_baud="cdc").bus.serial_baud == "cdc"


def test_another_interface_than_the_files_does_not_take_over_its_speed(tmp_path: Path) -> None:
    file = written(tmp_path, interface="seeedstudio", serial_baud=2_000_000)
    assert load_arm(file, overrides={"bus": {"interface": "slcan"}}).bus.serial_baud == "cdc"
    assert load_arm(file, overrides={"bus": {"interface": "seeedstudio"}}).bus.serial_baud == 2_000_000


@pytest.mark.parametrize("interface", ["seeedstudio", "ch340-at"])
def test_an_index_means_a_usb_serial_port(interface: str) -> None:
    assert on(interface).bus.resolved_channel == "/dev/ttyUSB1"
    with pytest.raises(
        ConfigError, match=rf"interface {interface} needs the adapter's device .* \(such as /dev/ttyUSB0"
    ):
        on(interface, usb_index=None)


@pytest.mark.parametrize(
    ("interface", "bitrate", "sentence"),
    [
        (
            "seeedstudio",
            750_000,
            "a USB-CAN-A adapter offers 5000, 10000, 20000, 50000, 100000, 125000, 200000",
        ),
        ("ch340-at", 500_000, "bitrate is 500000, but an AT adapter offers 1000000; choose the one"),
    ],
)
def test_bit_rates_that_an_adapter_does_not_offer(interface: str, bitrate: int, sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        on(interface, bitrate=bitrate)
    assert sentence in caught.value.problem


@pytest.mark.parametrize("bitrate", SERIAL_ADAPTERS["seeedstudio"].bitrates)
def test_every_bit_rate_that_it_offers(bitrate: int) -> None:
    assert on("seeedstudio", bitrate=bitrate).bus.bitrate == bitrate


@pytest.mark.parametrize(
    ("interface", "out", "back"),
    [("seeedstudio", 6 * (15 + 12 + 9) + 9, 6 * 14 + 10), ("ch340-at", 6 * (17 + 14 + 11) + 11, 6 * 16 + 12)],
)
def test_the_budget_counts_the_bytes_of_the_framing(interface: str, out: int, back: int) -> None:
    found = budget(on(interface))
    assert (found.chars_out_per_cycle, found.chars_in_per_cycle) == (out, back)
    assert found.serial_load == pytest.approx(out * 10 * 120 / SERIAL_ADAPTERS[interface].serial_baud)  # type: ignore[operator]


def test_a_rate_beyond_the_serial_line_is_told_in_its_bytes() -> None:
    arm = on("seeedstudio", serial_baud=115_200)
    with pytest.raises(ConfigError) as caught:
        check_budget(arm)
    assert caught.value.problem == (
        "rate_hz is 120, but 225 bytes a cycle × 10 bits × 120 Hz = 270000 bit/s is 234.4% of the 115200 baud serial "
        "line, above its limit of 95%; the highest rate that fits is 48.6 Hz: lower rate_hz to 48.6, or set adapter "
        "and bus.serial_baud to 460800."
    )


# --- what an adapter carries ----------------------------------------------------------------------------------


def test_an_adapter_for_extended_identifiers_is_refused_where_drives_use_standard_ones() -> None:
    with pytest.raises(ConfigError) as caught:
        on("ch340-at", "odrive6", channel="/dev/ttyUSB0", usb_index=None)
    assert "interface ch340-at is not known to carry standard identifiers, which joint1 (an ODrive axis) uses" in str(
        caught.value
    )
    assert caught.value.location == "bus.interface"


def test_drives_of_one_kind_of_identifiers_suit_a_usb_can_a() -> None:
    assert on("seeedstudio", "odrive6", channel="/dev/ttyUSB0", usb_index=None).bus.interface == "seeedstudio"
    assert on("seeedstudio").bus.interface == "seeedstudio"


def mixed(tmp_path: Path, interface: str) -> Path:
    values = yaml.safe_load((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"))
    values["bus"] = {"interface": interface, "channel": "/dev/ttyUSB0", "bitrate": 1_000_000}
    values["joints"][2]["drive"] = {"family": "odrive", "node_id": 40}
    file = tmp_path / "mixed.yaml"
    file.write_text(yaml.safe_dump(values), encoding="utf-8")
    return file


def test_both_kinds_at_once_are_refused_on_a_usb_can_a_alone(tmp_path: Path) -> None:
    assert load_arm(mixed(tmp_path, "slcan")).bus.interface == "slcan"
    with pytest.raises(ConfigError) as caught:
        load_arm(mixed(tmp_path, "seeedstudio"))
    assert caught.value.problem == (
        "interface seeedstudio delivers either standard or extended identifiers, but joint3 (an ODrive axis) uses "
        "standard ones and joint1 extended ones; reach the arm through another adapter (slcan, or socketcan)."
    )
