"""Damiao's frames to numbers and back, and its bring-up word by word: golden bytes, properties, hostile bytes.

Golden bytes are those of other-drives.md (damiao-motor 1.0.6, motor type 4340, motor 1); what that library itself makes
of the same numbers is tested in tests/third_party.
"""

import math
import struct
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop import status as status_bits
from rtloop.beginning import new_loop
from rtloop.conversation import TalkFailed
from rtloop.drives import damiao, fields, words
from rtloop.drives import damiao_setup as setup
from rtloop.drives.damiao_setup import Feedback, bring_up, feedback_of, let_go, setpoint_bytes, status_words
from rtloop.port import Frame
from rtloop.wire.frame_words import STANDARD
from shm import layout
from shm.words import Unreferenced

ARM, PLANNING = load_arm("damiao6"), load_arm("damiao6_pv")
RANGES = ARM.joints[0].drive.ranges
ENABLED_HERE = bytes.fromhex("118A3C7FF7FF2823")
"""Enabled, 1.0 rad, 40 and 35 °C."""
LIMP_HERE = bytes.fromhex("018A3C7FF7FF2823")
HERE_RAD = 0x8A3C * 25.0 / 65535 - 12.5


def word(data: bytes) -> int:
    """Data bytes as the cycle holds them."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


def made(arm: ArmConfig = ARM) -> SimpleNamespace:
    """The state that codecs work on."""
    return SimpleNamespace(loop=new_loop(arm, 0, 0), shared=np.zeros(1, layout.STATE))


@pytest.fixture
def cycle() -> SimpleNamespace:
    return made()


def hear(cycle: SimpleNamespace, joint: int, data: bytes) -> np.void:
    """What a motor says on its master ID; the joint's axis."""
    damiao.hear(cycle.loop[0], joint, cycle.shared[0], 0x11 + joint, STANDARD, len(data), word(data), 5)
    return cycle.loop[0]["axes"][joint]


def set_point(cycle: SimpleNamespace, rad: float, kp: float, kd: float, rad_s: float = 0.0, nm: float = 0.0) -> str:
    row = cycle.loop[0]["joints"][0]
    row["stiffness_nm_rad"], row["damping_nm_s_rad"] = kp, kd
    return struct.pack("<q", damiao.setpoint_data(row, rad, rad_s, nm)).hex(" ").upper()


def test_set_points_are_the_golden_ones(cycle: SimpleNamespace) -> None:
    assert set_point(cycle, 0.0, 0.0, 0.0) == "7F FF 7F F0 00 00 07 FF"
    assert set_point(cycle, 1.0, 10.0, 1.0) == "8A 3C 7F F0 51 33 37 FF"


def test_ends_and_what_lies_beyond_them_fill_the_fields(cycle: SimpleNamespace) -> None:
    assert set_point(cycle, 12.5, 500.0, 5.0, 10.0, 28.0) == "FF FF FF FF FF FF FF FF"
    assert set_point(cycle, 99.0, 999.0, 9.0, math.inf, 1e30) == "FF FF FF FF FF FF FF FF"
    assert set_point(cycle, -99.0, 0.0, 0.0, -math.inf, -1e30) == "00 00 00 00 00 00 00 00"
    assert set_point(cycle, math.nan, 0.0, 0.0, math.nan, math.nan) == "7F FF 7F F0 00 00 07 FF"


def test_targets_are_the_golden_ones() -> None:
    """1.0 rad at 2.0 rad/s: 101# 00 00 80 3F 00 00 00 40."""
    assert damiao.target_data(1.0, 2.0) == word(bytes.fromhex("0000803F00000040"))


@settings(deadline=None)
@given(rad=st.floats(-100.0, 100.0), rad_s=st.floats(0.0, 100.0))
def test_targets_are_packed_as_struct_does(rad: float, rad_s: float) -> None:
    assert damiao.target_data.py_func(rad, rad_s) == word(struct.pack("<ff", rad, rad_s))


@settings(deadline=None)
@given(bits=st.sampled_from([12, 16]), most=st.floats(1e-3, 1e4), share=st.floats(0.0, 1.0))
def test_fields_go_back_in_as_they_came_out(bits: int, most: float, share: float) -> None:
    code = round(share * ((1 << bits) - 1))
    value = fields.of_field(code, most, bits)
    assert -most <= value <= most * (1.0 + 1e-12)
    assert fields.field(value, most, bits) == code == words.field(value, most, bits)
    assert words.of_field(code, most, bits) == value


