"""Damiao's bring-up word by word, by a script of the motor's registers and feedback.

Golden bytes are those of other-drives.md (damiao-motor 1.0.6, motor type 4340, motor 1).
"""

import math
import struct
from collections.abc import Iterator
from typing import Any

import pytest
from codec_rig import Host

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop.drives import fields
from rtloop.drives.damiao_setup import bring_up, disable, setpoint_bytes
from rtloop.memory.frame_words import STANDARD
from rtloop.process.initial_state import new_loop
from rtloop.service.conversation import DialogueFailed
from rtloop.service.port import Frame
from shm.words import Unreferenced
from sim.drives.damiao import ACC, CTRL_MODE, DEC, FEEDBACK, PMAX, READ, TIMEOUT, TMAX, VMAX, WRITE

ARM, PLANNING = load_arm("damiao6"), load_arm("damiao6_pv")
ENABLED_HERE = bytes.fromhex("118A3C7FF7FF2823")
"""Enabled, 1.0 rad, 40 and 35 °C."""
LIMP_HERE = bytes.fromhex("018A3C7FF7FF2823")
HERE_RAD = 0x8A3C * 25.0 / 65535 - 12.5


class Motor(Host):
    """Motor 1: registers, and feedback one after the other."""

    def __init__(self, arm: ArmConfig, *feedback: bytes, clears_protection: bool = True, **registers: Any) -> None:
        super().__init__(arm, self.answer, clears_protection=clears_protection)
        self.feedback = list(feedback)
        self.registers = {
            PMAX: struct.pack("<f", 12.5),
            VMAX: struct.pack("<f", 10.0),
            TMAX: struct.pack("<f", 28.0),
            CTRL_MODE: struct.pack("<I", 1 if arm is ARM else 2),
            TIMEOUT: bytes(4),
            ACC: struct.pack("<f", 3.5),
            DEC: struct.pack("<f", -3.5),
        } | registers.pop("held", {})
        self.keeps = registers.pop("keeps", ())
        assert not registers

    def answer(self, question: Any, frames: list[Frame]) -> Frame | None:
        answer = None
        for frame in frames:
            assert frame.kind == STANDARD and len(frame.data) == 8
            for data in self.told_by(frame):
                heard = Frame(0x11, data, kind=STANDARD)
                answer = heard if question.receive(heard, False) is not None else answer
        return answer

    def told_by(self, frame: Frame) -> Iterator[bytes]:
        if frame.id != 0x7FF:
            return
        number, operation, register = struct.unpack("<HBB", frame.data[:4])
        assert number == 1
        if operation == FEEDBACK and self.feedback:
            yield self.feedback.pop(0) if len(self.feedback) > 1 else self.feedback[0]
        if operation == WRITE and register not in self.keeps:
            self.registers[register] = frame.data[4:]
        if operation in (READ, WRITE) and register in self.registers:
            yield frame.data[:4] + self.registers[register]


def commands(sent: list[str]) -> list[str]:
    return [text for text in sent if not text.startswith("7FF")]


HOLD = "001# " + setpoint_bytes(ARM.joints[0].drive, HERE_RAD).hex(" ").upper()
ENABLE = "001# FF FF FF FF FF FF FF FC"


