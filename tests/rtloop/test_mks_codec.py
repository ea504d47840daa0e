"""MKS frames in the cycle: the vectors of the facts in both directions, targets read back, and hostile bytes.

(facts) are the vectors of other-drives.md, (manual) those of the maker's CAN manual V1.0.6. What reads commands here is
written from those alone.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.drives.mks import FARTHEST_COUNTS
from config.loader import load_arm
from rtloop import status
from rtloop.beginning import new_loop
from rtloop.drives import mks
from rtloop.drives.mks_setup import EMERGENCY_STOP, READ_ENABLED, READ_POSITION, READ_PROTECTED
from rtloop.measured import take_frame
from rtloop.wire.frame_words import EXTENDED, REMOTE, STANDARD
from shm import layout

relaxed = settings(deadline=None)  # the first call loads the compiled cycle
ARM = load_arm("mks6")
JOINT = 2
CAN_ID = 3


def word(data: bytes) -> int:
    """The codec's data word, first byte lowest."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


def data_of(value: int, length: int) -> bytes:
    return (int(value) % 2**64).to_bytes(8, "little")[:length]


def summed(data: bytes, can_id: int = CAN_ID) -> bytes:
    return data + bytes(((can_id + sum(data)) & 0xFF,))


@pytest.fixture
def loop():
    """A loop whose joints hold, referenced, somewhere."""
    state = np.zeros(1, layout.STATE)
    made = new_loop(ARM, state.ctypes.data, 0)
    for axis in made[0]["axes"][:6]:
        axis["referenced"] = 1
    return made, state


# --- golden bytes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rpm", "acc", "counts", "text"),
    [
        (600, 2, 16384, "F5 02 58 02 00 40 00 92"),  # (facts)
        (600, 2, -16384, "F5 02 58 02 FF C0 00 11"),  # (facts)
        (300, 2, 0x28000, "F5 01 2C 02 02 80 00 A7"),  # (manual V1.0.9)
        (0, 4, 0, "F5 00 00 04 00 00 00 FA"),  # (facts)
        (0, 0, 0, "F5 00 00 00 00 00 00 F6"),  # (manual)
    ],
)
def test_targets_as_in_the_facts(rpm, acc, counts, text):
    assert data_of(mks.pack_target(1, rpm, acc, counts), 8) == bytes.fromhex(text)


@pytest.mark.parametrize(
    ("code", "text"),
    [(READ_POSITION, "31 32"), (EMERGENCY_STOP, "F7 F8"), (READ_ENABLED, "3A 3B"), (READ_PROTECTED, "3E 3F")],
)
def test_short_commands_as_in_the_facts(code, text):
    assert data_of(mks.closed(1, code, 1), 2) == bytes.fromhex(text)


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("31 00 00 00 00 3F F0 61", 0x3FF0),  # (manual: values, not their sums)
        ("31 00 00 00 00 7F F0 A1", 0x7FF0),
        ("31 FF FF FF FF FF F0 1D", -0x10),
        ("31 80 00 00 00 00 00 B2", -(2**47)),
        ("31 7F FF FF FF FF FF AC", 2**47 - 1),
    ],
)
def test_positions(text, counts):
    data = bytes.fromhex(text)
    assert mks.is_sound(1, word(data), len(data))
    assert mks.counts_of(word(data)) == counts


@relaxed
@given(st.integers(1, 2047), st.integers(0, 3000), st.integers(0, 255), st.integers(-(2**40), 2**40))
def test_targets_are_read_back_or_bounded(can_id, rpm, acc, counts):
    data = data_of(mks.pack_target(can_id, rpm, acc, counts), 8)
    assert data[0] == 0xF5 and data == summed(data[:7], can_id)
    assert (int.from_bytes(data[1:3], "big"), data[3]) == (rpm, acc)
    assert int.from_bytes(data[4:7], "big", signed=True) == min(max(counts, -FARTHEST_COUNTS), FARTHEST_COUNTS)