@settings(deadline=None)
@given(rad=st.floats(-12.5, 12.5), kp=st.floats(1.0, 500.0), kd=st.floats(0.0, 5.0))
def test_bring_up_and_cycle_make_the_same_set_points(rad: float, kp: float, kd: float) -> None:
    drive = ARM.joints[0].drive.model_copy(update={"kp": kp, "kd": kd})
    assert setpoint_bytes(drive, rad).hex(" ").upper() == set_point(CYCLE, rad, kp, kd)


CYCLE = made()


@settings(deadline=None)
@given(rad=st.floats(-3.0, 3.0), rad_s=st.floats(-9.0, 9.0), kp=st.floats(1.0, 500.0), kd=st.floats(0.0, 5.0))
def test_what_position_and_velocity_lose_is_in_the_torque(rad: float, rad_s: float, kp: float, kd: float) -> None:
    """What the motor makes of it beside what was meant, as an error of position: less than a step of each field's."""
    row = CYCLE.loop[0]["joints"][0]
    row["stiffness_nm_rad"], row["damping_nm_s_rad"] = kp, kd
    packed = int.from_bytes(struct.pack("<q", damiao.following_data(row, rad, rad_s)), "big")
    told_kp, told_kd = (packed >> 24 & 0xFFF) * 500 / 4095, (packed >> 12 & 0xFFF) * 5 / 4095
    nm = fields.of_field(packed & 0xFFF, RANGES.nm, 12)
    nm += told_kp * fields.of_field(packed >> 48, RANGES.rad, 16)
    nm += told_kd * fields.of_field(packed >> 36 & 0xFFF, RANGES.rad_s, 12)
    of_gains = (kp - told_kp) * 2.0 * RANGES.rad / 65535 + (kd - told_kd) * 2.0 * RANGES.rad_s / 4095
    off = told_kp * rad + told_kd * rad_s - nm
    assert -1e-6 * 56.0 - of_gains <= off <= 56.0 / 4095 + 1e-6 + of_gains


def test_feedback_is_heard_as_the_golden_one(cycle: SimpleNamespace) -> None:
    """11 8A 3C 7F F7 FF 28 23 = enabled, 1.0 rad, 40/35 °C."""
    axis = hear(cycle, 0, ENABLED_HERE)
    assert axis["heard"] == 1
    assert axis["heard_rad"] == pytest.approx(1.0 - ARM.joints[0].zero_rad, abs=25.0 / 65535)
    assert axis["told_velocity_rad_s"] == pytest.approx(0.0, abs=20.0 / 4095)
    assert axis["effort_nm"] == pytest.approx(0.0, abs=56.0 / 4095)
    assert axis["temperature_c"] == 40.0
    assert axis["status"] == status_bits.ENABLED | status_bits.ANSWERED
    assert hear(cycle, 0, ENABLED_HERE[:6] + b"\x28\x29")["temperature_c"] == 41.0  # the higher of both
    assert feedback_of(ENABLED_HERE, RANGES) == Feedback(1, HERE_RAD, 2047 * 20 / 4095 - 10, 2047 * 56 / 4095 - 28)


def test_direction_and_gear_are_those_of_the_joint() -> None:
    """A motor that turns backwards behind a gear of 2: half the angle and speed, twice the torque, other signs."""
    values = [joint.model_dump() for joint in ARM.joints]
    values[0].update(ratio=2.0, direction=-1, zero_deg=0.0)
    arm = ArmConfig.model_validate(ARM.model_dump() | {"joints": values})
    axis = hear(made(arm), 0, bytes.fromhex("118A3CFFFFFF2823"))
    assert axis["heard_rad"] == pytest.approx(-HERE_RAD / 2.0)
    assert axis["told_velocity_rad_s"] == pytest.approx(-5.0)
    assert axis["effort_nm"] == pytest.approx(-56.0)


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (0, 0),
        (1, status_bits.ENABLED),
        (8, status_bits.PROTECTED | status_bits.OVER_VOLTAGE),
        (9, status_bits.PROTECTED | status_bits.UNDER_VOLTAGE),
        (0xA, status_bits.PROTECTED | status_bits.OVER_CURRENT),
        (0xB, status_bits.PROTECTED | status_bits.OVER_TEMPERATURE),
        (0xC, status_bits.PROTECTED | status_bits.OVER_TEMPERATURE),
        (0xD, status_bits.PROTECTED | status_bits.COMMUNICATION),
        (0xE, status_bits.PROTECTED | status_bits.OVER_CURRENT),
        *((code, status_bits.PROTECTED) for code in (2, 3, 4, 5, 6, 7, 0xF)),
    ],
)
def test_status_codes_tell_the_status(cycle: SimpleNamespace, code: int, expected: int) -> None:
    data = bytes([code << 4 | 1]) + ENABLED_HERE[1:]
    assert hear(cycle, 0, data)["status"] == expected | status_bits.ANSWERED


