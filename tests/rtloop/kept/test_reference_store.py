"""Where the drives counted when rtarm was ended: kept, compared once, believed with care."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.kept import reference_store
from rtloop.process.initial_state import new_loop
from rtloop.safety.absolute_encoder import absolute_makes_good
from rtloop.safety.references import outlives_a_clear
from shm.words import Answer, Fault, Mode, Request, Unreferenced

COUNTS = st.dictionaries(st.integers(0, 5), st.integers(-(2**40), 2**40))


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return load_arm("episode1")


@settings(deadline=None)  # files, on whatever disk
@given(counts=COUNTS)
def test_what_is_kept_is_there_until_it_is_forgotten(tmp_path_factory, counts):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp()))
        arm = load_arm("episode1")
        reference_store.save(arm, counts)
        assert reference_store.counts_before(arm) == counts
        assert reference_store.counts_before(arm) == counts  # a start that failed has compared nothing
        reference_store.forget_counts(arm)
        assert reference_store.counts_before(arm) == {}


REASONS = st.sampled_from(sorted(reference_store.OUTLIVES_THE_PROCESS))
FROM_NOWHERE = (Unreferenced.POWER_LOST, Unreferenced.NOT_HOMED)


@pytest.mark.parametrize(
    ("knows_its_angle", "forgiven"),
    [(0, set()), (1, {Unreferenced.POWER_LOST, Unreferenced.SILENT, Unreferenced.MOVED})],
)
def test_what_no_clear_forgives_no_restart_forgives(knows_its_angle, forgiven):
    """Beside one reason that every restart finds anew; and whatever an absolute encoder makes good."""
    loop = new_loop(load_arm("episode1"), 0, 0)
    loop[0]["joints"][0]["knows_its_angle"] = knows_its_angle
    outlive = set()
    for reason in Unreferenced:
        loop[0]["axes"][0]["reference"]["unreferenced_reason"] = reason
        if outlives_a_clear(loop[0], 0):
            outlive.add(reason)
    assert outlive - {Unreferenced.INCREMENTAL} == reference_store.OUTLIVES_THE_PROCESS - forgiven
    assert Unreferenced.INCREMENTAL in outlive
    assert {reason for reason in Unreferenced if absolute_makes_good(reason)} == {
        Unreferenced.POWER_LOST,
        Unreferenced.SILENT,
        Unreferenced.MOVED,
    }


@settings(deadline=None)
@given(said=st.lists(st.tuples(st.integers(0, 5), st.none() | REASONS), max_size=12))
def test_a_lost_reference_is_kept_until_it_is_found_again(tmp_path_factory, said):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        arm = load_arm("episode1")
        for joint, reason in said:
            reference_store.keep_lost_reference(arm, joint, reason)
            reference_store.forget_counts(arm)  # a start forgets where the arm stood, and no lost reference
        lost = {}
        for joint, reason in said:
            if reason is None:
                lost.pop(joint, None)
            elif lost.get(joint) not in FROM_NOWHERE or reason in FROM_NOWHERE:
                lost[joint] = reason
        assert reference_store.lost_references(arm) == lost
        left = [path.name for path in reference_store.path_of(arm.name).parent.glob("*")]
        assert left == (["episode1.unreferenced"] if lost else [])


def test_a_joint_whose_angle_a_person_said_is_no_more_believed_after_it_was_silent(arm):
    reference_store.keep_lost_reference(
        arm, 2, Unreferenced.NOT_HOMED
    )  # `rtarm reference joint3=30`: this process knows it
    reference_store.keep_lost_reference(arm, 2, Unreferenced.SILENT)
    assert reference_store.lost_references(arm) == {
        2: Unreferenced.NOT_HOMED
    }  # `rtarm reference joint3` would believe its count


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "7",
        "joint2",
        '{"joint2": 3}',
        '{"joint2": ["SILENT"]}',
        '{"joint2": "SILENTLY"}',
        '{"joint2": "REFERENCED"}',
        "\0\xff",
    ],
)
def test_a_file_that_says_something_else_may_say_it_of_every_joint(arm, text):
    path = reference_store.path_of(arm.name).with_suffix(".unreferenced")
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="latin-1")
    told = []
    assert reference_store.lost_references(arm, told.append) == dict.fromkeys(range(6), Unreferenced.NOT_HOMED)
    assert len(told) == 1 and f"could not be read in {path} (it says something else), so each counts" in told[0]
    reference_store.keep_lost_reference(arm, 2, None)
    assert reference_store.lost_references(arm) == dict.fromkeys((0, 1, 3, 4, 5), Unreferenced.NOT_HOMED)


def test_a_file_that_cannot_be_read_may_say_it_of_every_joint(arm):
    reference_store.path_of(arm.name).with_suffix(".unreferenced").mkdir(parents=True)  # root reads any file
    assert reference_store.lost_references(arm) == dict.fromkeys(range(6), Unreferenced.NOT_HOMED)
    with pytest.raises(
        reference_store.NotSaved, match=r"reference of joint4 could not be kept in .* see that the file can be"
    ):
        reference_store.keep_lost_reference(arm, 3, None)
    left = [path.suffix for path in reference_store.path_of(arm.name).parent.iterdir()]
    assert left == [".unreferenced"]


def test_a_lost_reference_that_cannot_be_kept_is_a_sentence(arm, tmp_path):
    (tmp_path / "rtarm").write_text("")
    with pytest.raises(reference_store.NotSaved, match="so the next start would believe what is not true"):
        reference_store.keep_lost_reference(arm, 2, Unreferenced.SILENT)


def test_a_user_without_a_home_is_told(arm, monkeypatch):
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", lambda: Path("~nobody-of-this-name").expanduser())
    with pytest.raises(reference_store.NotSaved, match="set XDG_STATE_HOME"):
        reference_store.keep_lost_reference(arm, 2, Unreferenced.NOT_HOMED)
    with pytest.raises(reference_store.NotSaved, match="set XDG_STATE_HOME"):
        reference_store.save(arm, {0: 7})
    reference_store.forget_counts(arm)
    assert (reference_store.counts_before(arm), reference_store.lost_references(arm)) == ({}, {})


def test_another_adapter_is_another_arm(arm):
    reference_store.save(arm, {0: 7})
    assert reference_store.counts_before(load_arm("episode1", overrides={"bus": {"channel": "/dev/ttyUSB7"}})) == {}


def test_nothing_is_kept_of_a_simulated_arm(arm):
    simulated = load_arm("episode1", overrides={"bus": {"channel": "/dev/pts/3"}})
    reference_store.save(simulated, {0: 7})
    reference_store.save(load_arm("mock"), {0: 7})
    reference_store.keep_lost_reference(simulated, 2, Unreferenced.NOT_HOMED)
    assert not reference_store.path_of(arm.name).parent.exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "7",
        "null",
        '{"channel": 7}',
        '{"channel": "slcan:/dev/ttyUSB1", "counts": [1]}',
        "\0\xff",
        "[" * 200_000,
    ],
    ids=str.__len__,
)
def test_what_cannot_be_read_says_nothing(arm, text):
    path = reference_store.path_of(arm.name)
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="latin-1")
    assert reference_store.counts_before(arm) == {}
    reference_store.forget_counts(arm)
    assert not path.exists()


def test_counts_that_are_no_numbers_say_nothing(arm):
    path = reference_store.path_of(arm.name)
    path.parent.mkdir(parents=True)
    path.write_text(
        json.dumps(
            {"channel": "slcan:/dev/ttyUSB1", "counts": {"joint1": "7", "joint2": 8, "moon": 9, "joint3": 10**400}}
        )
    )
    assert reference_store.counts_before(arm) == {1: 8}


def test_a_file_in_the_way_is_a_sentence(arm, tmp_path):
    (tmp_path / "rtarm").write_text("")
    with pytest.raises(reference_store.NotSaved, match="so the next start cannot tell whether it was moved"):
        reference_store.save(arm, {0: 7})


def test_a_joint_that_does_not_stand_where_it_stood_is_not_believed():
    arm = VirtualArm(start_rad=np.radians((10.0, 20.0, 30.0, 40.0, 50.0, 60.0)))
    config = arm.arm.joints
    stood = {}
    for joint, off_deg in ((0, 0.0), (1, 4.0), (2, -1.0)):
        angle_rad = math.radians((joint + 1) * 10.0 + off_deg)
        counts_per_rad = config[joint].direction * config[joint].encoder_counts_per_rad
        stood[joint] = round((angle_rad + config[joint].zero_rad) * counts_per_rad)
    arm.bring_up(counts_before=stood)
    axes = arm.loop[0]["axes"]
    assert axes["reference"]["referenced"][:6].tolist() == [1, 0, 1, 1, 1, 1]
    assert axes["reference"]["unreferenced_reason"][1] == Unreferenced.MOVED
    assert any("joint2 is not referenced: it stands -4.00° from where it stood" in sentence for sentence in arm.told)
    arm.request(Request.CLEAR_FAULT)
    assert arm.bring_up().failure is None  # as after a fault: it says nothing new of the joint
    assert axes["reference"]["unreferenced_reason"][1] == Unreferenced.MOVED
    assert arm.ask(Request.REFERENCE, joint_mask=0b10, value=math.nan) == Answer.DONE
    assert arm.reference().failure is None
    assert (arm.memory["mode"], arm.memory["fault"]["code"], axes["reference"]["referenced"][1]) == (
        Mode.HOLDING,
        Fault.NONE,
        1,
    )
    assert abs(axes["measured"]["position_rad"][1] - math.radians(20.0)) < 0.001
    arm.close()
