"""Bringing ODrives up: word by word by a script, and in virtual time what depends on when they speak.

Golden bytes are those of other-drives.md (ODrive firmware 0.5.6: its documents, DBC file and CAN test); those of 0.6
follow from can_simple_messages.hpp and odrive_enums.h in odriverobotics/ros_odrive.
"""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from codec_rig import Host
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives.odrive_protocol import ESTIMATES, HEARTBEAT, VERSION
from rtloop.drives.odrive_setup import Firmware, bring_up, disable, error_words
from rtloop.memory.frame_words import STANDARD
from rtloop.service.conversation import DialogueFailed
from rtloop.service.port import Frame
from shm.words import Answer, Mode, Request

ARM = load_arm("odrive6")
HERE = struct.pack("<ff", 2.5, 0.0)
NOWHERE = bytes(8)
VERSION_0_6 = bytes.fromhex("02 04 04 3A 00 06 0A 00")


def heartbeat(error: int, state: int, result: int = 0) -> bytes:
    return struct.pack("<IBB", error, state, result) + bytes(2)


def node(answers: dict[int, list[bytes]], **options: bool) -> Host:
    """Node 1, which tells of each command one after the other, and the last again and again."""
    left = {command: list(told) for command, told in answers.items()}

    def says(question: Any, frames: list[Frame]) -> Frame | None:
        for command, told in left.items():
            frame = Frame(1 << 5 | command, told[0], kind=STANDARD)
            if question.receive(frame, False) is not None:
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
    assert {text[:5] for text in sent if "R" in text} == {"029#R", "020#R"}
    assert (found.reading, found.target) == (2.5, 2.5)


@pytest.mark.parametrize("version", [{}, {VERSION: [bytes.fromhex("02 03 06 18 00 05 06 00")]}])
def test_an_axis_that_does_not_know_yet_where_it_stands_is_told_no_place(version: dict[int, list[bytes]]) -> None:
    """0.5.6 says 0.0 and 0.0 before its first closed loop, which it begins where it stands (control_mode_updated)."""
    sent, found = said(
        {ESTIMATES: [NOWHERE, NOWHERE, NOWHERE, HERE], HEARTBEAT: [heartbeat(0, 1), heartbeat(0, 8)], **version}
    )
    assert [text for text in sent if "R" not in text] == [
        "02B# 03 00 00 00 01 00 00 00",
        "027# 08 00 00 00 00 00 00 00",
    ]
    assert (found.reading, found.target) == (2.5, 2.5)


@pytest.mark.parametrize(
    "known", [{HEARTBEAT: [heartbeat(0, 8)]}, {HEARTBEAT: [heartbeat(0, 1), heartbeat(0, 8)], VERSION: [VERSION_0_6]}]
)
def test_zeros_are_a_place_in_closed_loop_and_with_firmware_0_6(known: dict[int, list[bytes]]) -> None:
    sent, found = said({ESTIMATES: [NOWHERE], **known})
    assert sent.count("02C# 00 00 00 00 00 00 00 00") == 2
    assert (found.reading, found.target) == (0.0, 0.0)


def test_a_board_of_0_6_that_initializes_is_waited_for() -> None:
    beats = [heartbeat(1, 1), heartbeat(1, 1), heartbeat(0, 1), heartbeat(0, 8)]
    sent, found = said({ESTIMATES: [HERE], VERSION: [VERSION_0_6], HEARTBEAT: beats}, clears_protection=False)
    assert "038" not in {text[:3] for text in sent} and found.reading == 2.5


def test_a_closed_loop_stays_closed() -> None:
    sent, _ = said({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 8)]})
    assert "027" not in {text[:3] for text in sent}


def test_an_error_is_cleared_only_when_a_person_asks() -> None:
    answers = {ESTIMATES: [HERE], HEARTBEAT: [heartbeat(1 << 6, 1), heartbeat(0, 1), heartbeat(0, 8)]}
    with pytest.raises(DialogueFailed, match=r"joint1 \(firmware 0\.5\) has an error \(motor\)"):
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
        (
            {ESTIMATES: [HERE], VERSION: [VERSION_0_6], HEARTBEAT: [heartbeat(1 << 9, 1)]},
            r"joint1 \(firmware 0\.6\.10\) keeps its error \(under-voltage of the supply\)",
        ),
        (
            {ESTIMATES: [HERE], VERSION: [VERSION_0_6], HEARTBEAT: [heartbeat(0, 1, 14)]},
            r"does not close its loop \(its procedure result is not calibrated\)",
        ),
        ({ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 1, 14)]}, r"does not close its loop \(its state is 1\)"),
    ],
)
def test_what_is_wrong_is_one_sentence(answers: dict[int, list[bytes]], sentence: str) -> None:
    with pytest.raises(DialogueFailed, match=sentence):
        said(answers)