@pytest.mark.parametrize(
    "data",
    [
        bytes.fromhex("128A3C7FF7FF2823"),  # on its master ID, but motor 2 says so
        bytes.fromhex("0100330A01000000"),  # a register read
        bytes.fromhex("0100550A02000000"),  # and written
        bytes.fromhex("0100AA0100000000"),  # all of them stored
        ENABLED_HERE[:7],
        b"",
    ],
)
def test_what_is_no_feedback_of_the_motor_is_not_heard(cycle: SimpleNamespace, data: bytes) -> None:
    axis = hear(cycle, 0, data)
    assert (axis["heard"], axis["status"], axis["status_readings"]) == (0, 0, 0)
    assert math.isnan(axis["effort_nm"]) and math.isnan(axis["temperature_c"])


@settings(deadline=None, max_examples=300)
@given(data=st.binary(max_size=8), joint=st.integers(0, 5))
def test_no_bytes_make_a_reading_out_of_range(data: bytes, joint: int) -> None:
    axis = hear(CYCLE_AGAIN, joint, data)
    config = ARM.joints[joint]
    if axis["heard"]:
        assert abs(axis["heard_rad"] + config.zero_rad) <= 12.5 + 1e-9
        assert abs(axis["told_velocity_rad_s"]) <= config.drive.ranges.rad_s + 1e-9
        assert abs(axis["effort_nm"]) <= config.drive.ranges.nm + 1e-9
        assert 0.0 <= axis["temperature_c"] <= 255.0
        axis["heard"] = 0


CYCLE_AGAIN = made()


@pytest.mark.parametrize(("arm", "identifier"), [(ARM, 0x003), (PLANNING, 0x103)])
def test_a_drive_that_was_led_is_not_asked_as_well(arm: ArmConfig, identifier: int) -> None:
    cycle = made(arm)
    core, axis = cycle.loop[0]["core"], cycle.loop[0]["axes"][2]
    core["cycle"] = 7
    damiao.lead(cycle.loop[0], 2, cycle.shared[0])
    damiao.ask_position(cycle.loop[0], 2, cycle.shared[0])
    assert list(cycle.loop[0]["tx_ids"][: core["tx_frames"]]) == [identifier]
    assert axis["questions"] == 1  # its feedback is an answer
    core["cycle"] = 8
    damiao.ask_position(cycle.loop[0], 2, cycle.shared[0])
    assert list(cycle.loop[0]["tx_ids"][: core["tx_frames"]]) == [identifier, 0x7FF]
    assert struct.pack("<q", cycle.loop[0]["tx_data"][1]) == bytes.fromhex("0300CC0000000000")


@pytest.mark.parametrize("arm", [ARM, PLANNING], ids=lambda arm: arm.name)
def test_a_stop_is_a_hold_and_never_lets_go(arm: ArmConfig) -> None:
    """In mode mit where it is measured; with a ramp of its own where that ramp ends, at the speed that it has."""
    cycle = made(arm)
    axis, row = cycle.loop[0]["axes"][1], cycle.loop[0]["joints"][1]
    axis["measured_rad"], axis["readings"], axis["told_velocity_rad_s"] = 0.5, 1, -0.3
    assert damiao.stop(cycle.loop[0], 1, cycle.shared[0])
    data = struct.pack("<q", cycle.loop[0]["tx_data"][0])
    assert cycle.loop[0]["tx_ids"][0] == (0x002 if arm is ARM else 0x102)
    if arm is ARM:
        assert data[:4].hex() == f"{fields.field(0.5, 12.5, 16):04x}7ff6"  # no velocity; stiffness 200 is 666
    else:
        target, speed = struct.unpack("<ff", data)
        assert target == pytest.approx(0.5 - 0.3**2 / (2.0 * row["silence_deceleration_rad_s2"]) - 0.3 * 0.005)
        assert speed == pytest.approx(0.3)


def test_where_nothing_was_measured_a_stop_says_nothing(cycle: SimpleNamespace) -> None:
    assert damiao.stop(cycle.loop[0], 1, cycle.shared[0])
    assert cycle.loop[0]["core"]["tx_frames"] == 0


