"""From file to arm: names and paths, lines, overrides, the hash, and a sentence for every bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from config import yaml_text
from config.errors import ConfigError
from config.joint import FAMILIES
from config.loader import ABSENT, ARMS_FOLDER, arm_hash, differences, known_arms, load_arm, parse_overrides
from config.schema import ArmConfig

EPISODE1 = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8")

KNOWN = ", ".join((*FAMILIES[1:], FAMILIES[0]))


def line_of(text: str, needle: str, occurrence: int = 0) -> int:
    return [number for number, line in enumerate(text.splitlines(), 1) if needle in line][occurrence]


def errors_of(folder: Path, text: str, overrides: dict[str, Any] | None = None) -> tuple[ConfigError, ...]:
    file = folder / "arm.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_arm(file, overrides=overrides)
    return caught.value.errors


def changed(old: str, new: str, text: str = EPISODE1) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


# --- what loads -------------------------------------------------------------------------------------


def test_the_known_arms() -> None:
    assert known_arms() == [
        *("cia402_6", "damiao6", "damiao6_pv", "episode1", "mks6", "mock", "myactuator6", "odrive6", "robstride6"),
        "robstride6_position",
        "vesc6",
    ]
    for name in known_arms():
        assert load_arm(name).name == name


def test_an_own_arm_is_one_more_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yaml").write_text(changed("name: episode1", "name: mine"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for given_as in ("mine.yaml", "./mine.yaml", str(tmp_path / "mine.yaml"), Path("mine.yaml")):
        assert load_arm(given_as).name == "mine"


def test_a_name_without_ending_is_never_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mock").write_text("name: other", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert load_arm("mock").name == "mock"


def test_anchors_and_merge_keys_work_and_keep_their_lines(tmp_path: Path) -> None:
    text = """\
name: pair
control: {rate_hz: 100}
bus: {interface: mock}
joints:
  - &first
    name: a
    drive: {family: mock}
    ratio: 10
    lower_deg: -10
    upper_deg: 10
    motor_rpm: 100
    max_acceleration_rad_s2: 1
  - <<: *first
    name: b
    ratio: 5
