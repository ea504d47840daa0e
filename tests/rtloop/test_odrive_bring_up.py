"""Bringing ODrives up: word by word by a script, and in virtual time what depends on when they speak.

Golden bytes are those of other-drives.md (ODrive firmware 0.5.6: its documents, DBC file and CAN test).
"""

import math
import struct
from collections.abc import Callable
from typing import Any

import pytest
from codec_rig import Host
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.conversation import TalkFailed
from rtloop.drives.odrive_setup import ESTIMATES, HEARTBEAT, bring_up, error_words, let_go
from rtloop.port import Frame
from rtloop.wire.frame_words import STANDARD
from shm.words import Answer, Mode, Request

ARM = load_arm("odrive6")
HERE = struct.pack("<ff", 2.5, 0.0)


def heartbeat(error: int, state: int) -> bytes:
    return struct.pack("<IB", error, state) + bytes(3)


def node(answers: dict[int, list[bytes]], **options: bool) -> Host:
    """Node 1, which tells of each command one after the other, and the last again and again."""
    left = {command: list(told) for command, told in answers.items()}

    def says(question: Any, frames: list[Frame]) -> Frame | None:
        for command, told in left.items():
            frame = Frame(1 << 5 | command, told[0], kind=STANDARD)
            if question.hear(frame, False) is not None:
                left[command] = told[1:] or told
                return frame
        return None

    return Host(ARM, says, **options)


def said(
    answers: dict[int, list[bytes]], talk: Callable[..., Any] = bring_up, **options: bool
) -> tuple[list[str], Any]:
    """What the node is told, and how that ends."""
    host = node(answers, **options)
    return host.hold(talk(host if talk is bring_up else ARM, 0))


def test_an_idle_axis_closes_its_loop_where_it_stands() -> None:
    """Modes 02B# 03 00 00 00 01 00 00 00 and closed loop 027# 08 00 …, golden; the position goes before both."""
    sent, found = said({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 1), heartbeat(0, 8)]})
    position = "02C# 00 00 20 40 00 00 00 00"
    assert [text for text in sent if "R" not in text] == [
        position,
        position,
        "02B# 03 00 00 00 01 00 00 00",
        "027# 08 00 00 00 00 00 00 00",
    ]
    assert {text[:5] for text in sent if "R" in text} == {"029#R"}
    assert (found.reading, found.target) == (2.5, 2.5)


def test_a_closed_loop_stays_closed() -> None:
    sent, _ = said({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 8)]})
    assert "027" not in {text[:3] for text in sent}


def test_an_error_is_cleared_only_when_a_person_asks() -> None:
    answers = {ESTIMATES: [HERE], HEARTBEAT: [heartbeat(1 << 6, 1), heartbeat(0, 1), heartbeat(0, 8)]}
    with pytest.raises(TalkFailed, match=r"joint1 has an error \(motor\)"):
        said(answers, clears_protection=False)
    assert "038# 00 00 00 00 00 00 00 00" in said(answers)[0]


@pytest.mark.parametrize(
    ("answers", "sentence"),
    [
        ({}, "does not answer: check its power, its node"),
        ({ESTIMATES: [HERE]}, "sends no heartbeat"),
        ({ESTIMATES: [struct.pack("<ff", math.nan, 0.0)], HEARTBEAT: [heartbeat(0, 1)]}, "position is no number"),
        ({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 1)]}, r"does not close its loop \(its state is 1\)"),
        ({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 1), heartbeat(1, 1)]}, "its error is invalid state"),
        ({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(1 << 18, 1)]}, r"keeps its error \(over-temperature\)"),
    ],
)
def test_what_is_wrong_is_one_sentence(answers: dict[int, list[bytes]], sentence: str) -> None:
    with pytest.raises(TalkFailed, match=sentence):
        said(answers)


def test_an_axis_that_stays_closed_is_told() -> None:
    with pytest.raises(TalkFailed, match="keeps its loop closed"):
        said({HEARTBEAT: [heartbeat(0, 8)]}, let_go)
    assert said({HEARTBEAT: [heartbeat(0, 1)]}, let_go)[0] == ["027# 01 00 00 00 00 00 00 00"]


def test_errors_are_told_in_words() -> None:
    assert error_words(0) == "none"
    assert error_words(1 << 6 | 1 << 14) == "motor, emergency stop asked over CAN"
    assert error_words(1 << 30) == "0x40000000"


# --- in virtual time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heartbeat_ms", [10, 350, 1000])
def test_every_heartbeat_that_an_arm_file_may_name_is_waited_for(heartbeat_ms: int) -> None:
    given = load_arm("odrive6").model_dump(mode="json")
    for joint in given["joints"]:
        joint["drive"]["heartbeat_ms"] = heartbeat_ms
    arm = VirtualArm(ArmConfig.model_validate(given))
    assert arm.bring_up(at_most_s=20.0).failure is None
    arm.until(lambda: arm.core["mode"] == Mode.HOLDING, at_most_s=1.0)  # the ring still holds what was said last
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release(at_most_s=20.0).failure is None
    arm.close()