# --- bring-up -------------------------------------------------------------------------------------------------


class Motor:
    """A bring-up's host, and motor 1 that answers from a script: registers, and feedback one after the other."""

    def __init__(self, arm: ArmConfig, *feedback: bytes, clears_protection: bool = True, **registers: object) -> None:
        self.arm, self.now_ns, self.clears_protection, self.told = arm, 0, clears_protection, []
        self.feedback = list(feedback)
        self.registers = {
            setup.PMAX: struct.pack("<f", 12.5),
            setup.VMAX: struct.pack("<f", 10.0),
            setup.TMAX: struct.pack("<f", 28.0),
            setup.CONTROL_MODE: struct.pack("<I", 1 if arm is ARM else 2),
            setup.TIMEOUT: bytes(4),
            setup.ACC: struct.pack("<f", 3.5),
            setup.DEC: struct.pack("<f", -3.5),
        } | registers.pop("held", {})
        self.keeps = registers.pop("keeps", ())
        assert not registers

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Nothing is posted by a Damiao motor's bring-up."""

    def answers(self, frame: Frame) -> Iterator[bytes]:
        if frame.id != 0x7FF:
            return
        number, operation, register = struct.unpack("<HBB", frame.data[:4])
        assert number == 1
        if operation == setup.FEEDBACK and self.feedback:
            yield self.feedback.pop(0) if len(self.feedback) > 1 else self.feedback[0]
        if operation == setup.WRITE and register not in self.keeps:
            self.registers[register] = frame.data[4:]
        if operation in (setup.READ, setup.WRITE) and register in self.registers:
            yield frame.data[:4] + self.registers[register]

    def said(self, dialogue) -> tuple[list[str], object]:
        """Every frame that the dialogue sends, and its end."""
        sent, answer = [], None
        while True:
            try:
                question = dialogue.send(answer)
            except StopIteration as end:
                return sent, end.value
            answer = None
            for frame, _ in question.packets(True):
                assert frame.kind == STANDARD and len(frame.data) == 8
                sent.append(f"{frame.id:03X}# {frame.data.hex(' ').upper()}")
                for data in self.answers(frame):
                    heard = Frame(0x11, data, kind=STANDARD)
                    answer = heard if question.hear(heard, False) is not None else answer


def commands(sent: list[str]) -> list[str]:
    return [text for text in sent if not text.startswith("7FF")]


HOLD = "001# " + setpoint_bytes(ARM.joints[0].drive, HERE_RAD).hex(" ").upper()
ENABLE = "001# FF FF FF FF FF FF FF FC"