def test_an_axis_that_stays_closed_is_told() -> None:
    with pytest.raises(DialogueFailed, match="keeps its loop closed"):
        said({HEARTBEAT: [heartbeat(0, 8)]}, disable)
    assert said({HEARTBEAT: [heartbeat(0, 1)]}, disable)[0] == ["027# 01 00 00 00 00 00 00 00"]


def test_errors_are_told_in_words() -> None:
    assert error_words(0, Firmware()) == "none"
    assert error_words(1 << 6 | 1 << 14, Firmware()) == "motor, emergency stop asked over CAN"
    assert error_words(1 << 30, Firmware()) == "0x40000000"
    assert error_words(1 << 6 | 1 << 14, Firmware(0, 6, 10)) == "missing input, over-temperature of the board"
    assert error_words(1 << 30 | 1 << 31, Firmware(0, 6, 10)) == "calibration, 0x80000000"


# --- in virtual time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heartbeat_ms", [10, 350, 1000])
def test_every_heartbeat_that_an_arm_file_may_name_is_waited_for(heartbeat_ms: int) -> None:
    given = load_arm("odrive6").model_dump(mode="json")
    for joint in given["joints"]:
        joint["drive"]["heartbeat_ms"] = heartbeat_ms
    arm = VirtualArm(ArmConfig.model_validate(given))
    assert arm.bring_up(at_most_s=20.0).failure is None
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=1.0)  # the ring still holds what was said last
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release(at_most_s=20.0).failure is None
    arm.close()


@pytest.mark.parametrize("firmware", ["0.5.6", "0.6"])
def test_a_position_is_shown_when_the_drive_has_told_one(firmware: str) -> None:
    """0.5.6 tells none before its loop is closed: an arm whose bring-up is refused then has none to show."""
    arm = VirtualArm("odrive6", odrive_firmware=firmware, start_rad=[0.1] * 6)
    for drive in arm.sim.drives:
        drive.protect(arm.sim.now_ns, "temperature")
    assert "over-temperature" in str(arm.bring_up().failure)
    arm.cycles(100)
    shown = arm.reader.snapshot()["joints"][:6]
    assert np.all((shown["measured_ns"] == 0) == (firmware == "0.5.6"))
    assert arm.clear_fault().failure is None, arm.told
    arm.cycles(10)
    shown = arm.reader.snapshot()["joints"][:6]
    assert np.all(shown["measured_ns"] > 0) and np.all(shown["referenced"] == 1)
    assert shown["measured_position_rad"] == pytest.approx(0.1, abs=1e-3)
    arm.close()


def test_a_drive_that_has_lost_its_power_shows_no_other_place() -> None:
    """It answers zeros then, which are an angle of 0 - zero_deg: what was read last stays, and grows old."""
    arm = VirtualArm.brought_up("odrive6", start_rad=[0.1] * 6)
    arm.cycles(20)
    drive = arm.sim.drives[1]
    drive.power_off(arm.sim.now_ns)
    arm.until(lambda: arm.memory["mode"] == Mode.FAULT, at_most_s=1.0)
    drive.power_on(arm.sim.now_ns)
    arm.cycles(200)
    shown = arm.reader.snapshot()
    joint = shown["joints"][1]
    assert joint["measured_position_rad"] == pytest.approx(0.1, abs=1e-3)
    assert shown["monotonic_ns"] - joint["measured_ns"] > 900_000_000
    assert arm.clear_fault().failure is None, arm.told
    arm.cycles(10)
    assert arm.reader.snapshot()["joints"][1]["measured_position_rad"] == pytest.approx(0.1, abs=1e-3)
    arm.close()


@pytest.mark.parametrize("firmware", ["0.5.6", "0.6"])
def test_a_limp_axis_that_is_led_through_its_zero_is_read_there(firmware: str) -> None:
    """Zeros are a position of one that has told others right before."""
    arm = VirtualArm.brought_up("odrive6", odrive_firmware=firmware)
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release().failure is None
    joint, drive = arm.arm.joints[5], arm.sim.drives[5]
    drive.lead(arm.sim.now_ns, -0.5)
    arm.until(lambda: drive.counted <= 0.0, at_most_s=2.0)
    drive.lead(arm.sim.now_ns, 0.0)
    drive.origin = drive.shaft.position_at(arm.sim.now_ns)
    arm.cycles(100)
    shown = arm.reader.snapshot()
    assert shown["joints"][5]["measured_position_rad"] == pytest.approx(-joint.zero_rad, abs=1e-3)
    assert shown["monotonic_ns"] - shown["joints"][5]["measured_ns"] < 3 * arm.period_ns
    arm.close()
