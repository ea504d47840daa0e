"""Overrides from the command line: `--set section.key=value`."""

from __future__ import annotations

import pytest

from config.errors import ConfigError
from config.loader import load_arm, parse_overrides


def test_overrides_are_typed_as_yaml_types_them() -> None:
    assert parse_overrides(
        [
            "bus.channel=/dev/pts/3",
            "control.rate_hz=100",
            "bus.acknowledge=true",
            "bus.usb_index=null",
            "name=a=b",
        ]
    ) == {
        "bus": {"channel": "/dev/pts/3", "acknowledge": True, "usb_index": None},
        "control": {"rate_hz": 100},
        "name": "a=b",
    }


def test_nothing_overridden_is_nothing() -> None:
    assert parse_overrides([]) == {}


def test_the_last_value_of_a_field_counts() -> None:
    assert parse_overrides(["control.rate_hz=100", "control.rate_hz=90"]) == {"control": {"rate_hz": 90}}


def test_they_reach_the_arm() -> None:
    arm = load_arm("episode1", overrides=parse_overrides(["bus.channel=/dev/pts/3", "control.rate_hz=100"]))
    assert (arm.bus.resolved_channel, arm.control.rate_hz) == ("/dev/pts/3", 100)


@pytest.mark.parametrize(
    "assignment",
    ["rate_hz", "=5", "control.=5", "control rate=5", "joints[0].ratio=5", ".=", "control.rate_hz:5"],
)
def test_what_names_no_field_is_refused(assignment: str) -> None:
    with pytest.raises(ConfigError, match=r"names no field of a section; write it as section\.key=value"):
        parse_overrides([assignment])


def test_a_value_that_is_not_yaml_is_refused() -> None:
    with pytest.raises(ConfigError, match="has a value that is not valid YAML"):
        parse_overrides(["bus.channel=[1"])


def test_a_field_inside_a_value_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"names a field inside control"):
        parse_overrides(["control=5", "control.rate_hz=100"])


def test_an_unknown_field_is_refused_by_the_schema_as_overridden() -> None:
    with pytest.raises(ConfigError, match=r"control\.rate \(overridden\): rate is not a field") as caught:
        load_arm("episode1", overrides=parse_overrides(["control.rate=5"]))
    assert caught.value.overridden