def test_a_limp_motor_is_enabled_between_two_commands_to_stay() -> None:
    motor = Motor(ARM, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    sent, found = motor.said(bring_up(motor, 0))
    assert commands(sent) == [HOLD, ENABLE, HOLD]
    assert sent[0] == "7FF# 01 00 CC 00 00 00 00 00"
    assert "7FF# 01 00 33 0A 00 00 00 00" in sent  # read mode, golden
    assert not [text for text in sent if text[11:13] in ("55", "AA")]  # nothing written, nothing stored
    assert found.reading == HERE_RAD and found.reason == Unreferenced.REFERENCED
    assert motor.told == []


def test_one_that_plans_its_motion_is_told_where_it_stands() -> None:
    motor = Motor(PLANNING, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    sent, found = motor.said(bring_up(motor, 0))
    stay = "101# " + struct.pack("<ff", HERE_RAD, 0.25 * PLANNING.joints[0].max_velocity_rad_s).hex(" ").upper()
    assert commands(sent) == [stay, ENABLE, stay]
    assert (found.reading, found.target) == (HERE_RAD, HERE_RAD)


def test_an_enabled_motor_keeps_the_torque_with_which_it_holds() -> None:
    """10 N·m at 200 N·m/rad: it is told a position 0.05 rad further on, where its spring makes just that."""
    code = fields.field(10.0, 28.0, 12)
    holding = ENABLED_HERE[:4] + (0xF << 12 | code).to_bytes(2, "big") + ENABLED_HERE[6:]
    motor = Motor(ARM, holding)
    sent, found = motor.said(bring_up(motor, 0))
    bent_rad = HERE_RAD + fields.of_field(code, 28.0, 12) / 200.0
    assert commands(sent) == ["001# " + setpoint_bytes(ARM.joints[0].drive, bent_rad).hex(" ").upper()]
    assert found.target == pytest.approx(bent_rad)
    assert found.reading == HERE_RAD


def test_what_differs_is_written_to_volatile_memory_and_said() -> None:
    held = {
        setup.CONTROL_MODE: struct.pack("<I", 1),
        setup.ACC: struct.pack("<f", 20.0),
        setup.TIMEOUT: struct.pack("<I", 10_000),
    }
    motor = Motor(PLANNING, LIMP_HERE, LIMP_HERE, ENABLED_HERE, held=held)
    sent, _ = motor.said(bring_up(motor, 0))
    assert [text for text in sent if text[11:13] == "55"] == [
        "7FF# 01 00 55 0A 02 00 00 00",  # mode 2, golden
        "7FF# 01 00 55 04 00 00 60 40",
        "7FF# 01 00 55 09 00 00 00 00",
    ]
    assert not [text for text in sent if text[11:13] == "AA"]
    (sentence,) = motor.told
    for part in ("joint1", "mode from 1 to 2", "acceleration from 20 to 3.5 rad/s²", "alarm time from 500 ms to none"):
        assert part in sentence
    motor.said(bring_up(motor, 0))
    assert len(motor.told) == 1  # what is so already is not said


def test_an_error_is_cleared_only_when_a_person_asks() -> None:
    hot = b"\xb1" + LIMP_HERE[1:]
    motor = Motor(ARM, hot, LIMP_HERE, LIMP_HERE, ENABLED_HERE, clears_protection=False)
    with pytest.raises(TalkFailed, match=r"joint1 has an error \(power stage too hot\)"):
        motor.said(bring_up(motor, 0))
    motor = Motor(ARM, hot, LIMP_HERE, LIMP_HERE, ENABLED_HERE)
    assert commands(motor.said(bring_up(motor, 0))[0])[0] == "001# FF FF FF FF FF FF FF FB"


OTHER_RANGE = {setup.VMAX: struct.pack("<f", 45.0)}
NO_NUMBER = {setup.PMAX: struct.pack("<f", math.nan)}
OTHER_MODE = {setup.CONTROL_MODE: struct.pack("<I", 2)}


@pytest.mark.parametrize(
    ("feedback", "options", "sentence"),
    [
        ([], {}, r"joint1 \(motor_id 0x1\) does not answer on its master_id 0x11: check its power, its ESC_ID"),
        ([b"\x02" + LIMP_HERE[1:]], {}, "does not answer"),  # the answer of motor 2
        ([LIMP_HERE], {"held": OTHER_RANGE}, r"velocity range is ±45 rad/s \(register 22, VMAX\), but the arm .* ±10"),
        ([LIMP_HERE], {"held": NO_NUMBER}, "position range is ±nan rad"),
        ([LIMP_HERE], {"held": {setup.TMAX: b""}}, "stopped answering while its register 23 was read"),
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
    with pytest.raises(TalkFailed, match=sentence):
        motor.said(bring_up(motor, 0))
    assert motor.told == []


@pytest.mark.parametrize("change", [{"ratio": 1.2}, {"drive": {"encoder": "incremental"}}])
def test_a_joint_whose_angle_the_encoder_does_not_know_is_for_a_person(change: dict) -> None:
    """Behind a gear of 1.2 the 320° of joint1 are more than a turn of the motor."""
    values = [joint.model_dump() for joint in ARM.joints]
    drive = values[0]["drive"] | change.get("drive", {})
    values[0] |= change | {"drive": drive}
    arm = ArmConfig.model_validate(ARM.model_dump() | {"joints": values})
    motor = Motor(arm, LIMP_HERE, LIMP_HERE, ENABLED_HERE, held={setup.CONTROL_MODE: struct.pack("<I", 1)})
    assert motor.said(bring_up(motor, 0))[1].reason == Unreferenced.INCREMENTAL
    assert made(arm).loop[0]["joints"]["knows_its_angle"][:2].tolist() == [0, 1]


def test_a_motor_that_stays_enabled_is_told() -> None:
    motor = Motor(ARM, ENABLED_HERE)
    with pytest.raises(TalkFailed, match="stays enabled"):
        motor.said(let_go(ARM, 0))
    motor = Motor(ARM, LIMP_HERE)
    assert commands(motor.said(let_go(ARM, 0))[0]) == ["001# FF FF FF FF FF FF FF FD"]


def test_status_codes_are_told_in_words() -> None:
    assert [status_words(code) for code in (0, 1, 0xD, 0xE, 0x7)] == [
        "limp",
        "enabled",
        "communication lost",
        "overload",
        "0x7",
    ]
