"""VESC frames beyond `tests/golden/vesc.yaml`: turns, what is asked again, when a stop would enable a drive."""

import math

import pytest
from codec_rig import Rig, frame_of, word
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.drives import vesc
from rtloop.drives import vesc_protocol as protocol
from rtloop.drives.vesc_setup import fault_words, released_words
from rtloop.memory import status
from shm.words import Unreferenced

relaxed = settings(deadline=None)
FAULT = "00000801# 81 00 32 00 00 80 00"
RELEASED = "00000801# 81 00 32 00 20 00 00"


@relaxed
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_place_in_any_turn_is_the_same_place_in_the_wanted_one(turns: float, to: float) -> None:
    within, nearest = protocol.within_a_turn(turns), protocol.nearest(turns, to)
    assert 0.0 <= within <= 1.0
    assert abs(nearest - to) <= 0.5 + 1e-9
    for found in (within, nearest):
        assert math.remainder(found - turns, 1.0) == pytest.approx(0.0, abs=1e-9)
    assert (vesc.within_a_turn(turns), vesc.nearest(turns, to)) == (within, nearest)


@relaxed
@given(st.floats(-170.0, 170.0))
def test_what_a_joint_is_told_it_tells(position_deg: float) -> None:
    """A command is finer than a status, which is cut to a fiftieth of a degree."""
    rig = Rig.named("vesc").stands(math.radians(position_deg))
    (said,) = rig.sends("lead")
    millionths = int.from_bytes(bytes.fromhex(said.partition("#")[2]), "big", signed=True)
    heard = rig.hears(f"00001001# 01 2C 01 2C 00 00 {(millionths // 20_000).to_bytes(2, 'big').hex(' ')}")
    assert math.degrees(heard["position_rad"]) == pytest.approx(position_deg, abs=0.0201)


def test_a_bad_answer_is_asked_for_again_before_the_other_question() -> None:
    for question, answer in ((FAULT, "00 80 00 05"), (RELEASED, "20 00 00 02")):
        rig = Rig.named("vesc").stands(0.0)
        rig.hears(f"00000881# 01 01 32 00 {answer}")
        for cycle in (10, 11):
            rig.record["timing"]["cycle"] = cycle
            assert rig.sends("ask_status") == [question]
        rig.hears(f"00000881# 01 01 32 00 {answer}")
        assert rig.axis["drive"]["is_disabled"] == 1, "it has let go"
        assert rig.sends("lead") and rig.axis["drive"]["is_disabled"] == 0


def test_a_stop_is_said_to_a_drive_that_is_known_to_hold_alone() -> None:
    def stands() -> Rig:
        rig = Rig.named("vesc").stands(math.radians(51.0))
        rig.axis["measured"]["time_ns"] = rig.record["timing"]["now_ns"]
        rig.axis["reference"]["unreferenced_reason"] = int(Unreferenced.REFERENCED)
        rig.axis["measured"]["readings"] = 1
        return rig

    assert stands().sends("stop") == ["00000401# 03 0A 32 C0"]
    limp = stands()
    limp.axis["drive"]["is_disabled"] = 1
    assert limp.sends("stop") == []
    for reason in (Unreferenced.SILENT, Unreferenced.POWER_LOST):
        lost = stands()
        lost.axis["reference"]["unreferenced_reason"] = int(reason)
        assert lost.sends("stop") == []


def test_what_conversations_say_enables_and_lets_go() -> None:
    rig = Rig.named("vesc")
    for text, disabled in (
        ("00000101# 00 00 00 00", 1),
        ("00000801# 81 00 32 00 00 80 00", 1),
        ("00000401# 00 00 00 00", 0),
    ):
        frame, _ = frame_of(text)
        vesc.note_what_was_said(rig.record, 0, frame.id, word(frame.data))
        assert rig.axis["drive"]["is_disabled"] == disabled
        assert not vesc.is_stop(rig.record, 0, frame.id, word(frame.data))
    rig.axis["drive"]["is_disabled"] = 1
    assert rig.hears("00000881# 01 01 32 00 00 80 00 00")["status"] & status.ENABLED == 0


def test_faults_and_what_lets_go_in_words() -> None:
    assert (fault_words(0), fault_words(5), fault_words(99)) == ("", "over-temperature of the power stage", "fault 99")
    assert [released_words(value) for value in (0, 1, 2, 3)] == [
        "",
        "its time-out",
        "its kill switch",
        "its kill switch",
    ]