@relaxed
@given(st.integers(1, 2047), st.integers(-(2**47), 2**47 - 1), st.integers(0, 63))
def test_positions_are_read_back_and_no_garbled_bit_is_believed(can_id, counts, bit):
    data = summed(b"\x31" + counts.to_bytes(6, "big", signed=True), can_id)
    assert mks.counts_of(word(data)) == counts and mks.is_sound(can_id, word(data), 8)
    assert not mks.is_sound(can_id, word(data) ^ word((1 << bit).to_bytes(8, "little")), 8)


# --- what it makes of answers ---------------------------------------------------------------------------


def hear(loop_and_state, data: bytes, kind: int = STANDARD, frame_id: int = CAN_ID):
    loop, state = loop_and_state
    take_frame(loop[0], state[0], frame_id, kind, len(data), word(data), 5_000_000)
    return loop[0]["axes"][JOINT]


def test_a_position_is_the_joints_angle(loop):
    joint = ARM.joints[JOINT]
    axis = hear(loop, summed(b"\x31" + (16384 * 25).to_bytes(6, "big", signed=True)))
    assert axis["heard"] == 1
    assert axis["heard_rad"] == pytest.approx(2 * np.pi - joint.zero_rad)


def test_status_is_of_two_answers(loop):
    axis = hear(loop, summed(b"\x3e\x00"))
    assert axis["status_readings"] == 0  # whether it is enabled is not known yet
    assert hear(loop, summed(b"\x3a\x01"))["status"] == status.ENABLED | status.ANSWERED
    tripped = status.ENABLED | status.PROTECTED | status.STALLED | status.ANSWERED
    assert hear(loop, summed(b"\x3e\x01"))["status"] == tripped
    assert axis["bad_statuses"] == 1
    assert hear(loop, summed(b"\x3a\x01"))["status"] == tripped
    assert hear(loop, summed(b"\x3e\x00"))["status"] == status.ENABLED | status.ANSWERED
    assert axis["bad_statuses"] == 0
    assert hear(loop, summed(b"\x3a\x00"))["status"] == status.ANSWERED
    assert axis["bad_statuses"] == 1


@pytest.mark.parametrize(("result", "refusals"), [(0, 1), (1, 0), (2, 0), (3, 1), (5, 0)])
def test_results_of_a_target(loop, result, refusals):
    assert hear(loop, summed(bytes((0xF5, result))))["refusals"] == refusals


@relaxed
@given(st.binary(max_size=8), st.sampled_from([STANDARD, EXTENDED, REMOTE]), st.booleans())
def test_whatever_comes_a_position_is_only_believed_as_one(data, kind, close):
    state = np.zeros(1, layout.STATE)
    made = new_loop(ARM, state.ctypes.data, 0)
    data = summed(data[:7]) if close else data
    axis = hear((made, state), data, kind)
    position = kind == STANDARD and len(data) == 8 and data[0] == 0x31 and data == summed(data[:7])
    assert axis["heard"] == int(position)
    assert (
        np.isfinite(axis["heard_rad"])
        and axis["status"] & ~(status.ENABLED | status.PROTECTED | status.STALLED | status.ANSWERED) == 0
    )


@pytest.mark.parametrize(
    "data",
    [
        bytes.fromhex("31 34"),  # a question, as an adapter that echoes brings it back
        bytes.fromhex("3A 3D"),
        bytes.fromhex("F5 02 58 02 00 40 00 94"),
        summed(bytes.fromhex("31 00 00 00 00 00")),  # too short
        summed(bytes.fromhex("3A 02")),  # no value that it has
        summed(bytes.fromhex("3A 01 00")),
        summed(bytes.fromhex("31 00 00 00 00 00 00"), can_id=4),  # the sum of another's
    ],
)
def test_what_is_no_answer_changes_nothing(loop, data):
    before = loop[0][0]["axes"][JOINT].tobytes()
    assert hear(loop, data).tobytes() == before


# --- commands of the cycle ------------------------------------------------------------------------------


