"""What `rtarm calibrate` writes into an arm file: single values, and nothing else, whole or not at all."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from config.loader import ARMS_FOLDER, load_arm
from rtarm.calibrate.arm_file import ArmFile, with_value
from rtarm.console.errors import Refusal

CHANGES = {"direction": -1.0, "ratio": 20.5, "zero_deg": -12.25}


@given(
    joint=st.integers(0, 5),
    changes=st.fixed_dictionaries(
        {},
        optional={
            "direction": st.sampled_from((-1, 1)),
            "ratio": st.integers(1, 10**9).map(lambda n: n / 1e4),
            "zero_deg": st.integers(-3_600_000, 3_600_000).map(lambda n: n / 100),
        },
    ),
)
def test_only_the_values_of_the_joint_change(joint: int, changes: dict[str, float]) -> None:
    text = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8")
    edited = text
    for field, value in changes.items():
        edited = with_value(edited, joint, field, f"{value:.10g}")
    wanted = yaml.safe_load(text)
    wanted["joints"][joint].update(changes)
    assert yaml.safe_load(edited) == wanted
    before, after = text.splitlines(), edited.splitlines()
    assert len(before) == len(after)
    assert sum(old != new for old, new in zip(before, after, strict=True)) <= len(changes)
    assert [line.partition("#")[2] for line in before] == [line.partition("#")[2] for line in after]


LAYOUTS = {
    "flow": "joints:\n  - {name: a, ratio: 25, lower_deg: 0}  # one line\n",
    "flow, last": "joints: [{name: a, ratio: 25}]\n",
    "block": "joints:\n  - name: a\n    ratio: 25   # of the box\n    lower_deg: 0\n",
    "block, first": "joints:\n  - ratio: 25\n    name: a\n",
    "no line end": "joints:\n  - name: a\n    ratio: 25",
    "DOS": "joints:\r\n  - name: a\r\n    ratio: 25\r\n    lower_deg: 0\r\n",
    "byte order mark": "\ufeffjoints:\n  - name: a\n    ratio: 25\n",
    "quoted, not ASCII": 'description: "Größe ×"\njoints:\n  - name: a\n    "ratio": 25\n',
}


@pytest.mark.parametrize("text", LAYOUTS.values(), ids=LAYOUTS)
def test_missing_fields_are_put_behind_the_ratio(text: str) -> None:
    wanted = yaml.safe_load(text)
    edited = text
    for field, value in CHANGES.items():
        edited = with_value(edited, 0, field, f"{value:.10g}")
        wanted["joints"][0][field] = value
        assert yaml.safe_load(edited) == wanted
    assert edited.count("\r\n") == (edited.count("\n") if "\r" in text else 0)
    assert all(comment in edited for comment in ("# one line", "# of the box") if comment in text)


def test_a_file_is_written_whole_and_keeps_its_rights(arm_file: Path) -> None:
    arm_file.chmod(0o640)
    link = arm_file.with_name("link.yaml")
    link.symlink_to(arm_file)
    file = ArmFile(str(link), None)
    shown = file.difference(1, CHANGES)
    assert [line for line in shown.splitlines() if line[0] in "+-"][2:] == [
        "-    ratio: 20",
        "-    direction: 1",
        "-    zero_deg: 90",
        "+    ratio: 20.5",
        "+    direction: -1",
        "+    zero_deg: -12.25",
    ]
    file.write(1, CHANGES)
    file.write(0, {"zero_deg": 181.5})  # the next joint
    joints = load_arm(arm_file).joints
    assert (joints[1].direction, joints[1].ratio, joints[1].zero_deg) == (-1, 20.5, -12.25)
    assert joints[0].zero_deg == 181.5
    assert link.is_symlink() and arm_file.stat().st_mode & 0o777 == 0o640
    assert sorted(path.name for path in arm_file.parent.iterdir()) == sorted([arm_file.name, "link.yaml"])


def test_an_arm_of_the_package_is_copied(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match=r"episode1 comes with rtarm and is not written to: .* -o \./my_episode1\.yaml"):
        ArmFile("episode1", None)
    made = tmp_path / "mine.yaml"
    file = ArmFile("episode1", made)
    assert not made.exists()
    file.write(0, {"direction": -1})
    file.write(1, {"direction": -1})
    assert [joint.direction for joint in load_arm(made).joints] == [-1, -1, 1, 1, 1, 1]
    assert os.access(made, os.W_OK)
    with pytest.raises(Refusal, match="is there already"):
        ArmFile("episode1", made)


def test_what_cannot_be_written_is_refused_before_anything_moves(arm_file: Path, tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="Nothing can be written to the folder"):
        ArmFile(str(arm_file), tmp_path / "nowhere" / "mine.yaml")
    if os.geteuid() != 0:
        arm_file.chmod(0o444)
        with pytest.raises(Refusal, match="is not writable"):
            ArmFile(str(arm_file), None)


def test_a_file_that_somebody_else_changed_is_left_alone(arm_file: Path) -> None:
    file = ArmFile(str(arm_file), None)
    theirs = arm_file.read_text(encoding="utf-8") + "\n# mine\n"
    arm_file.write_text(theirs, encoding="utf-8")
    with pytest.raises(Refusal, match=r"changed by somebody else .* Not written for joint1: direction: -1\."):
        file.write(0, {"direction": -1})
    assert arm_file.read_text(encoding="utf-8") == theirs


def test_values_that_no_arm_may_have_are_not_written(arm_file: Path) -> None:
    before = arm_file.read_bytes()
    file = ArmFile(str(arm_file), None)
    with pytest.raises(Refusal, match="would not be valid with zero_deg: 50000"):
        file.write(0, {"zero_deg": 50_000})
    assert arm_file.read_bytes() == before
    assert list(arm_file.parent.iterdir()) == [arm_file]


def test_a_full_disk_leaves_the_file_as_it_was(arm_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = arm_file.read_bytes()
    file = ArmFile(str(arm_file), None)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rtarm.calibrate.arm_file.os.fsync", full)
    with pytest.raises(Refusal, match=r"No space left .*, so it is as it was\. Not written for joint1: ratio: 3"):
        file.write(0, {"ratio": 3})
    assert arm_file.read_bytes() == before
    assert list(arm_file.parent.iterdir()) == [arm_file]


def test_values_that_several_joints_share_are_not_changed_for_all(arm_file: Path) -> None:
    """joint3 takes its ratio from joint1, by an anchor: changing the one would change the other."""
    text = arm_file.read_text(encoding="utf-8")
    text = text.replace("  - name: joint1 ", "  - &first\n    name: joint1 ", 1)
    at = text.index("  - name: joint3")
    text = text[:at] + text[at:].replace("    ratio: 25\n", "    <<: *first\n", 1)
    arm_file.write_text(text, encoding="utf-8")
    assert [joint.ratio for joint in load_arm(arm_file).joints][:3] == [25, 20, 25]
    file = ArmFile(str(arm_file), None)
    with pytest.raises(Refusal, match=r"shared with other places of the file .* write by hand ratio: 20"):
        file.write(0, {"ratio": 20})
    with pytest.raises(Refusal, match=r"do not stand in its own entry .* write ratio: 20 there by hand"):
        file.write(2, {"ratio": 20})
    file.write(2, {"zero_deg": 84})
    assert [joint.zero_deg for joint in load_arm(arm_file).joints][:3] == [180, 90, 84]
    assert arm_file.read_text(encoding="utf-8") == text.replace("zero_deg: 83", "zero_deg: 84")
    with pytest.raises(Refusal, match=r"ratio of joint1 .* is shared with other places of the file \(an anchor\)"):
        file.require_own_values(0, ["direction", "ratio"])
    with pytest.raises(Refusal, match=r"do not stand in its own entry"):
        file.require_own_values(2, ["ratio"])
    file.require_own_values(1, CHANGES)


@pytest.mark.parametrize(("anchored", "used"), [("ratio: &r 25", "ratio: *r"), ("zero_deg: &r 180", "zero_deg: *r")])
def test_a_value_with_an_anchor_is_refused_before_anything_moves(arm_file: Path, anchored: str, used: str) -> None:
    field = used.partition(":")[0]
    text = arm_file.read_text(encoding="utf-8").replace(anchored.replace("&r ", ""), anchored, 1)
    at = text.index("  - name: joint3")
    text = text[:at] + re.sub(rf"{field}: \d+", used, text[at:], count=1)
    arm_file.write_text(text, encoding="utf-8")
    file = ArmFile(str(arm_file), None)
    for joint in (0, 2):
        with pytest.raises(Refusal, match=f"{field} of joint{joint + 1} .* is shared with other places"):
            file.require_own_values(joint, [field])
    file.require_own_values(1, CHANGES)


def test_what_the_file_cannot_have_is_known_without_writing(arm_file: Path) -> None:
    before = arm_file.read_bytes()
    file = ArmFile(str(arm_file), None)
    file.require_valid(0, CHANGES | {"lower_deg": -170.5})
    with pytest.raises(Refusal, match=r"would not be valid with ratio: 0\.0001 for joint1 \(.*\), so it was left"):
        file.require_valid(0, {"ratio": 0.0001})
    with pytest.raises(Refusal, match="lower_deg of joint1 is 150, above its upper_deg 140"):
        file.require_valid(0, {"lower_deg": 150})
    assert arm_file.read_bytes() == before
    assert list(arm_file.parent.iterdir()) == [arm_file]
