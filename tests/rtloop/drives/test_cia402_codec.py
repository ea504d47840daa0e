"""CiA 402 frames beyond `tests/golden/cia402.yaml`: service data, error codes, and what hostile frames may not do.

Sources: facts/other-drives.md (captured SDO traffic of a 402 drive, canopen's tests); CiA 301 for identifiers, abort
codes and error codes; the statusword's table of CiA 402.
"""

import struct
from pathlib import Path

import numpy as np
import pytest
from codec_rig import Rig
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.budget import budget
from config.errors import ConfigError
from config.loader import load_arm
from rtloop.drives import cia402, cia402_protocol, cia402_setup, sdo
from rtloop.memory import status
from rtloop.memory.frame_words import STANDARD
from rtloop.process.initial_state import new_loop
from rtloop.service.port import Frame
from shm.words import Mode, Unreferenced

relaxed = settings(deadline=None)
ARM = load_arm("cia402_6")
ROOT = Path(__file__).resolve().parents[3]
COUNTS = 131_072
REQUESTS = (
    ("2B 40 60 00 06 00 00 00", cia402_protocol.CONTROLWORD, 0x06),
    ("2B 40 60 00 0F 00 00 00", cia402_protocol.CONTROLWORD, 0x0F),
    ("2F 60 60 00 08 00 00 00", cia402_protocol.MODE, 8),
    ("23 00 14 01 01 02 00 80", sdo.Object(0x1400, 1, 4, ""), 0x8000_0201),
    ("2F 00 16 00 00 00 00 00", sdo.Object(0x1600, 0, 1, ""), 0),
    ("23 00 16 01 10 00 40 60", sdo.Object(0x1600, 1, 4, ""), 0x6040_0010),
)


# --- service data ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "entry", "value"), REQUESTS)
def test_writes_are_those_of_the_capture(text, entry, value):
    ((frame, joined),) = sdo.writing(1, entry, value).packets(True)
    assert (frame.id, frame.data, frame.kind, joined) == (0x601, bytes.fromhex(text), STANDARD, False)


def test_reads_are_those_of_canopens_tests():
    """`40 18 10 01 00 00 00 00` on 602 is answered `43 18 10 01 04 00 00 00` on 582."""
    entry = sdo.Object(0x1018, 1, 4, "vendor")
    question = sdo.reading(2, entry)
    ((frame, _),) = question.packets(True)
    assert (frame.id, frame.data) == (0x602, bytes.fromhex("40 18 10 01 00 00 00 00"))
    answer = Frame(0x582, bytes.fromhex("43 18 10 01 04 00 00 00"))
    assert question.receive(answer, False) == answer and sdo.value_in(answer, entry) == 4


def test_a_position_is_read_as_in_the_capture():
    answer = Frame(0x581, bytes.fromhex("43 64 60 00 FE 3F 00 00"))
    assert sdo.reading(1, cia402_protocol.POSITION).receive(answer, False) == answer
    assert sdo.value_in(answer, cia402_protocol.POSITION) == 16_382


@relaxed
@given(st.integers(-(2**31), 2**31 - 1))
def test_positions_have_signs(value):
    answer = Frame(0x581, b"\x43\x64\x60\x00" + struct.pack("<i", value))
    assert sdo.value_in(answer, cia402_protocol.POSITION) == value
    ((frame, _),) = sdo.writing(1, cia402_protocol.TARGET, value).packets(True)
    assert struct.unpack("<i", frame.data[4:]) == (value,)


def test_an_answer_shorter_than_expected_keeps_its_own_size():
    answer = Frame(0x581, bytes.fromhex("4F 61 60 00 FF AA AA AA"))
    assert sdo.value_in(answer, cia402_protocol.MODE_SHOWN) == -1