def led(joint: int, position_rad: float, velocity_rad_s: float):
    """A loop whose joint is commanded to move evenly and follows exactly."""
    loop = new_loop(ARM, 0, 0)
    axis = loop[0]["axes"][joint]
    axis["position_rad"] = axis["reference_rad"] = axis["measured_rad"] = position_rad
    axis["velocity_rad_s"] = axis["next_velocity_rad_s"] = velocity_rad_s
    axis["next_position_rad"] = position_rad + velocity_rad_s * ARM.control.period_ns * 1e-9
    return loop


def command(loop, joint: int) -> tuple[int, int, int]:
    """(rpm, acc, counts) of what leads a joint's drive, as it would read them."""
    data = data_of(mks.command(loop[0], joint), 8)
    assert data[0] == 0xF5 and data == summed(data[:7], joint + 1)
    return int.from_bytes(data[1:3], "big"), data[3], int.from_bytes(data[4:7], "big", signed=True)


@relaxed
@given(st.integers(0, 5), st.floats(0, 1), st.floats(-1, 1))
def test_a_command_leads_the_drive_but_never_out_of_its_limits(joint, place, pace):
    config = ARM.joints[joint]
    position = config.lower_rad + place * (config.upper_rad - config.lower_rad)
    velocity = pace * config.max_velocity_rad_s
    rpm, acc, counts = command(led(joint, position, velocity), joint)
    assert 1 <= rpm <= config.motor_rpm + 1
    # the ramp of silence: 1 rpm every (256 - acc) · 50 µs, between 1.5 and 2 times the joint's limit
    ramp = 20_000 / (256 - acc) * 2 * math.pi / 60 / config.ratio
    assert 1.5 <= ramp / config.max_acceleration_rad_s2 <= 2.0
    target = counts / 16384 * 2 * math.pi / config.ratio * config.direction - config.zero_rad
    slack = config.command_pulse_rad * 2.5  # a step of a command and one of a reading, rounded
    assert config.lower_rad - slack <= target <= config.upper_rad + slack
    if config.lower_rad < target < config.upper_rad and abs(velocity) > config.command_pulse_rad / 0.006:
        assert (target - position) * velocity > 0  # ahead of the joint, on its way


@relaxed
@given(st.integers(0, 5), st.floats(0.01, 1))
def test_the_rounding_of_the_speed_is_carried_over(joint, pace):
    """The mean of the whole rpm that are sent is the speed that was meant."""
    config = ARM.joints[joint]
    rpm_meant = max(pace * config.motor_rpm, 1.0)
    loop = led(joint, (config.lower_rad + config.upper_rad) / 2, rpm_meant / config.ratio * 2 * math.pi / 60)
    sent = [command(loop, joint)[0] for _ in range(200)]
    assert max(sent) - min(sent) <= 1
    assert np.mean(sent) == pytest.approx(rpm_meant, abs=0.01)


def test_a_joint_that_stands_is_told_where_it_stands():
    """With a speed: a speed of 0 is the halt, after which nothing would be led."""
    for joint, config in enumerate(ARM.joints):
        angle = (config.lower_rad + config.upper_rad) / 2
        rpm, _, counts = command(led(joint, angle, 0.0), joint)
        assert rpm == 1
        assert counts == round((angle + config.zero_rad) * config.ratio / (2 * math.pi) * 16384)


@pytest.mark.parametrize("joint", range(6))
def test_the_halt_carries_the_ramp_of_silence(loop, joint):
    made, _ = loop
    acc = int(made[0]["joints"][joint]["acc_byte"])
    halt = data_of(mks.closed(joint + 1, mks.halt(made[0], joint), 7), 8)
    assert halt == summed(bytes((0xF5, 0, 0, acc, 0, 0, 0)), joint + 1)
    assert mks.is_stop(made[0], joint, joint + 1, word(halt))
    assert not mks.is_stop(made[0], joint, joint + 1, word(summed(b"\xf7", joint + 1)))
