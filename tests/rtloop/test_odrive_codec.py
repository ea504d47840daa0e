"""ODrive's CANSimple frames to numbers and back: golden bytes, properties, hostile bytes.

Golden bytes are those of other-drives.md (ODrive firmware 0.5.6: its documents, DBC file and CAN test).
"""

import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from config.loader import load_arm
from rtloop import status as status_bits
from rtloop.beginning import new_loop
from rtloop.conversation import TalkFailed
from rtloop.drives import odrive, words
from rtloop.drives.odrive_setup import BUS, CURRENT, ESTIMATES, HEARTBEAT, bring_up, error_words, let_go
from rtloop.port import Frame
from rtloop.wire.frame_words import REMOTE, STANDARD
from shm import layout

NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=32)
ARM = load_arm("odrive6")


def word(data: bytes) -> int:
    """Data bytes as the cycle holds them."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


@pytest.fixture
def cycle() -> SimpleNamespace:
    """The state that codecs work on."""
    return SimpleNamespace(loop=new_loop(ARM, 0, 0), shared=np.zeros(1, layout.STATE))


def hear(cycle: SimpleNamespace, joint: int, command: int, data: bytes) -> np.void:
    """What a node says; the joint's axis."""
    identifier = (joint + 1) << 5 | command
    odrive.hear(cycle.loop[0], joint, cycle.shared[0], identifier, STANDARD, len(data), word(data), 5)
    return cycle.loop[0]["axes"][joint]


def test_a_position_is_told_as_in_the_can_guide() -> None:
    """Node 3 to 1 rev: 06C# 00 00 80 3F 00 00 00 00."""
    assert odrive.input_position(1.0, 0.0) == word(bytes.fromhex("0000803F00000000"))
    assert Frame(3 << 5 | 0x0C, b"").id == 0x06C


@settings(deadline=None)  # some of it is compiled on the way
@given(turns=NUMBERS, turns_s=st.floats(-40.0, 40.0))
def test_positions_and_velocities_are_packed_as_struct_does(turns: float, turns_s: float) -> None:
    ahead = min(max(round(turns_s * 1000.0), -32_767), 32_767)
    assert odrive.input_position.py_func(turns, turns_s) & (1 << 64) - 1 == int.from_bytes(
        struct.pack("<fhh", turns, ahead, 0), "little"
    )


@settings(deadline=None)
@given(first=NUMBERS, second=NUMBERS)
def test_floats_come_back_as_struct_packs_them(first: float, second: float) -> None:
    data = word(struct.pack("<ff", first, second))
    assert (words.float_at.py_func(data, 0), words.float_at.py_func(data, 4)) == (first, second)
    assert words.float_word.py_func(first) == int.from_bytes(struct.pack("<f", first), "little")


@settings(deadline=None)
@given(number=st.integers(-(2**63), 2**63 - 1), at=st.integers(0, 7), size=st.integers(1, 4))
@example(number=0x80, at=0, size=1)
@example(number=0x7F_8000_0000, at=0, size=4)
def test_whole_numbers_are_read_as_int_from_bytes_does(number: int, at: int, size: int) -> None:
    size = min(size, 8 - at)
    part = number.to_bytes(8, "little", signed=True)[at : at + size]
    assert words.unsigned.py_func(number, at, size) == int.from_bytes(part, "little")
    assert words.signed.py_func(number, at, size) == int.from_bytes(part, "little", signed=True)
    assert words.swapped.py_func(number, size) == int.from_bytes(
        number.to_bytes(8, "little", signed=True)[:size], "big"
    )


def test_estimates_are_heard_as_in_the_can_guide(cycle: SimpleNamespace) -> None:
    """Node 2, 0.25 rev and -0.5 rev/s: 049# 00 00 80 3E 00 00 00 BF."""
    config = ARM.joints[1]
    axis = hear(cycle, 1, ESTIMATES, bytes.fromhex("0000803E000000BF"))
    rad_of_turn = config.direction * 2.0 * math.pi / config.ratio
    assert axis["heard"] == 1
    assert axis["heard_rad"] == pytest.approx(0.25 * rad_of_turn - config.zero_rad, abs=1e-12)
    assert axis["told_velocity_rad_s"] == pytest.approx(-0.5 * rad_of_turn, abs=1e-12)


@pytest.mark.parametrize(
    ("error", "state", "expected"),
    [
        (0, 8, status_bits.ENABLED),
        (0, 1, 0),
        (1 << 6, 1, status_bits.PROTECTED),
        (1 << 8, 1, status_bits.PROTECTED | status_bits.ENCODER),
        (1 << 18, 8, status_bits.ENABLED | status_bits.PROTECTED | status_bits.OVER_TEMPERATURE),
        (1 << 11, 1, status_bits.PROTECTED | status_bits.COMMUNICATION),
        (0xFFFFFFFF, 255, status_bits.PROTECTED | 0xE00),
    ],
)
def test_heartbeats_tell_the_status(cycle: SimpleNamespace, error: int, state: int, expected: int) -> None:
    axis = hear(cycle, 0, HEARTBEAT, struct.pack("<IB", error, state) + b"\x01\x02\x03")
    assert axis["status"] == expected | status_bits.ANSWERED


