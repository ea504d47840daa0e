"""What bench tests have found: kept for these drives alone, and refused in a sentence where it is something else."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from two_buses import divided

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives.power import Marks
from rtloop.kept import commissioned
from rtloop.kept.commissioned import Commissioned, NotReadable, PowerProof
from rtloop.kept.reference_store import NotSaved, channel_of, keep_power_marks, path_of, power_marks

PROOFS = st.sampled_from([None, PowerProof.FLAG, PowerProof.CANARY, PowerProof.NONE])
"""What these drives may have: their encoders do not know their angles."""
TRUTHS = st.none() | st.booleans()


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ArmConfig:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return load_arm("episode1", overrides={"bus": {"channel": "/dev/ttyACM0"}})


def found_of(arm: ArmConfig, joint: int, **values: Any) -> Commissioned:
    drive = arm.joints[joint].drive
    return Commissioned(
        **{
            "channel": channel_of(arm),
            "family": drive.family,
            "number": drive.number,
            "firmware": "2.0.0",
            "when": "2026-01-31T12:00:00Z",
            **values,
        }
    )


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    proof=PROOFS,
    words=st.text(),
    truths=st.tuples(TRUTHS, TRUTHS, TRUTHS, TRUTHS),
)
def test_what_is_kept_is_read_again(
    arm: ArmConfig, proof: PowerProof | None, words: str, truths: tuple[bool | None, ...]
) -> None:
    names = ("fast_targets", "reports", "retargets", "brakes_in_silence")
    found = found_of(arm, 2, power_proof=proof, power=words, **dict(zip(names, truths, strict=True)))
    commissioned.save(arm, 2, found)
    commissioned.save(arm, 4, found_of(arm, 4))
    assert commissioned.load(arm) == {2: found, 4: found_of(arm, 4)}


def test_it_is_of_these_drives_alone(arm: ArmConfig) -> None:
    commissioned.save(arm, 0, found_of(arm, 0))
    elsewhere = load_arm("episode1", overrides={"bus": {"channel": "/dev/ttyACM1"}})
    assert commissioned.load(elsewhere) == {}
    commissioned.save(elsewhere, 0, found_of(elsewhere, 0, reports=True))
    assert commissioned.load(arm) == {0: found_of(arm, 0)}
    drive = arm.joints[0].drive.model_copy(update={"address": 9})
    joints = [arm.joints[0].model_copy(update={"drive": drive}), *arm.joints[1:]]
    other = arm.model_copy(update={"joints": joints})
    assert commissioned.load(other) == {}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]x",
        "null",
        "[1]",
        '{"joint1": 1}',
        "\xff\xfe",
        "{" * 3,
        '{"slcan:x": 1}',
        '{"slcan:x": {"joint1": 1}}',
        pytest.param("[" * 100_000, id="nested without end"),
    ],
)
def test_a_file_that_says_something_else_is_refused_in_a_sentence(arm: ArmConfig, text: str) -> None:
    commissioned.save(arm, 0, found_of(arm, 0))
    path = path_of(arm.name, "commissioned")
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(NotReadable, match="none of it is believed: remove that file"):
        commissioned.load(arm)
    with pytest.raises(NotReadable):
        commissioned.save(arm, 1, found_of(arm, 1))
    assert path.read_bytes() == text.encode("latin-1")


@pytest.mark.parametrize(
    ("field", "value"),
    [("number", True), ("number", "1"), ("reports", 1), ("power_proof", 1), ("firmware", None)],
)
def test_a_value_of_another_kind_is_refused(arm: ArmConfig, field: str, value: Any) -> None:
    commissioned.save(arm, 0, found_of(arm, 0))
    path = path_of(arm.name, "commissioned")
    kept = json.loads(path.read_text())
    kept[channel_of(arm)]["joint1"][field] = value
    path.write_text(json.dumps(kept))
    with pytest.raises(NotReadable):
        commissioned.load(arm)


def test_a_record_of_another_version_is_read_as_far_as_it_says_the_same(arm: ArmConfig) -> None:
    commissioned.save(arm, 0, found_of(arm, 0, power_proof=PowerProof.FLAG))
    path = path_of(arm.name, "commissioned")
    kept = json.loads(path.read_text())
    record = kept[channel_of(arm)]["joint1"]
    record["more"] = {"of": 1}
    del record["brakes_in_silence"]
    path.write_text(json.dumps(kept))
    assert commissioned.load(arm) == {0: found_of(arm, 0, power_proof=PowerProof.FLAG)}
    record["power_proof"] = "surely"
    path.write_text(json.dumps(kept))
    assert commissioned.load(arm) == {0: found_of(arm, 0, power_proof=PowerProof.NONE)}


def test_nothing_is_kept_of_a_simulated_arm(arm: ArmConfig) -> None:
    simulated = load_arm("episode1", overrides={"bus": {"channel": "/dev/pts/7"}})
    commissioned.save(simulated, 0, found_of(simulated, 0))
    assert commissioned.load(simulated) == {} and not path_of(arm.name, "commissioned").exists()


def test_what_cannot_be_kept_is_said(arm: ArmConfig, tmp_path: Path) -> None:
    (tmp_path / "rtarm").write_text("in the way")
    assert commissioned.load(arm) == {}
    with pytest.raises(NotSaved, match="nothing is unlocked by it"):
        commissioned.save(arm, 0, found_of(arm, 0))


@pytest.mark.parametrize("firmware", ["", "9.9.9"])
def test_a_drive_that_proves_nothing_is_not_believed_because_it_was_asked_something_else(
    arm: ArmConfig, firmware: str
) -> None:
    before = found_of(arm, 0, power_proof=PowerProof.NONE, power="its angle was kept")
    now = replace(before, firmware=firmware, power_proof=None, power="")
    assert (now.after(before).power_proof, now.after(before).power) == (PowerProof.NONE, before.power)
    assert replace(now, power_proof=PowerProof.CANARY).after(before).power_proof is PowerProof.CANARY


def test_what_was_not_tried_again_stays_with_the_same_firmware(arm: ArmConfig) -> None:
    before = found_of(arm, 0, reports=False, power_proof=PowerProof.FLAG, power="seen 1")
    now = found_of(arm, 0, reports=True, brakes_in_silence=True)
    assert now.after(before) == replace(now, power_proof=PowerProof.FLAG, power="seen 1")
    assert now.after(before).heals and not now.heals
    assert now.after(replace(before, firmware="1.2.5")) == now


def test_an_arm_goes_on_by_itself_where_each_drive_was_found_to_allow_it(arm: ArmConfig) -> None:
    assert not commissioned.heals(arm)
    for joint in range(6):
        assert not commissioned.heals(arm)
        commissioned.save(arm, joint, found_of(arm, joint, power_proof=PowerProof.CANARY, brakes_in_silence=True))
    assert commissioned.heals(arm)
    stays = {"power_proof": PowerProof.CANARY, "brakes_in_silence": True}
    for withholds in ({"power_proof": PowerProof.NONE}, {"brakes_in_silence": False}, {"retargets": False}):
        commissioned.save(arm, 3, found_of(arm, 3, **{**stays, **withholds}))
        assert not commissioned.heals(arm)
    commissioned.save(arm, 3, found_of(arm, 3, **stays, retargets=True))
    assert commissioned.heals(arm)


@pytest.mark.parametrize(
    ("setting", "asked", "found", "says"),
    [
        ("position_command", "FC", "fast_targets", "not to take targets of FC for absolute ones"),
        ("positions", "reported", "reports", "not to report its position as it was told"),
    ],
)
def test_an_arm_that_asks_of_a_drive_what_it_was_found_not_to_do_is_refused(
    arm: ArmConfig, setting: str, asked: str, found: str, says: str
) -> None:
    settings_asked = [f"bus.channel={arm.bus.channel}", f"bus.{setting}={asked}"]
    asks = load_arm("episode1", overrides={"bus": {"channel": arm.bus.channel, setting: asked}})
    for does in (None, True):
        commissioned.save(arm, 2, found_of(arm, 2, **{found: does}))
        assert commissioned.withheld(asks) == ""
    commissioned.save(arm, 2, found_of(arm, 2, **{found: False}))
    assert commissioned.withheld(arm) == ""
    command = [sys.executable, "-m", "rtloop", "episode1", *[word for one in settings_asked for word in ("--set", one)]]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert f"joint3 was found at the bench (2026-01-31T12:00:00Z, firmware 2.0.0) {says}" in refused.stderr
    assert f"set bus.{setting} to" in refused.stderr and "`rtarm commission`" in refused.stderr


def test_a_drive_that_was_found_to_prove_no_power_gets_no_mark(arm: ArmConfig) -> None:
    commissioned.save(arm, 0, found_of(arm, 0, power_proof=PowerProof.FLAG))
    commissioned.save(arm, 1, found_of(arm, 1, power_proof=PowerProof.NONE))
    marks = Marks({0: "10001", 1: "10001", 2: "10001"}, unproven=commissioned.unproven(arm, pytest.fail))
    marks[1] = "10002"
    assert [marks[joint] for joint in range(3)] == ["10001", None, "10001"]


def test_a_record_that_cannot_be_read_unlocks_nothing_lets_marks_prove_nothing_and_is_told(arm: ArmConfig) -> None:
    path = path_of(arm.name, "commissioned")
    path.parent.mkdir(parents=True)
    path.write_text("{", encoding="utf-8")
    keep_power_marks(arm, {0: "10001", 3: "10002"})
    told: list[str] = []
    marks = commissioned.marks(arm, told.append)
    assert not commissioned.heals(arm) and not any(marks.takes(joint) for joint in range(6))
    assert power_marks(arm) == {0: "10001", 3: "10002"} and marks[0] is None and marks.known(0) == "10001"
    assert len(told) == 1 and "none of it is believed: remove that file" in told[0]


def test_an_encoder_that_was_found_not_to_be_absolute_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    arm = load_arm("damiao6", overrides={"bus": {"channel": "/dev/ttyACM0"}})
    drive = arm.joints[1].drive
    found = Commissioned(channel_of(arm), drive.family, drive.number, "", "2026-01-31T12:00:00Z", PowerProof.ABSOLUTE)
    commissioned.save(arm, 1, found)
    assert commissioned.withheld(arm) == ""
    commissioned.save(arm, 1, replace(found, power_proof=PowerProof.NONE, power="its angle was kept, 30.0° away"))
    sentence = commissioned.withheld(arm)
    assert "joint2 is absolute in the arm file" in sentence and "was not (its angle was kept, 30.0° away)" in sentence
    counts = arm.joints[1].model_copy(update={"drive": drive.model_copy(update={"encoder": "incremental"})})
    assert commissioned.withheld(arm.model_copy(update={"joints": [arm.joints[0], counts, *arm.joints[2:]]})) == ""


def test_what_is_kept_of_a_drive_does_not_follow_its_joint_to_another_bus() -> None:
    """The same numbers mean other drives there."""
    arm = divided("episode1")
    buses = [joint.bus for joint in reversed(arm.joints)]
    exchanged = [joint.model_copy(update={"bus": bus}) for joint, bus in zip(arm.joints, buses, strict=True)]
    assert channel_of(arm) != channel_of(arm.model_copy(update={"joints": exchanged}))
    assert channel_of(load_arm("episode1")) == "slcan:/dev/ttyUSB1"