def test_a_limp_motor_is_enabled_between_two_commands_to_stay() -> None:
    motor = Motor(ARM, LIMP_HERE, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    sent, found = motor.hold(bring_up(motor, 0))
    assert commands(sent) == [HOLD, ENABLE, HOLD]
    assert sent[0] == "7FF# 01 00 CC 00 00 00 00 00"
    assert "7FF# 01 00 33 0A 00 00 00 00" in sent  # read mode, golden
    assert not [text for text in sent if text[11:13] in ("55", "AA")]  # nothing written, nothing stored
    assert found.reading == HERE_RAD and found.reason == Unreferenced.REFERENCED
    assert motor.told == []


def test_one_that_plans_its_motion_is_told_where_it_stands() -> None:
    motor = Motor(PLANNING, LIMP_HERE, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    sent, found = motor.hold(bring_up(motor, 0))
    stay = "101# " + struct.pack("<ff", HERE_RAD, 0.25 * PLANNING.joints[0].max_velocity_rad_s).hex(" ").upper()
    assert commands(sent) == [stay, ENABLE, stay]
    assert (found.reading, found.target) == (HERE_RAD, HERE_RAD)


def test_an_enabled_motor_keeps_the_torque_with_which_it_holds() -> None:
    """10 N·m at 200 N·m/rad: it is told a position 0.05 rad further on, where its spring makes just that."""
    code = fields.field(10.0, 28.0, 12)
    holding = ENABLED_HERE[:4] + (0xF << 12 | code).to_bytes(2, "big") + ENABLED_HERE[6:]
    motor = Motor(ARM, holding)
    sent, found = motor.hold(bring_up(motor, 0))
    bent_rad = HERE_RAD + fields.of_field(code, 28.0, 12) / 200.0
    assert commands(sent) == ["001# " + setpoint_bytes(ARM.joints[0].drive, bent_rad).hex(" ").upper()]
    assert found.target == pytest.approx(bent_rad)
    assert found.reading == HERE_RAD


def test_what_differs_is_written_to_volatile_memory_and_said() -> None:
    held = {
        CTRL_MODE: struct.pack("<I", 1),
        ACC: struct.pack("<f", 20.0),
        TIMEOUT: struct.pack("<I", 10_000),
    }
    motor = Motor(PLANNING, LIMP_HERE, LIMP_HERE, ENABLED_HERE, held=held)
    sent, _ = motor.hold(bring_up(motor, 0))
    assert [text for text in sent if text[11:13] == "55"] == [
        "7FF# 01 00 55 0A 02 00 00 00",  # mode 2, golden
        "7FF# 01 00 55 04 00 00 60 40",
        "7FF# 01 00 55 09 00 00 00 00",
    ]
    assert not [text for text in sent if text[11:13] == "AA"]
    (sentence,) = motor.told
    for part in ("joint1", "mode from 1 to 2", "acceleration from 20 to 3.5 rad/s²", "alarm time from 500 ms to none"):
        assert part in sentence
    motor.hold(bring_up(motor, 0))
    assert len(motor.told) == 1  # what is so already is not said


def test_an_error_is_cleared_only_when_a_person_asks() -> None:
    hot = b"\xb1" + LIMP_HERE[1:]
    motor = Motor(ARM, hot, LIMP_HERE, LIMP_HERE, ENABLED_HERE, clears_protection=False)
    with pytest.raises(DialogueFailed, match=r"joint1 has an error \(power stage too hot\)"):
        motor.hold(bring_up(motor, 0))
    motor = Motor(ARM, hot, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    assert commands(motor.hold(bring_up(motor, 0))[0])[0] == "001# FF FF FF FF FF FF FF FB"


OTHER_RANGE = {VMAX: struct.pack("<f", 45.0)}
NO_NUMBER = {PMAX: struct.pack("<f", math.nan)}
OTHER_MODE = {CTRL_MODE: struct.pack("<I", 2)}


@pytest.mark.parametrize(
    ("feedback", "options", "sentence"),
    [
        ([], {}, r"joint1 \(motor_id 0x1\) does not answer on its master_id 0x11: check its power, its ESC_ID"),
        ([b"\x02" + LIMP_HERE[1:]], {}, "does not answer"),  # the answer of motor 2
        ([LIMP_HERE], {"held": OTHER_RANGE}, r"velocity range is ±45 rad/s \(register 22, VMAX\), but the arm .* ±10"),
        ([LIMP_HERE], {"held": NO_NUMBER}, "position range is ±nan rad"),
        ([LIMP_HERE], {"held": {TMAX: b""}}, "stopped answering while its register 23 was read"),
        ([ENABLED_HERE], {"held": OTHER_MODE}, "is enabled in mode 2 .* wants 1 .* switch the drive off"),
        ([LIMP_HERE], {"held": OTHER_MODE, "keeps": (10,)}, "keeps register 10 at 02 00 00 00 although 01 00 00 00"),
        ([LIMP_HERE], {}, r"does not let itself be enabled \(its status is limp\)"),
        ([b"\xc1" + LIMP_HERE[1:]], {}, r"keeps its error \(motor too hot\) after it was cleared"),
        ([b"\x71" + LIMP_HERE[1:]], {}, r"keeps its error \(0x7\)"),
    ],
)
def test_what_is_wrong_is_one_sentence(feedback: list[bytes], options: dict, sentence: str) -> None:
    held = options.get("held", {})
    motor = Motor(ARM, *feedback, **options)
    for register, value in held.items():
        if not value:
            del motor.registers[register]
    with pytest.raises(DialogueFailed, match=sentence):
        motor.hold(bring_up(motor, 0))
    assert motor.told == []


@pytest.mark.parametrize("change", [{"ratio": 1.2}, {"drive": {"encoder": "incremental"}}])
def test_a_joint_whose_angle_the_encoder_does_not_know_is_for_a_person(change: dict) -> None:
    """Behind a gear of 1.2 the 320° of joint1 are more than a turn of the motor."""
    values = [joint.model_dump() for joint in ARM.joints]
    drive = values[0]["drive"] | change.get("drive", {})
    values[0] |= change | {"drive": drive}
    arm = ArmConfig.model_validate(ARM.model_dump() | {"joints": values})
    motor = Motor(arm, LIMP_HERE, LIMP_HERE, ENABLED_HERE, held={CTRL_MODE: struct.pack("<I", 1)})
    assert motor.hold(bring_up(motor, 0))[1].reason == Unreferenced.INCREMENTAL
    assert new_loop(arm, 0, 0)[0]["joints"]["knows_its_angle"][:2].tolist() == [0, 1]


def test_a_motor_that_stays_enabled_is_told() -> None:
    motor = Motor(ARM, ENABLED_HERE)
    with pytest.raises(DialogueFailed, match="stays enabled"):
        motor.hold(disable(ARM, 0))
    motor = Motor(ARM, LIMP_HERE)
    assert commands(motor.hold(disable(ARM, 0))[0]) == ["001# FF FF FF FF FF FF FF FD"]
