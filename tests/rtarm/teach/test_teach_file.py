"""Motions as files: what is written is read again, and what is none is refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from depth import examples
from hand_readings import limits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import Result

from rtarm.console.errors import Refusal
from rtarm.teach.file import as_text, folder, kept, load, motion_path, require_free, save
from rtarm.teach.motion import Motion
from rtarm.teach.play import check

LIMITS = limits()
TIMES_S = np.array([0.0, 0.5, 1.0, 1.5])
POSITIONS_RAD = np.radians(np.outer([0.0, 1.0, 2.0, 2.0], [1.0, -1.0, 2.0, 3.0, -4.0, 5.0]))


def motion() -> Motion:
    return Motion("episode1", LIMITS, "2026-11-22T12:00:00+00:00", 0.01, 0.004, TIMES_S, POSITIONS_RAD)


@pytest.fixture(autouse=True)
def data_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data"


def written(**changes: object) -> dict[str, object]:
    """What stands in the file of a motion, but for some fields."""
    return {**yaml.safe_load(as_text(motion())), **changes}


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "wave.yaml"
    save(motion(), path, force=False)
    read = load(path)
    assert (read.arm, read.taught, read.limits.joints) == ("episode1", motion().taught, LIMITS.joints)
    assert read.limits.difference(LIMITS) == ""
    assert read.times_s == pytest.approx(TIMES_S, abs=1e-6)
    assert read.positions_rad == pytest.approx(POSITIONS_RAD, abs=1e-7)
    assert (read.tolerance_rad, read.deviation_rad) == pytest.approx((0.01, 0.004), abs=1e-7)
    check(path, read, "episode1", LIMITS, 1.0)


def test_a_person_can_read_it(tmp_path: Path) -> None:
    text = as_text(motion())
    assert "format: 1\n" in text
    assert '- {name: "joint1", lower_deg: -180, upper_deg: 140, velocity_deg_s: 24, ' in text
    assert "- [0.5, 1, -1, 2, 3, -4, 5]\n" in text
    assert yaml.safe_load(text)["points"][0] == [0, 0, 0, 0, 0, 0, 0]


def test_a_motion_is_never_replaced_unasked(tmp_path: Path) -> None:
    path = tmp_path / "wave.yaml"
    path.write_text("mine")
    with pytest.raises(Refusal, match=r"exists already.*--force"):
        require_free(path, force=False)
    with pytest.raises(Refusal, match="cannot be written"):
        save(motion(), path, force=False)
    assert path.read_text() == "mine"
    require_free(path, force=True)
    save(motion(), path, force=True)
    assert load(path).arm == "episode1"
    assert sorted(tmp_path.iterdir()) == [path]


def test_names_are_files_among_the_kept_ones_and_paths_are_paths(data_home: Path) -> None:
    assert motion_path("wave") == data_home / "rtarm" / "motions" / "wave.yaml"
    assert motion_path("./wave.yaml") == Path("wave.yaml")
    assert motion_path("wave.yml") == Path("wave.yml")
    for name in ("", ".", "..", "-x", "a b", "ä", "x" * 65, "a\n"):
        with pytest.raises(Refusal, match="no name of a motion"):
            motion_path(name)


def test_a_folder_that_is_not_there_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="folder that exists"):
        require_free(tmp_path / "nowhere" / "wave.yaml", force=False)
    with pytest.raises(Refusal, match="is a folder"):
        require_free(tmp_path, force=True)


HOSTILE = {
    "empty": (b"", "no table"),
    "binary": (b"\xff\xfe\x00", "UTF-8"),
    "no yaml": (b"format: [1", "no YAML"),
    "a list": (b"- 1\n- 2\n", "no table"),
    "an object": (b"!!python/object/apply:os.system ['true']", "no YAML"),
    "deep": (b"format: " + b"[" * 50_000, "nested too deep"),
    "laughter": (
        b"a: &a [x,x]\nb: &b [*a,*a]\nc: &c [*b,*b]\nformat: 1\npoints: [*c,*c]\n",
        "refers to itself",
    ),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_file_that_is_no_motion_is_refused(tmp_path: Path, what: str) -> None:
    data, said = HOSTILE[what]
    path = tmp_path / "m.yaml"
    path.write_bytes(data)
    with pytest.raises(Refusal, match=said):
        load(path)


JOINT = {"name": "joint1", "lower_deg": -1, "upper_deg": 1, "velocity_deg_s": 1, "acceleration_deg_s2": 1}
WRONG = [
    ({"format": 2}, "format 2.*newer rtarm"),
    ({"format": 0}, "format"),
    ({"format": True}, "format"),
    ({"format": "1"}, "format"),
    ({"colour": "red"}, "colour"),
    ({"arm": 7}, "arm"),
    ({"tolerance_deg": float("nan")}, "tolerance_deg"),
    ({"joints": []}, "joints"),
    ({"joints": [JOINT, dict(JOINT)]}, "row of points"),
    ({"joints": [JOINT, dict(JOINT)], "points": [[0, 0, 0], [1, 1, 1]]}, "same name"),
    ({"joints": [{**JOINT, "velocity_deg_s": 0}]}, "velocity_deg_s"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0]]}, "points"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]]}, "row of points"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0, 0]]}, "rise"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [-1, 1, 0, 0, 0, 0, 0]]}, "rise"),
    ({"points": [[1, 0, 0, 0, 0, 0, 0], [2, 1, 0, 0, 0, 0, 0]]}, "begin with 0"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [1, "x", 0, 0, 0, 0, 0]]}, "points"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [1, True, 0, 0, 0, 0, 0]]}, "points"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [1, float("inf"), 0, 0, 0, 0, 0]]}, "points"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [5e-324, 1, 0, 0, 0, 0, 0]]}, "rise"),
    ({"points": [[0, 0, 0, 0, 0, 0, 0], [1, 1e300, 0, 0, 0, 0, 0]]}, "points"),
]


@pytest.mark.parametrize(("changes", "said"), WRONG)
def test_a_field_that_is_wrong_is_named(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(written(**changes)))
    with pytest.raises(Refusal, match=said):
        load(path)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(as_text(motion()))))
def test_a_file_cut_off_anywhere_is_a_motion_or_refused(tmp_path: Path, length: int) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(as_text(motion())[:length])
    try:
        read = load(path)
    except Refusal as refused:
        assert str(path) in refused.sentence and refused.sentence.endswith(".")
    else:
        assert len(read.times_s) >= 2


@settings(deadline=None, max_examples=examples(200), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(as_text(motion())) - 1), st.binary(min_size=1, max_size=4))
def test_a_file_with_foreign_bytes_is_a_motion_or_refused(tmp_path: Path, at: int, foreign: bytes) -> None:
    path = tmp_path / "m.yaml"
    text = as_text(motion()).encode()
    path.write_bytes(text[:at] + foreign + text[at + len(foreign) :])
    try:
        load(path)
    except Refusal as refused:
        assert str(path) in refused.sentence


@pytest.mark.parametrize(
    ("joint", "key", "value", "said"),
    [
        (0, "name", "base", "the joints are base, joint2.*, not joint1"),
        (1, "lower_deg", -80, r"lower limit of joint2 is -80°, not -90°"),
        (2, "upper_deg", 81, r"upper limit of joint3 is 81°, not 80°"),
        (3, "velocity_deg_s", 119, r"velocity limit of joint4 is 119°/s, not 120°/s"),
        (5, "acceleration_deg_s2", 1000, r"acceleration limit of joint6 is 1000°/s², not 1145"),
    ],
)
def test_a_motion_of_another_arm_is_refused_with_what_differs(
    tmp_path: Path, joint: int, key: str, value: object, said: str
) -> None:
    document = written()
    document["joints"][joint][key] = value  # type: ignore[index]
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(Refusal, match=said):
        check(path, load(path), "episode1", LIMITS, 1.0)


def test_a_motion_that_leaves_the_limits_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(written(points=[[0, 0, 0, 0, 0, 0, 0], [60, 141, 0, 0, 0, 0, 0]])))
    with pytest.raises(Refusal, match=r"joint1 goes to 141\.000°, beyond its limit of 140°"):
        check(path, load(path), "episode1", LIMITS, 1.0)
    path.write_text(yaml.safe_dump(written(points=[[0, 0, 0, 0, 0, 0, 0], [1, 100, 0, 0, 0, 0, 0]])))
    with pytest.raises(Refusal, match=r"--speed is 1, but the arm's limits allow at most 0\.1"):
        check(path, load(path), "episode1", LIMITS, 1.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(Refusal, match="--speed is"):
        check(Path("m.yaml"), motion(), "episode1", LIMITS, speed)


def test_the_kept_motions_are_listed_and_a_broken_one_says_why(rtarm: Callable[..., Result]) -> None:
    assert "No motions are kept" in rtarm("motions").stdout
    require_free(motion_path("wave"), force=False)
    save(motion(), motion_path("wave"), force=False)
    motion_path("broken").write_text("format: 9\n")
    (folder() / ".wave.yaml.half").write_text("")
    assert [path.stem for path in kept()] == ["broken", "wave"]
    broken, wave = json.loads(rtarm("motions", "--json").stdout)["motions"]
    assert "format 9" in broken["problem"]
    assert (wave["name"], wave["arm"], wave["duration_s"]) == ("wave", "episode1", 1.5)
    assert wave["joints"] == list(LIMITS.joints)
    shown = rtarm("motions").stdout
    assert "2026-11-22 12:00" in shown and "1.5 s" in shown


def test_what_a_file_says_is_neither_markup_nor_obeyed_by_a_terminal(rtarm: Callable[..., Result]) -> None:
    require_free(motion_path("wave"), force=False)
    motion_path("markup").write_text(yaml.safe_dump(written(arm="[/x]")))
    motion_path("word").write_text(yaml.safe_dump({"[/y]\x1b[31m": 3}))
    for number, key in enumerate(("arm", "taught")):
        motion_path(f"red{number}").write_text(yaml.safe_dump(written(**{key: "\x1b[31mred"})))
    shown = rtarm("motions")
    assert shown.exit_code == 0 and "[/x]" in shown.stdout and "\x1b" not in shown.stdout
    rows = json.loads(rtarm("motions", "--json").stdout)["motions"]
    assert ["problem" in row for row in rows] == [False, True, True, True]


def test_a_motion_that_is_not_there_is_refused_with_those_that_are(rtarm: Callable[..., Result], arm: object) -> None:
    require_free(motion_path("wave"), force=False)
    save(motion(), motion_path("wave"), force=False)
    result = rtarm("play", "dance", "--arm", arm.name)  # type: ignore[attr-defined]
    assert result.exit_code == 1
    assert "those kept are: wave" in result.stderr