def test_voltage_and_torque_are_heard(cycle: SimpleNamespace) -> None:
    axis = hear(cycle, 4, BUS, struct.pack("<ff", 24.5, 1.0))
    assert axis["voltage_v"] == pytest.approx(24.5)
    axis = hear(cycle, 4, CURRENT, struct.pack("<ff", 9.0, -2.0))  # set-point and measured
    assert axis["effort_nm"] == pytest.approx(-2.0 * 0.08 * ARM.joints[4].ratio)


@settings(deadline=None, max_examples=300)
@given(command=st.integers(0, 31), data=st.binary(max_size=8))
def test_no_bytes_make_a_reading_that_is_no_number(command: int, data: bytes) -> None:
    cycle = SimpleNamespace(loop=new_loop(ARM, 0, 0), shared=np.zeros(1, layout.STATE))
    axis = hear(cycle, 2, command, data)
    if len(data) != 8 or command != ESTIMATES or not all(map(math.isfinite, struct.unpack("<ff", data))):
        assert axis["heard"] == 0
    else:
        assert math.isfinite(axis["heard_rad"])
    assert not math.isinf(axis["effort_nm"])
    assert not math.isinf(axis["voltage_v"])


def test_errors_are_told_in_words() -> None:
    assert error_words(0) == "none"
    assert error_words(1 << 6 | 1 << 14) == "motor, emergency stop asked over CAN"
    assert error_words(1 << 30) == "0x40000000"


class Script:
    """A bring-up's host, and a node that answers from a script."""

    def __init__(self, clears_protection: bool = True) -> None:
        self.arm, self.now_ns, self.clears_protection = ARM, 0, clears_protection
        self.port, self.unasked_before, self.told = None, [0] * 6, []

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Nothing is posted by an ODrive's bring-up."""

    def said(self, dialogue, answers: dict[int, list[bytes]]) -> tuple[list[Frame], object]:
        """Every frame that the dialogue sends, and its end."""
        sent, answer = [], None
        while True:
            try:
                question = dialogue.send(answer)
            except StopIteration as end:
                return sent, end.value
            sent += [frame for frame, _ in question.packets(True)]
            answer = None
            for command, queue in answers.items():
                if queue and question.hear(Frame(1 << 5 | command, queue[0], kind=STANDARD), False) is not None:
                    answer = Frame(1 << 5 | command, queue.pop(0) if len(queue) > 1 else queue[0], kind=STANDARD)
                    break


HERE = struct.pack("<ff", 2.5, 0.0)


def heartbeat(error: int, state: int) -> bytes:
    return struct.pack("<IB", error, state) + bytes(3)


def test_an_idle_axis_closes_its_loop_where_it_stands() -> None:
    """Modes 02B# 03 00 00 00 01 00 00 00 and closed loop 027# 08 00 …, golden; the position goes before both."""
    beats = [heartbeat(0, 1), heartbeat(0, 8)]
    sent, found = Script().said(bring_up(Script(), 0), {ESTIMATES: [HERE], HEARTBEAT: beats})
    told = [(frame.id, frame.data.hex()) for frame in sent if frame.kind == STANDARD]
    position = (0x02C, "0000204000000000")
    assert told == [position, position, (0x02B, "0300000001000000"), (0x027, "0800000000000000")]
    assert {frame.id for frame in sent if frame.kind == STANDARD | REMOTE} == {0x029}
    assert (found.reading, found.target) == (2.5, 2.5)


def test_a_closed_loop_stays_closed() -> None:
    sent, _ = Script().said(bring_up(Script(), 0), {ESTIMATES: [HERE], HEARTBEAT: [heartbeat(0, 8)]})
    assert 0x027 not in {frame.id for frame in sent}


def test_an_error_is_cleared_only_when_a_person_asks() -> None:
    answers = {ESTIMATES: [HERE], HEARTBEAT: [heartbeat(1 << 6, 1), heartbeat(0, 1), heartbeat(0, 8)]}
    with pytest.raises(TalkFailed, match=r"joint1 has an error \(motor\)"):
        Script().said(
            bring_up(Script(clears_protection=False), 0), {key: list(queue) for key, queue in answers.items()}
        )
    sent, _ = Script().said(bring_up(Script(), 0), answers)
    assert (0x038, bytes(8)) in [(frame.id, frame.data) for frame in sent]


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
        Script().said(bring_up(Script(), 0), answers)


def test_an_axis_that_stays_closed_is_told() -> None:
    with pytest.raises(TalkFailed, match="keeps its loop closed"):
        Script().said(let_go(ARM, 0), {HEARTBEAT: [heartbeat(0, 8)]})
    sent, _ = Script().said(let_go(ARM, 0), {HEARTBEAT: [heartbeat(0, 1)]})
    assert [(frame.id, frame.data.hex()) for frame in sent] == [(0x027, "0100000000000000")]