@pytest.mark.parametrize(
    ("frame_id", "text"),
    [
        (0x582, "43 64 60 00 FE 3F 00 00"),  # of another node
        (0x581, "43 63 60 00 FE 3F 00 00"),  # another object
        (0x581, "43 64 60 01 FE 3F 00 00"),  # another part of it
        (0x581, "60 64 60 00 00 00 00 00"),  # the answer to a write
        (0x581, "41 64 60 00 04 00 00 00"),  # a segmented transfer, which four bytes do not need
        (0x581, "43 64 60 00 FE 3F 00"),
        (0x581, ""),
        (0x601, "40 64 60 00 00 00 00 00"),  # the echo of the question
    ],
)
def test_what_is_no_answer_is_none(frame_id, text):
    assert sdo.reading(1, cia402_protocol.POSITION).receive(Frame(frame_id, bytes.fromhex(text)), True) is None


@pytest.mark.parametrize(
    ("text", "is_answer"),
    [
        ("60 40 60 00 00 00 00 00", True),
        ("80 40 60 00 30 00 09 06", True),
        ("43 40 60 00 00 00 00 00", False),  # the answer to a question
        ("2B 40 60 00 06 00 00 00", False),  # an echo
        ("60 60 60 00 00 00 00 00", False),  # of another object
    ],
)
def test_a_write_is_answered_by_its_confirmation_or_an_abort(text, is_answer):
    frame = Frame(0x581, bytes.fromhex(text))
    assert sdo.writing(1, cia402_protocol.CONTROLWORD, 6).receive(frame, False) == (frame if is_answer else None)


@relaxed
@given(st.binary(max_size=8), st.integers(0, 0x7FF))
def test_no_bytes_break_a_question(data, frame_id):
    answer = sdo.reading(1, cia402_protocol.POSITION).receive(Frame(frame_id, data), False)
    if answer is not None:
        assert data[1:4] == b"\x64\x60\x00"


def test_aborts_are_answers_and_have_words():
    answer = Frame(0x581, bytes.fromhex("80 60 60 00 30 00 09 06"))
    assert sdo.writing(1, cia402_protocol.MODE, 8).receive(answer, False) == answer
    assert sdo.abort_words(0x0609_0030) == "it does not allow that value, abort code 06090030"
    assert "abort code DEADBEEF" in sdo.abort_words(0xDEAD_BEEF)


def test_the_node_is_started_as_in_the_facts():
    frame = cia402_setup._order(sdo.Node(2, ARM.joints[2]), cia402_protocol.START_NODE)
    assert (frame.id, frame.data, frame.kind) == (0x000, b"\x01\x03", STANDARD)


@pytest.mark.parametrize(
    ("period_s", "units", "power"),
    [(0.004, 4, -3), (0.01, 1, -2), (0.008, 8, -3), (0.0025, 25, -4), (0.001, 1, -3), (1 / 120, 83, -4), (0.05, 5, -2)],
)
def test_interpolation_times_are_as_coarse_as_they_are_exact(period_s, units, power):
    found = cia402_setup.interpolation_time(period_s)
    assert found == (units, power)
    assert abs(found[0] * 10.0 ** found[1] - period_s) <= 0.005 * period_s


@relaxed
@given(st.floats(0.0005, 0.05))
def test_interpolation_times_fit_a_byte_and_are_close(period_s):
    units, power = cia402_setup.interpolation_time(period_s)
    assert 1 <= units <= 255 and -6 <= power <= -2
    assert abs(units * 10.0**power - period_s) <= 0.02 * period_s


# --- process data ---------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
def test_no_statusword_is_both_enabled_and_failed(statusword, code):
    found = cia402.common_status(statusword, code)
    state = cia402_setup.state_of(statusword)
    assert bool(found & status.ENABLED) == (state == cia402_protocol.OPERATION_ENABLED)
    assert bool(found & status.PROTECTED) == (state in (cia402_protocol.FAULT, cia402_protocol.FAULT_REACTION))
    assert cia402_setup.state_words(state)