"""
    file = tmp_path / "pair.yaml"
    file.write_text(text, encoding="utf-8")
    arm = load_arm(file)
    assert [(joint.name, joint.ratio, joint.motor_rpm) for joint in arm.joints] == [
        ("a", 10, 100),
        ("b", 5, 100),
    ]
    error = errors_of(tmp_path, changed("ratio: 5", "ratio: 0", text))[0]
    assert (error.line, error.location) == (15, "joints[1].ratio")


def test_the_source_knows_the_line_of_every_field() -> None:
    source = load_arm("episode1").source
    assert source is not None
    assert source.file == "episode1.yaml"
    assert source.lines["control.rate_hz"] == line_of(EPISODE1, "rate_hz: 120")
    assert source.lines["joints[3].ratio"] == line_of(EPISODE1, "ratio: 10")
    assert source.lines["joints[5].drive.address"] == line_of(EPISODE1, "address: 6")


# --- overrides --------------------------------------------------------------------------------------


def test_overrides_replace_values_before_the_check() -> None:
    arm = load_arm("episode1", overrides={"control": {"rate_hz": 100.0}, "front": {"discovery": "subnet"}})
    assert (arm.control.rate_hz, arm.control.init_mode, arm.front.discovery) == (100.0, 1, "subnet")
    assert load_arm("episode1").control.rate_hz == 120.0


def test_overriding_channel_replaces_usb_index_and_vice_versa(tmp_path: Path) -> None:
    assert load_arm("episode1", overrides={"bus": {"channel": "/dev/pts/3"}}).bus.resolved_channel == "/dev/pts/3"
    file = tmp_path / "arm.yaml"
    file.write_text(changed("usb_index: 1", "channel: /dev/ttyACM0"), encoding="utf-8")
    assert load_arm(file, overrides={"bus": {"usb_index": 3}}).bus.resolved_channel == "/dev/ttyUSB3"


def test_an_override_is_blamed_on_the_override(tmp_path: Path) -> None:
    error = errors_of(tmp_path, EPISODE1, {"control": {"rate_hz": 5.0}})[0]
    assert (error.line, error.location, error.overridden) == (None, "control.rate_hz", True)
    assert "control.rate_hz (overridden): rate_hz is 5, but must be at least 10 and at most 2000" in str(error)


def test_a_real_arm_on_the_mock_interface_is_refused_for_its_drives(tmp_path: Path) -> None:
    error = errors_of(tmp_path, EPISODE1, {"bus": {"interface": "mock"}})[0]
    assert "joint1 has a zdt drive, but interface mock reaches no drives" in error.problem


# --- the hash ---------------------------------------------------------------------------------------


def test_the_hash_is_63_bits_and_tells_arms_apart() -> None:
    arms = [
        load_arm("episode1"),
        load_arm("mock"),
        load_arm("episode1", overrides={"control": {"rate_hz": 100.0}}),
    ]
    numbers = [arm_hash(arm) for arm in arms]
    assert len(set(numbers)) == 3
    assert all(0 <= number < 2**63 for number in numbers)


def test_the_hash_depends_on_values_not_on_spelling(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(yaml.safe_load(EPISODE1)), encoding="utf-8")
    assert arm_hash(load_arm(file)) == arm_hash(load_arm("episode1"))


# --- bad input: the arm as a whole ------------------------------------------------------------------


def test_an_unknown_arm_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError) as caught:
        load_arm("episod1")
    assert str(caught.value) == (
        "no arm is called 'episod1' (did you mean episode1?); the known arms are "
        f"{', '.join(known_arms())}; use one of "
        "them, or the path of your own arm file (such as ./my_arm.yaml)."
    )


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_arm(tmp_path / "none.yaml")
    assert caught.value.file == str(tmp_path / "none.yaml")
    assert "there is no such file; give the path" in caught.value.problem


def test_a_folder_instead_of_a_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_arm(tmp_path)


def test_a_file_that_is_not_text(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_bytes(b"name: \xff\xfe")
    with pytest.raises(ConfigError, match="byte 6 is not UTF-8 text"):
        load_arm(file)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("name: x\ncontrol: [1\n", 2, "the [ in column 10 is not closed, or a comma is missing behind it."),
        ("name: x\ncontrol: {rate_hz: 1\n", 2, "the { in column 10 is not closed, or a comma is missing behind it."),
        ("name: x\n\tdescription: 1", 2, "the line is indented with a tab, and YAML takes spaces only: put spaces"),
        ("bus:\n  \tinterface: mock", 2, "the line is indented with a tab, and YAML takes spaces only: put spaces"),
        ("name:\tx", 1, "column 6 is a tab, and YAML takes spaces only: put a space there."),
        ('name: "unclosed\n', 1, "the quote in column 7 is not closed: add the other one."),
        ('name: "a\\q"', 1, "in double quotes the backslash before column 10 has a meaning of its own"),
        ("name: %x", 1, "no value begins with the character in column 7: put the value in quotes."),
        ("name: a: b", 1, "the colon in column 8 stands where no field can begin: give each field a line of its own"),
        ("name\njoints: 3", 1, "'name' is no field: write name: value, with a space behind the colon."),
        ("bus:\n  interface\n\n  channel: x", 2, "'interface' is no field: write name: value"),
        ("name: x\nnote: some\n  long text\n  with colon: here", 4, "the colon in column 13 stands where no field can"),
        ("name: - a", 1, "the dash in column 7 stands where no list can begin"),
        ("bus: {}\nname x\ncontrol: {}", 2, "what begins in column 1 is no field: write name: value, with a space"),
        ("bus:\n    a: 1\n  b: 2", 3, "what begins in column 3 does not go with the lines above it: indent it"),
        ("name: x\nname: y", 2, "name is given twice, here and on line 1"),
        ("a: 1\n---\nb: 2", 2, "another document begins, but a file is one arm: remove what follows."),
        ("name: !!python/object/apply:os.system [ls]", 1, "could not determine a constructor"),
        ("? [a]\n: b", 1, "found unhashable key"),
        ("name: *nowhere", 1, "found undefined alias"),
        ("- a\n- b", 1, "the file is not a list of fields"),
        ("just text", 1, "the file is not a list of fields"),
        ("!!set {a, b}", 1, "the file is not a list of fields"),
        ("", None, "the file is empty"),
        ("# only a comment\n", None, "the file is empty"),
        ("name: 2001-99-99", None, "month must be in 1..12"),
        ("name: \x01", None, "unacceptable character"),
        ("[" * 100_000, None, "nested too deeply"),
        ("joints: &a [*a]", 1, "an alias contains itself"),
    ],
)
def test_malformed_yaml(tmp_path: Path, text: str, line: int | None, words: str) -> None:
    error = errors_of(tmp_path, text)[0]
    assert words in error.problem
    if line is not None:
        assert error.line == line
        assert str(error).startswith(f"{tmp_path / 'arm.yaml'}:{line}: ")


# --- bad input: one field ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "location", "sentence"),
    [
        (
            "lower_deg: -180",
            "lower_deg: 200",
            "joints[0].lower_deg",
            "lower_deg of joint1 is 200, above its upper_deg 140; the lower limit must be the smaller one: "
            "exchange them or correct one.",
        ),
        ("lower_deg: -180", "lower_deg: 140", "joints[0].lower_deg", "are both 140, which leaves no room"),
        ("rate_hz: 120", "rate_hz: 5000", "control.rate_hz", "must be at least 10 and at most 2000"),
        ("rate_hz: 120", 'rate_hz: "120"', "control.rate_hz", "rate_hz is the text '120'"),
        ("rate_hz: 120", "rate_hz: 1e3", "control.rate_hz", "write it as 1000, with plain digits"),
        ("rate_hz: 120", "rate_hz: .nan", "control.rate_hz", "must be a finite number"),
        ("rate_hz: 120", "rate_hz: yes", "control.rate_hz", "rate_hz is true, but must be a number"),
        ("rate_hz: 120", "rate_hz: 1" + "0" * 400, "control.rate_hz", "a number of more than 64 bits"),
        ("rate_hz: 120", "rate_hz:", "control.rate_hz", "rate_hz is left empty"),
        ("init_mode: 1 ", "init_mode: true ", "control.init_mode", "init_mode is true, but must be a number"),
        ("init_mode: 1 ", "init_mode: 2 ", "control.init_mode", "init_mode is 2, but must be 0 or 1"),
        (
            "usb_index: 1",
            "usb_index: 1\n  channel: /dev/ttyACM0",
            "bus.usb_index",
            "usb_index 1 (/dev/ttyUSB1) and channel /dev/ttyACM0 both name the adapter",
        ),
        ("usb_index: 1", "#", "bus.interface", "interface slcan needs the adapter's device"),
        ("usb_index: 1", 'channel: ""', "bus.channel", "channel is empty"),
        ("usb_index: 1", "usb_index: -1", "bus.usb_index", "usb_index is -1, but must be at least 0"),
        (
            "interface: slcan",
            "interface: can0",
            "bus.interface",
            "set interface to socketcan, and channel to its name, such as can0.",
        ),
        (
            "interface: slcan",
            "interface: SLCAN",
            "bus.interface",
            "'SLCAN' (did you mean slcan?), but must be 'slcan', ",
        ),
        ("interface: slcan", "interface: mock", "bus.usb_index", "interface mock opens no device"),
        ("bitrate: 500000", "bitrate: 800000", "bus.bitrate", "S7 is 800000 in some adapters and 750000"),
        ("bitrate: 500000", "bitrate: 750000", "bus.bitrate", "S7 is 800000 in some adapters and 750000"),
        ("bitrate: 500000", "bitrate: 333333", "bus.bitrate", "an SLCAN adapter offers 10000, 20000"),
        ("serial_baud: 1000000", "serial_baud: 12345", "bus.serial_baud", "a serial line knows 9600"),
        ("serial_baud: 1000000", "serial_baud: usb", "bus.serial_baud", "serial_baud is 'usb'"),
        ("load_limit: 0.85", "load_limit: 1.5", "bus.load_limit", "must be above 0 and at most 1"),
        ("name: joint2", "name: joint1", "joints[1].name", "name joint1 is used by the 1st and the 2nd joint; "),
        ("name: joint2", "name: joint 2", "joints[1].name", "name of the 2nd joint is the text 'joint 2', which is"),
        ("name: joint2", "name: joint 2", "joints[1].name", "a letter or _, then letters, digits, _, ., / and -"),
        ("address: 2", "address: 1", "joints[1].drive.address", "address 1 is used by joint1 and joint2"),
        ("address: 2", "address: 256", "joints[1].drive.address", "address of joint2 is 256"),
        ("address: 2,", "", "joints[1].drive.address", "address of joint2 is missing; add it"),
        ("address: 2", "adress: 2", "joints[1].drive.address", "address of joint2 is missing"),
        (
            "family: zdt, address: 3",
            "family: ZTD, address: 3",
            "joints[2].drive",
            f"is 'ZTD' (did you mean zdt?), but the known families are {KNOWN}; choose one",
        ),
        ("family: zdt, address: 3", "address: 3", "joints[2].drive", "does not say its family"),
        (
            "{family: zdt, address: 3, microsteps: 16}",
            "{family: mock}",
            "joints[2].drive.family",
            "mock drive",
        ),
        ("{family: zdt, address: 3, microsteps: 16}", "zdt", "joints[2].drive", "must be a group of fields"),
        ("ratio: 20", "ratio: 0", "joints[1].ratio", "ratio of joint2 is 0, but must be at least 0.001"),
        (
            "name: joint2",
            "name: y",
            "joints[1].name",
            "name of the 2nd joint is y, which YAML readers take for a value",
        ),
        (
            "name: joint2",
            "name: 'NaN'",
            "joints[1].name",
            "name of the 2nd joint is NaN, which YAML readers take for a value",
        ),
        ("episode_arm_controller", "controller_names", "front.controller_name", "has a meaning of its own in MoveIt"),
        ("episode_arm_controller", "'Off'", "front.controller_name", "YAML readers take for a value"),
        ("group: episode_arm", "group: planner_configs", "kinematics.group", "has a meaning of its own in MoveIt"),
        ("base_link: base_link", "base_link: 'null'", "kinematics.base_link", "YAML readers take for a value"),
        ("sign: -1", "sign: 0", "kinematics.dh[1].sign", "sign of joint2 is 0, but must be 1 or -1; choose one"),
        ("sign: -1", "sign: true", "kinematics.dh[1].sign", "sign of joint2 is true, but must be a number"),
        (
            "radius_mm: 35",
            "radius_mm: 0",
            "kinematics.dh[1].radius_mm",
            "radius_mm of joint2 is 0, but must be above 0",
        ),
        ("alpha_deg: -90", "alpha_deg: 900", "kinematics.dh[3].alpha_deg", "must be at least -360 and at most 360"),
        (
            "d_mm: 192",
            "d: 192",
            "kinematics.dh[3].d",
            "d of joint4 is not a field; known here are d_mm, a_mm, alpha_deg",
        ),
        ("group: episode_arm", "group: the arm", "kinematics.group", "a letter, then letters, digits and _"),
        (
            "base_link: base_link",
            "base_link: link6",
            "kinematics.base_link",
            "link1 to link6 are names of other frames",
        ),
        ("    - {d_mm: 0, a_mm: 200", "#", "kinematics.dh", "dh has 5 rows, but the arm has 6 joints; give one row"),
        (
            "name: joint2",
            "name: flange_joint",
            "joints[1].name",
            "which the robot model calls a fixed joint of its own",
        ),
        ("    ratio: 20\n", "", "joints[1].ratio", "gear ratio: motor turns for one turn of the joint"),
        ("direction: 1\n", "direction: 2\n", "joints[0].direction", "must be 1 or -1"),
        (
            "motor_rpm: 60",
            "motor_rpm: 6000",
            "joints[1].motor_rpm",
            "motor_rpm of joint2 is 6000, but must be at least 0.01 and at most 3000",
        ),
        # above 0, and a velocity of 0 with the ratio
        ("motor_rpm: 60", "motor_rpm: 5.0e-324", "joints[1].motor_rpm", "must be at least 0.01"),
        (
            "max_acceleration_rad_s2: 1.0",
            "max_acceleration_rad_s2: 0",
            "joints[1].max_acceleration_rad_s2",
            "must be at least 0.0001",
        ),
        (
            "max_acceleration_rad_s2: 1.0",
            "max_acceleration_rad_s2: 5000",
            "joints[1].max_acceleration_rad_s2",
            "no ramp that brakes at 1.5 to 2 times that limit when it hears nothing more; the nearest limit "
            "that has one is 69.81.",
        ),
        ("episode_arm_controller", "arm-controller", "front.controller_name", "a letter, then letters, digits and _"),
        ("- name: joint2", "- nmae: joint2", "joints[1].name", "name of the 2nd joint is missing; add it"),
        ("ratio: 20", "ratio: yes", "joints[1].ratio", "ratio of joint2 is true, but must be a number"),
        (
            "[0, 0, 0, 0, 0, 0]",
            "[0, 0, a, 0, 0, 0]",
            "homing.then.joints_deg[2]",
            "the 3rd entry of joints_deg (joint3)",
        ),
        (
            "{family: zdt, address: 3, ",
            "{family: zdt, drive: 3, address: 3, ",
            "joints[2].drive.drive",
            "drive of joint3 is not a field of drive; known here are family, address",
        ),
        ("name: episode1", "name: Episode-1", "name", "small letters, digits and _, at most 32"),
        ("name: episode1", "name: on", "name", "put the text in quotes"),
        ("schema_version: 1", "schema_version: 2", "schema_version", "schema_version is 2, but must be 1"),
        ("front:", "front:\n  joint_states_hz: 40", "front.joint_states_hz", "must be at least 50"),
        ("front:", "front:\n  joint_states_hz: 70", "front.joint_states_hz", "nearest possible is 60 or 120"),
        ("front:", "front:\n  joint_states_hz: 200", "front.joint_states_hz", "nearest possible is 120:"),
        ("front:", "limits: {braking_factor: 3}\nfront:", "limits.braking_factor", "acceleration_margin 2"),
        ("front:", "limits: {stale_fault_s: 0.01}\nfront:", "limits.stale_fault_s", "stale_brake_s 0.02"),
        ("front:", "limits: {silence_brake_factor: 3}\nfront:", "limits.silence_brake_factor", "at most 2"),
        ("front:", "realtime: {priority: 99}\nfront:", "realtime.priority", "at least 1 and at most 90"),
        ("front:", "realtime: {require: 1}\nfront:", "realtime.require", "must be true or false"),
        ("front:", "limits: 3\nfront:", "limits", "limits is 3, but must be a group of fields"),
    ],
)
def test_each_bad_value_has_its_sentence_and_its_line(
    tmp_path: Path, old: str, new: str, location: str, sentence: str
) -> None:
    text = changed(old, new)
    error = errors_of(tmp_path, text)[0]
    assert error.location == location
    assert sentence in error.problem
    assert error.problem.endswith(".")
    assert "\n" not in str(error) and "joints[" not in str(error)
    if old.strip().split(":")[0] in ("lower_deg", "rate_hz", "ratio", "motor_rpm") and new:
        assert error.line == line_of(text, new.partition("\n")[0])


@pytest.mark.parametrize(
    ("old", "new", "location", "sentence"),
    [
        ("rate_hz: 120", "rate: 120", "control.rate", "rate is not a field of control (did you mean rate_hz?)"),
        ("ratio: 20", "ratoi: 20", "joints[1].ratoi", "ratoi of joint2 is not a field (did you mean ratio?)"),
        ("microsteps: 16}", "microstep: 16}", "joints[0].drive.microstep", "(did you mean microsteps?)"),
        ("front:", "trajectorie: {}\nfront:", "trajectorie", "(did you mean trajectory?)"),
        ("front:", "zzz: {}\nfront:", "zzz", "zzz is not a field; known here are schema_version, name,"),
        (
            "motor_rpm: 60",
            "motor_rpm: 60\n    max_velocity_rad_s: 1",
            "joints[1].max_velocity_rad_s",
            "the joint's velocity limit is derived: set motor_rpm and ratio instead",
        ),
    ],
)
def test_an_unknown_field_names_the_closest_known_one(
    tmp_path: Path, old: str, new: str, location: str, sentence: str
) -> None:
    text = changed(old, new)
    found = [error for error in errors_of(tmp_path, text) if error.location == location]
    assert len(found) == 1
    assert sentence in found[0].problem
    assert found[0].line == line_of(text, location.rpartition(".")[2] + ":")


def test_an_arm_has_1_to_32_joints(tmp_path: Path) -> None:
    head = EPISODE1[: EPISODE1.index("joints:\n")]
    error = errors_of(tmp_path, head + "joints: []\n")[0]
    assert "joints has 0 entries, but an arm has 1 to 32" in error.problem


def test_a_key_given_twice_deep_in_the_file(tmp_path: Path) -> None:
    text = changed("    ratio: 20\n", "    ratio: 20\n    ratio: 10\n")
    error = errors_of(tmp_path, text)[0]
    first = line_of(text, "ratio: 20")
    assert error.line == first + 1
    assert f"ratio is given twice, here and on line {first}" in error.problem


def test_all_problems_are_listed_and_the_first_speaks(tmp_path: Path) -> None:
    text = changed("ratio: 20", "ratio: 0", changed("rate_hz: 120", "rate_hz: fast"))
    errors = errors_of(tmp_path, text)
    assert [error.location for error in errors] == ["control.rate_hz", "joints[1].ratio"]
    assert errors[0].errors == errors
    assert str(errors[0]) == (
        f"{tmp_path / 'arm.yaml'}:{line_of(text, 'rate_hz: fast')}: control.rate_hz: rate_hz is the text "
        "'fast', but must be a number; write the number alone, in the unit the field's name says."
    )


def assert_an_arm_or_sentences(file: Path, overrides: dict[str, Any] | None) -> None:
    try:
        arm = load_arm(file, overrides=overrides)
    except ConfigError as error:
        sentences = [problem.problem for problem in error.errors]
    else:
        sentences = []
        assert isinstance(arm, ArmConfig)
    for sentence in sentences:
        assert sentence.endswith(".")
        assert "\n" not in sentence


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_happens_to_a_file_the_answer_is_an_arm_or_a_sentence(tmp_path: Path, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(EPISODE1)), label="start")
    end = data.draw(st.integers(start, min(len(EPISODE1), start + 60)), label="end")
    alphabet = st.sampled_from(list("abz019-+.:,{}[]()&*!|>'\"#%@`~?<=\n\t \x00\u2028é\ufeff"))
    put = data.draw(st.text(alphabet, max_size=8), label="put")
    file = tmp_path / "arm.yaml"
    file.write_text(EPISODE1[:start] + put + EPISODE1[end:], encoding="utf-8", newline="")
    assert_an_arm_or_sentences(file, None)


@settings(max_examples=examples(150), deadline=None)
@given(data=st.data())
def test_a_file_is_read_alike_with_libyaml_and_without(data: st.DataObject) -> None:
    short = "a: [1, {b: 1.5e-3}]\nc:  # and\n- d: 'it''s'\n  e: \"x\\ty\"\n- 0x1F\nf: no\n"
    text = data.draw(st.sampled_from([short, EPISODE1]), label="text")
    start = data.draw(st.integers(0, len(text)), label="start")
    end = data.draw(st.integers(start, min(len(text), start + 30)), label="end")
    pieces = ["- ", "\n  ", "? ", ": ", " #", "---\n", "...\n", "%YAML 1.1\n", "!!str ", "&a ", "*a", "<<: "]
    put = data.draw(
        st.lists(st.sampled_from([*"abz019-+.:,{}[]()&*!|>'\"#%@`~?<=\n\t \r\\é\ufeff\x85\u2028", *pieces]), max_size=8)
    )
    assert_read_alike(text[:start] + "".join(put) + text[end:])


@pytest.mark.parametrize("text", ["#null.inf\u2028\ufeff😀:", " #\x85a中\t", "a: 1 # b\u2028c: 2\n"])
def test_a_line_that_ends_as_only_unicode_has_it_is_read_alike(text: str) -> None:
    assert_read_alike(text)


def assert_read_alike(text: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        fast = read_or_refused(text)
        patch.setattr(yaml_text, "LIBYAML", None)
        assert fast == read_or_refused(text)


def read_or_refused(text: str) -> object:
    """What a text says and where, None for a refusal."""
    try:
        root, values = yaml_text.parse(text, "arm.yaml")
    except ConfigError:
        return None
    return repr(values), [*yaml_text.lines(root, ())] if "*" not in text else []


@settings(max_examples=examples(100), deadline=None)
@given(
    overrides=st.recursive(
        st.dictionaries(
            st.sampled_from(["control", "rate_hz", "bus", "channel", "usb_index", "joints", "drive", "family", "x"]),
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
            max_size=3,
        ),
        lambda inner: st.dictionaries(
            st.sampled_from(["control", "bus", "joints", "limits", "front", "x"]), inner, max_size=3
        ),
        max_leaves=5,
    )
)
def test_whatever_is_overridden_the_answer_is_an_arm_or_a_sentence(overrides: dict[str, Any]) -> None:
    assert_an_arm_or_sentences(ARMS_FOLDER / "episode1.yaml", overrides)


# --- files that grow when they are read --------------------------------------------------------------------


def merge_bomb(depth: int) -> str:
    groups = [f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 9)}]}}" for i in range(1, depth)]
    return "\n".join(["b0: &b0 {k: 1, l: 2}", *groups])


def test_merged_keys_that_multiply_are_refused_before_they_are_written_out(tmp_path: Path) -> None:
    file = tmp_path / "bomb.yaml"
    file.write_text(merge_bomb(40), encoding="utf-8")
    with pytest.raises(ConfigError, match="has more than 10000 entries, which no arm needs"):
        load_arm(file)
    with pytest.raises(ConfigError, match="has more than 10000 entries"):
        parse_overrides([f"control.rate_hz={merge_bomb(40)}"])


def test_aliases_that_multiply_are_refused_before_anybody_shows_them() -> None:
    lists = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 40)]
    with pytest.raises(ConfigError, match="has more than 10000 entries"):
        load_arm("episode1", overrides=parse_overrides(["bus.serial_baud=" + "\n".join(["a0: &a0 [x]", *lists])]))


@pytest.mark.parametrize("value", ["&a {x: *a}", "&a [*a]", "&x {<<: *x}"])
def test_an_alias_that_contains_itself_is_refused(value: str) -> None:
    with pytest.raises(ConfigError, match="an alias contains itself"):
        parse_overrides([f"control.rate_hz={value}"])


@pytest.mark.parametrize("value", ["!!float ''", "!!int ''", "!!bool x", "!!timestamp x"])
def test_a_scalar_that_is_not_what_its_tag_says_is_a_sentence(value: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has a value that is not valid YAML"):
        parse_overrides([f"control.rate_hz={value}"])
    file = tmp_path / "tagged.yaml"
    file.write_text(f"name: {value}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="not valid YAML"):
        load_arm(file)


def test_an_endless_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "long.yaml"
    file.write_bytes(b"#" * 1_000_001)
    with pytest.raises(ConfigError, match="more than 1000000 bytes"):
        load_arm(file)
    with pytest.raises(ConfigError, match="more than 1000000 bytes"):
        load_arm(Path("/dev/zero"))


def test_an_override_nested_too_deeply_is_a_sentence() -> None:
    with pytest.raises(ConfigError, match="has a value that is not valid YAML"):
        parse_overrides(["control.rate_hz=" + "[" * 10_000])


def test_a_sentence_is_one_printable_line_whatever_the_file_says(tmp_path: Path) -> None:
    file = tmp_path / "lines.yaml"
    file.write_text('"a\\nb\\e[31m": 1\n', encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_arm(file)
    assert any("a\\nb\\x1b[31m is not a field" in str(error) for error in refused.value.errors)
    assert all(str(error).isprintable() for error in refused.value.errors)


def test_differences_of_two_arm_files_name_the_place_and_both_values(tmp_path: Path) -> None:
    text = (ARMS_FOLDER / "mock.yaml").read_text(encoding="utf-8")
    one, other = tmp_path / "one.yaml", tmp_path / "other.yaml"
    one.write_text(text, encoding="utf-8")
    other.write_text(f"# the same\n{text}", encoding="utf-8")
    assert differences(one, other) == [] == differences("mock", one)
    values = yaml.safe_load(text)
    values["joints"][1]["upper_deg"] = 12.5
    values["parking"] = {"target_deg": [0.0] * 6}
    del values["front"]["controller_name"]
    other.write_text(yaml.safe_dump(values), encoding="utf-8")
    found = {where: (before, now) for where, before, now in differences(one, other)}
    assert found["upper_deg of joint2"] == (yaml.safe_load(text)["joints"][1]["upper_deg"], 12.5)
    assert found["parking.target_deg[0]"] == (ABSENT, 0.0)
    assert found["front.controller_name"][1] is ABSENT


def test_an_arm_is_named_by_its_file_unless_an_option_names_it(tmp_path: Path) -> None:
    own = tmp_path / "episode1.yaml"
    own.write_text((ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    assert load_arm(own).file_argument == str(own)
    assert load_arm("episode1").file_argument == "episode1"
    assert load_arm("episode1", overrides={"name": "other"}).file_argument == ""
    assert not load_arm(own).has_options
    assert load_arm(own, overrides={"control": {"rate_hz": 100.0}}).has_options
