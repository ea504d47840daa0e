"""Arms of several buses: what an arm file may say of them, overrides, and what each bus carries."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from two_buses import NAMES, divided, divided_values, write_divided

from config.budget import budget, budgets, check_budget
from config.buses import ALIKE, MOST_BUSES, places
from config.check import figures, render_check
from config.errors import ConfigError
from config.loader import arm_hash, bus_names, load_arm, parse_overrides
from config.schema import ArmConfig

Values = dict[str, Any]
SERVO = {"hook": "servo", "joint": "fingers", "servo": {"bus": "wrist", "address": 7}}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_divided("episode1", tmp_path / "arm.yaml")


def overridden(file: Path, *assignments: str) -> ArmConfig:
    return load_arm(file, overrides=parse_overrides(assignments))


# --- what is refused ---


def count(number: int) -> Callable[[Values], None]:
    def change(values: Values) -> None:
        first = values["bus"][0]
        values["bus"] = [{**first, "name": f"b{index}", "channel": f"/dev/b{index}"} for index in range(number)]

    return change


def of_second(**fields: Any) -> Callable[[Values], None]:
    def change(values: Values) -> None:
        bus = values["bus"][1] | fields
        values["bus"][1] = {key: value for key, value in bus.items() if value is not None}

    return change


def of_joint(index: int, **fields: Any) -> Callable[[Values], None]:
    def change(values: Values) -> None:
        joint = values["joints"][index] | fields
        values["joints"][index] = {key: value for key, value in joint.items() if value is not None}

    return change


def with_servo(**fields: Any) -> Callable[[Values], None]:
    def change(values: Values) -> None:
        servo = SERVO["servo"] | fields
        values["gripper"] = SERVO | {"servo": {key: value for key, value in servo.items() if value is not None}}

    return change


def mock(values: Values) -> None:
    values["bus"] = [{"name": name, "interface": "mock"} for name in NAMES]


def of_numbers(values: Values) -> None:
    values["bus"][0]["channel"] = "/dev/ttyUSB3"
    values["bus"][1] = {key: value for key, value in values["bus"][1].items() if key != "channel"} | {"usb_index": 3}


def all_on_one(values: Values) -> None:
    for joint, address in zip(values["joints"], range(1, 7), strict=True):
        joint["bus"] = "wrist"
        joint["drive"]["address"] = address


def nameless(values: Values) -> None:
    all_on_one(values)
    values["bus"] = values["bus"][0]
    del values["bus"]["name"]


@pytest.mark.parametrize(
    ("change", "location", "line", "sentence"),
    [
        (count(0), "bus", "bus: []", "bus has 0 entries, but an arm has 1 to 4 buses; correct the list."),
        (count(5), "bus", "bus:", "bus has 5 entries, but an arm has 1 to 4 buses; correct the list."),
        (
            of_second(name=None),
            "bus[1]",
            "- interface: slcan",
            "the 2nd bus has no name, by which joints could say that their drive is on it; add name.",
        ),
        (
            of_second(name="bitrate"),
            "bus[1].name",
            "name: bitrate",
            "name bitrate is that of a field of a bus, so that options could mean either; choose another name.",
        ),
        (
            mock,
            "bus[0].interface",
            "interface: mock",
            "interface is mock, which is no bus at all; leave one bus, without a list.",
        ),
        (
            of_second(name="shoulder"),
            "bus[1].name",
            "name: shoulder",
            "name shoulder is given to two buses; each needs a name of its own: rename one.",
        ),
        (
            of_second(interface="socketcan", serial_baud=None, channel="can0"),
            "bus[1].interface",
            "- interface: socketcan",
            "interface is socketcan, but bus shoulder has slcan, and all buses of an arm must agree on it; make them "
            "alike.",
        ),
        (
            of_second(positions="reported"),
            "bus[1].positions",
            "positions: reported",
            "positions is reported, but bus shoulder has polled, and all buses of an arm must agree on it; make them "
            "alike.",
        ),
        (
            of_second(position_command="FC"),
            "bus[1].position_command",
            "position_command: FC",
            "position_command is FC, but bus shoulder has FD, and all buses of an arm must agree on it; make them "
            "alike.",
        ),
        (
            of_second(acknowledge=True),
            "bus[1].acknowledge",
            "acknowledge: true",
            "acknowledge is true, but bus shoulder has false, and all buses of an arm must agree on it; make them "
            "alike.",
        ),
        (
            of_second(channel="/dev/ttyshoulder"),
            "bus[1].channel",
            "channel: /dev/ttyshoulder",
            "/dev/ttyshoulder is the adapter of bus shoulder and of bus wrist; each bus needs an adapter of its own: "
            "correct one.",
        ),
        (
            of_numbers,
            "bus[1].usb_index",
            "usb_index: 3",
            "/dev/ttyUSB3 is the adapter of bus shoulder and of bus wrist; each bus needs an adapter of its own: "
            "correct one.",
        ),
        (
            of_joint(4, bus=None),
            "joints[4].bus",
            "- name: joint5",
            "the arm has 2 buses, and nothing says on which the drive of joint5 is; add bus, one of shoulder, wrist.",
        ),
        (
            of_joint(4, bus="wirst"),
            "joints[4].bus",
            "bus: wirst",
            "bus of joint5 is wirst, which is no bus of the arm (did you mean wrist?); its buses are shoulder, wrist; "
            "name one of them.",
        ),
        (
            with_servo(bus=None),
            "gripper.servo.bus",
            "servo:",
            "the arm has 2 buses, and nothing says on which the gripper's drive is; add bus, one of shoulder, wrist.",
        ),
        (
            with_servo(bus="hand"),
            "gripper.servo.bus",
            "bus: hand",
            "bus is hand, which is no bus of the arm; its buses are shoulder, wrist; name one of them.",
        ),
        (
            with_servo(address=2),
            "gripper.servo.address",
            "address: 2",
            "address 2 is used by joint5 and the gripper; every drive on the bus needs an address of its own: change "
            "one, in its menu and here.",
        ),
        (
            all_on_one,
            "bus[0]",
            "- interface: slcan",
            "no joint is on bus shoulder; remove it, or let joints name it as their bus.",
        ),
        (
            nameless,
            "joints[0].bus",
            "bus: wrist",
            "bus of joint1 is wrist, which is no bus of the arm; its bus has no name; remove bus.",
        ),
        (
            of_joint(4, drive={"family": "zdt", "address": 1}),
            "joints[4].drive.address",
            "address: 1",
            "address 1 is used by joint4 and joint5; every drive on the bus needs an address of its own: change one, "
            "in its menu and here.",
        ),
        (
            of_second(name="left wrist"),
            "bus[1].name",
            "name: left wrist",
            "name of the 2nd bus is the text 'left wrist', which is not allowed",
        ),
    ],
)
def test_what_does_not_go_together_is_one_sentence_at_its_line(
    change: Callable[[Values], None], location: str, line: str, sentence: str, tmp_path: Path
) -> None:
    values = divided_values("episode1")
    change(values)
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_arm(file)
    error = caught.value
    assert error.problem.startswith(sentence)
    assert error.location == location
    assert error.line is not None
    assert file.read_text(encoding="utf-8").splitlines()[error.line - 1].strip() == line


def test_they_agree_on_what_the_whole_arm_rests_on() -> None:
    assert {"interface", "positions", "position_command", "acknowledge"} == set(ALIKE)


def test_a_gripper_s_drive_may_have_the_address_of_a_joint_on_another_bus() -> None:
    values = divided_values("episode1") | {"gripper": SERVO}
    values["joints"][1]["drive"]["address"] = 7
    arm = ArmConfig.model_validate(values)
    assert [part.gripper is not None for part in arm.parts] == [False, True]


# --- overrides ---


def test_an_override_is_for_each_bus_or_for_one(file: Path) -> None:
    assert bus_names(file) == list(NAMES)
    arm = overridden(file, "bus.bitrate=1000000", "bus.wrist.channel=/dev/x", "bus.wrist.load_limit=0.5")
    assert [(bus.bitrate, bus.channel, bus.load_limit) for bus in arm.buses] == [
        (1_000_000, "/dev/ttyshoulder", 0.85),
        (1_000_000, "/dev/x", 0.5),
    ]
    arm = overridden(file, "bus.bitrate=250000", "bus.wrist.bitrate=1000000")
    assert [bus.bitrate for bus in arm.buses] == [250_000, 1_000_000]


def test_an_adapter_s_number_takes_the_place_of_its_channel_on_its_bus(file: Path) -> None:
    arm = overridden(file, "bus.wrist.usb_index=2")
    assert [bus.resolved_channel for bus in arm.buses] == ["/dev/ttyshoulder", "/dev/ttyUSB2"]


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        (
            "bus.channel=/dev/x",
            "bus.channel=/dev/x is for every bus, but each of the arm's buses (shoulder, wrist) has an adapter of its "
            "own; write it in the arm file, or name the bus where --set is an option, as in `--set "
            "bus.shoulder.channel=/dev/x`.",
        ),
        (
            "bus.usb_index=1",
            "bus.usb_index=1 is for every bus, but each of the arm's buses (shoulder, wrist) has an adapter of its "
            "own; write it in the arm file, or name the bus where --set is an option, as in `--set "
            "bus.shoulder.usb_index=1`.",
        ),
        (
            "bus.wrist=can0",
            "the override bus.wrist=can0 gives a bus a value; name a field of it, such as bus.wrist.channel=can0.",
        ),
        (
            "bus.wirst.channel=can0",
            "the override bus.wirst names no bus of the arm (did you mean wrist?); its buses are shoulder, wrist.",
        ),
    ],
)
def test_an_override_that_cannot_be_meant_is_a_sentence(file: Path, assignment: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        overridden(file, assignment)
    assert caught.value.problem == sentence


@pytest.mark.parametrize(
    ("assignment", "locations"),
    [("bus.bitrate=0", ["bus[0].bitrate", "bus[1].bitrate"]), ("bus.wrist.bitrate=0", ["bus[1].bitrate"])],
)
def test_a_bad_override_is_told_of_each_bus_that_it_is_for(file: Path, assignment: str, locations: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        overridden(file, assignment)
    assert [(error.location, error.line, error.overridden) for error in caught.value.errors] == [
        (location, None, True) for location in locations
    ]


def test_one_bus_in_a_list_is_one_bus(tmp_path: Path) -> None:
    values = load_arm("episode1").model_dump(mode="json", exclude_unset=True)
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(values | {"bus": [values["bus"]]}), encoding="utf-8")
    assert load_arm(file).model_dump() == load_arm("episode1").model_dump()
    assert arm_hash(load_arm(file)) == arm_hash(load_arm("episode1"))
    assert bus_names(file) == bus_names("episode1") == []
    assert overridden(file, "bus.channel=/dev/x").bus.resolved_channel == "/dev/x"


def test_each_bus_counts_in_the_arm_s_number(file: Path) -> None:
    numbers = {
        arm_hash(overridden(file, *assignments))
        for assignments in ([], ["bus.wrist.channel=/dev/x"], ["bus.shoulder.channel=/dev/x"], ["bus.bitrate=250000"])
    }
    assert len(numbers) == 4


# --- the arm bus by bus ---


@st.composite
def divisions(draw: st.DrawFn) -> list[int]:
    """The bus of each of six joints; every bus has one."""
    number = draw(st.integers(2, MOST_BUSES))
    rest = draw(st.lists(st.integers(0, number - 1), min_size=6 - number, max_size=6 - number))
    return draw(st.permutations([*range(number), *rest]))


def of_division(division: list[int]) -> ArmConfig:
    """The arm with each joint on the bus of its number; on each bus the drives are numbered from 1."""
    values = load_arm("episode1").model_dump(mode="json", exclude_unset=True)
    bus = {key: value for key, value in values["bus"].items() if key != "usb_index"}
    values["bus"] = [{**bus, "name": f"b{number}", "channel": f"/dev/b{number}"} for number in range(1 + max(division))]
    for index, (joint, number) in enumerate(zip(values["joints"], division, strict=True)):
        joint["bus"] = f"b{number}"
        joint["drive"]["address"] = 1 + division[:index].count(number)
    return ArmConfig.model_validate(values)


@given(divisions())
def test_parts_have_every_joint_once_in_the_arm_s_order(division: list[int]) -> None:
    arm = of_division(division)
    assert [arm.bus_number(joint) for joint in arm.joints] == division
    assert [part.bus for part in arm.parts] == arm.buses
    for index, joint in enumerate(arm.joints):
        part, place = arm.part_of(index)
        assert part == arm.parts[division[index]]
        assert part.joints[place] == joint
        assert part.bus == arm.bus_of(joint)
    assert sum(len(part.joints) for part in arm.parts) == len(arm.joints)
    for part in arm.parts:
        assert [joint for joint in arm.joints if joint in part.joints] == part.joints


@given(divisions(), st.booleans())
def test_what_is_written_is_read_as_it_was(division: list[int], exclude_unset: bool) -> None:
    arm = of_division(division)
    again = ArmConfig.model_validate(arm.model_dump(mode="json", exclude_unset=exclude_unset))
    assert again == arm
    assert arm_hash(again) == arm_hash(arm)


def test_settings_of_every_bus_change_together() -> None:
    arm = divided("episode1").on_every_bus(acknowledge=True)
    assert [bus.acknowledge for bus in arm.buses] == [True, True]
    assert [bus.name for bus in arm.buses] == list(NAMES)


# --- what each bus carries ---


@given(divisions(), st.floats(10, 2000))
def test_a_rate_fits_where_every_bus_carries_it(division: list[int], rate_hz: float) -> None:
    arm = of_division(division)
    arm = arm.model_copy(update={"control": arm.control.model_copy(update={"rate_hz": rate_hz})})
    found = budgets(arm)
    assert [load.frames_per_cycle for load in found] == [4 * division.count(number) + 2 for number in range(len(found))]
    assert budget(arm).highest_rate_hz == min(load.highest_rate_hz for load in found)
    assert budget(arm).fits == all(load.fits for load in found)
    if budget(arm).fits:
        assert check_budget(arm) == budget(arm)
        return
    with pytest.raises(ConfigError) as caught:
        check_budget(arm)
    said = "\n".join(error.problem for error in caught.value.errors)
    for bus, load in zip(arm.buses, found, strict=True):
        assert (f"on bus {bus.name}, " in said) == (not load.fits)


def test_several_buses_carry_a_rate_that_one_does_not(file: Path) -> None:
    assert check_budget(overridden(file, "control.rate_hz=200")).fits
    with pytest.raises(ConfigError):
        check_budget(load_arm("episode1", overrides={"control": {"rate_hz": 200.0}}))


def test_every_bus_that_does_not_carry_the_rate_is_named(file: Path) -> None:
    assignments = ["bus.wrist.bitrate=250000", "bus.shoulder.serial_baud=115200"]
    with pytest.raises(ConfigError) as caught:
        check_budget(overridden(file, *assignments, "control.rate_hz=150"))
    assert [error.problem for error in caught.value.errors] == [
        "on bus shoulder, rate_hz is 150, but 204 characters a cycle × 10 bits × 150 Hz = 306000 bit/s is 265.6% of "
        "the 115200 baud serial line, above its limit of 95%; the highest rate that fits is 53.6 Hz: lower rate_hz to "
        "53.6, or set adapter and bus.shoulder.serial_baud to 460800.",
        "on bus wrist, rate_hz is 150, but 1830 bits a cycle × 150 Hz = 274500 bit/s is 109.8% of the 250000 bit/s "
        "bus, above its load_limit of 85%; the highest rate that fits is 116.1 Hz: lower rate_hz to 116.1, or use a "
        "faster bus (bus.wrist.bitrate, up to 1000000).",
    ]
    assert {error.location for error in caught.value.errors} == {"control.rate_hz"}


def test_the_gripper_s_frames_are_on_its_bus_alone() -> None:
    arm = ArmConfig.model_validate(divided_values("episode1") | {"gripper": SERVO})
    assert [load.beside_words for load in budgets(arm)] == ["", "the gripper"]


def test_figures_are_those_of_each_bus_and_of_the_tightest(file: Path) -> None:
    arm = overridden(file, "bus.wrist.bitrate=250000", "control.rate_hz=100")
    found = figures(arm)
    shoulder, wrist = found["buses"]
    assert (shoulder["name"], shoulder["channel"]) == ("shoulder", "/dev/ttyshoulder")
    assert (wrist["name"], wrist["channel"], wrist["rate_hz"]) == ("wrist", "/dev/ttywrist", 100.0)
    assert wrist["bus_load"] == pytest.approx(2 * shoulder["bus_load"])
    assert {"name": "wrist", **{key: found[key] for key in wrist if key != "name"}} == wrist
    assert [joint["name"] for joint in found["joints"]] == [joint.name for joint in arm.joints]
    assert "buses" not in figures(load_arm("episode1"))


def test_the_check_shows_where_each_bus_is_and_what_it_carries(file: Path) -> None:
    out = StringIO()
    Console(file=out, width=100).print(render_check(load_arm(file)))
    text = out.getvalue()
    assert "episode1: 6 joints, slcan on /dev/ttyshoulder (shoulder), /dev/ttywrist (wrist)" in text
    assert [line.split()[:4] for line in text.splitlines() if "Budget" in line] == [
        ["Budget", "of", "bus", name] for name in NAMES
    ]
    assert places(load_arm("episode1").buses) == "slcan on /dev/ttyUSB1"