@pytest.mark.parametrize(
    ("code", "expected", "words"),
    [
        (0x2310, status.OVER_CURRENT, "current"),
        (0x3210, status.OVER_VOLTAGE, "over-voltage"),
        (0x3220, status.UNDER_VOLTAGE, "under-voltage"),
        (0x5112, status.UNDER_VOLTAGE, "the drive's electronics"),
        (0x4310, status.OVER_TEMPERATURE, "over-temperature"),
        (0x4320, 0, "too cold"),
        (0x7305, status.ENCODER, "sensor"),
        (0x7510, status.COMMUNICATION, "communication"),
        (0x8001, 0, "monitoring"),
        (0x8130, status.COMMUNICATION, "communication"),
        (0x8210, status.COMMUNICATION, "communication"),
        (0x8611, status.STALLED, "following error"),
        (0x7121, status.STALLED, "motor blocked"),
        (0xFF01, 0, "an error of its own kind"),
        (0x0001, 0, "none that is known"),
    ],
)
def test_error_codes_are_common_classes(code, expected, words):
    assert cia402.common_status(0x0218, code) == status.PROTECTED | expected
    assert cia402.common_status(0x1637, code) == status.ENABLED, "a code alone is no error"
    assert cia402_setup.error_words(code) == f"{words}, error code {code:04X}"


def test_no_state_of_a_node_but_operational_passes_for_a_drive_that_holds():
    for state in range(256):
        told = Rig.named("cia402").hears(f"701# {state:02X}")
        lost = status.POWER_LOST if state == 0 else 0
        assert told.get("status", 0) == (0 if state == 5 else status.ANSWERED | status.COMMUNICATION | lost)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_target_is_where_the_joint_is_due_a_period_after_the_sync_and_within_its_limits(sign):
    """The SYNC arrives some milliseconds into the cycle: by so much later than the next setpoint it is due."""
    made = new_loop(ARM, 0, 0)
    axis, row = made[0]["axes"][0], made[0]["joints"][0]
    row["command_delay_s"] = 0.002
    axis["commanded"]["next_position_rad"], axis["commanded"]["next_velocity_rad_s"] = sign * 0.1, sign * 0.5
    axis["commanded"]["next_acceleration_rad_s2"] = -sign * 3.0
    assert cia402.setpoint_rad(made[0], 0) == pytest.approx(sign * (0.1 + 0.5 * 0.002 - 3.0 * 0.002**2 / 2))
    end_rad = row["upper_rad"] + row["slack_rad"] if sign > 0.0 else row["lower_rad"] - row["slack_rad"]
    axis["commanded"]["next_position_rad"] = end_rad
    axis["commanded"]["next_acceleration_rad_s2"] = 0.0
    assert cia402.setpoint_rad(made[0], 0) == end_rad


# --- on the bus -----------------------------------------------------------------------------------------------


def frames_of(data):
    """(identifier, bytes) of an SLCAN text of standard frames."""
    return [(int(line[1:4], 16), bytes.fromhex(line[5:].decode())) for line in data.split(b"\r") if line[:1] == b"t"]


def test_a_cycle_is_a_target_each_and_one_sync():
    arm = VirtualArm.brought_up("cia402_6")
    at_rest = frames_of(arm.sent[-1][1])
    assert at_rest == [(0x080, b"")], "before the first goal nothing is led"
    arm.send_goal(np.array([0, 500_000_000]), np.zeros((2, 6, 3)), order=3)
    arm.cycles(20)
    told = frames_of(arm.sent[-1][1])
    assert [frame_id for frame_id, _ in told] == [*range(0x201, 0x207), 0x080]
    for joint, (_, data) in zip(arm.arm.joints, told, strict=False):
        assert struct.unpack("<Hi", data) == (0x0F, round(joint.zero_deg / 360 * joint.ratio * COUNTS))
    arm.close()


def test_bits_a_cycle_are_those_of_the_facts():
    """1435 for six axes; with a torque of 2 bytes more in each answer 1555 (1675 would be 8 bytes both ways)."""
    assert budget(ARM).bits_per_cycle == 1555
    plain = ARM.model_copy(
        update={
            "joints": [
                joint.model_copy(update={"drive": joint.drive.model_copy(update={"rated_torque_nm": None})})
                for joint in ARM.joints
            ]
        }
    )
    found = budget(plain)
    assert (found.bits_per_cycle, found.frames_per_cycle) == (1435, 13)
    beside = 6 * 10 * 65  # heartbeats of one byte
    assert found.bits_beside_s == beside
    assert found.bus_highest_rate_hz == pytest.approx((850_000 - beside) / 1435)


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("node_id", 0, "node_id"),
        ("node_id", 128, "node_id"),
        ("node_id", 2, "node_id 2 is used by joint1 and joint2"),
        ("counts_per_revolution", 0, "counts_per_revolution"),
        ("counts_per_revolution", 1 << 29, "motor turns from its drive's zero"),
        ("encoder", "magnetic", "encoder"),
        ("rated_torque_nm", -1.0, "rated_torque_nm"),
        ("heartbeat_ms", 0, "heartbeat_ms"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, field, value, sentence):
    drive = {"family": "cia402", "node_id": 1, "counts_per_revolution": COUNTS, field: value}
    listed = ", ".join(f"{name}: {given}" for name, given in drive.items())
    text = (ROOT / "config" / "arms" / "cia402_6.yaml").read_text(encoding="utf-8")
    first = text.index("drive: {")
    path = tmp_path / "arm.yaml"
    path.write_text(text[:first] + f"drive: {{{listed}}}" + text[text.index("}", first) + 1 :])
    with pytest.raises(ConfigError, match=sentence):
        load_arm(str(path))


# --- what hostile frames may not do ---------------------------------------------------------------------------


hostile = st.lists(
    st.tuples(st.sampled_from([0x081, 0x181, 0x581, 0x701]), st.binary(max_size=8)), min_size=1, max_size=12
)


@settings(deadline=None, max_examples=examples(15), suppress_health_check=[HealthCheck.too_slow])
@given(hostile, st.booleans())
def test_frames_of_others_move_nothing(frames, twice):
    """Whatever comes on a standing drive's identifiers, its shaft stays where it is and targets stay inside limits."""
    arm = VirtualArm.brought_up("cia402_6")
    hold = np.zeros((2, 6, 3))
    arm.send_goal(np.array([0, 100_000_000]), hold, order=3)
    arm.cycles(40)
    at_rest_rad = arm.sim.true_position_rad(0, arm.sim.now_ns)
    arm.sim.drives[0].reply_loss = 1.0  # its own answers would be the last word of every cycle
    for frame_id, data in frames * (1 + twice):
        text = f"t{frame_id:03X}{len(data)}{data.hex().upper()}\r".encode()
        arm.receive(arm.sim.now_ns, text)
        arm.cycle()
    arm.cycles(40)
    assert arm.memory["mode"] in (Mode.HOLDING, Mode.FAULT)
    moved = abs(arm.sim.true_position_rad(0, arm.sim.now_ns) - at_rest_rad)
    assert moved <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()


def test_a_reading_that_jumps_twice_does_not_pull_the_joint_there():
    """Readings in doubt are no place to stop at: the drive stands at its last target."""
    arm = VirtualArm.brought_up("cia402_6")
    arm.send_goal(np.array([0, 100_000_000]), np.zeros((2, 6, 3)), order=3)
    arm.cycles(40)
    at_rest_rad = arm.sim.true_position_rad(0, arm.sim.now_ns)
    arm.sim.drives[0].reply_loss = 1.0
    for _ in range(4):
        arm.receive(arm.sim.now_ns, b"t1818" + struct.pack("<Hih", 0x1637, 12_345, 0).hex().upper().encode() + b"\r")
        arm.cycle()
    arm.cycles(10)
    assert arm.memory["mode"] == Mode.FAULT
    assert arm.loop[0]["axes"][0]["reference"]["unreferenced_reason"] == Unreferenced.POSITION_JUMP
    assert abs(arm.sim.true_position_rad(0, arm.sim.now_ns) - at_rest_rad) <= 2 * arm.arm.joints[0].encoder_count_rad
    arm.close()
