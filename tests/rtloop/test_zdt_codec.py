"""ZDT frames: the bytes of the protocol notes, echoes that are no replies, and targets read back.

The decoder of commands in this file is written from the protocol notes alone (FD: direction, rpm16, acc,
pulses32, mode, sync, 6B, big-endian, split after eight bytes with the function repeated).
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.loader import load_arm
from rtloop import status
from rtloop.beginning import new_loop
from rtloop.cycle import step
from rtloop.drives import zdt
from rtloop.measured import take_frame
from shm import layout
from shm.words import Mode

relaxed = settings(deadline=None)  # the first call loads the compiled cycle
ARM = load_arm("episode1")


def word(text):
    """Hex digits as the codec's data word, first byte lowest."""
    return int.from_bytes(bytes.fromhex(text).ljust(8, b"\0"), "little", signed=True)


def data_of(value, length):
    return (int(value) % 2**64).to_bytes(8, "little")[:length]


def decode(text, packet=0):
    data = bytes.fromhex(text)
    return tuple(int(value) for value in zdt.decode(packet, len(data), word(text)))


def read_position_command(first, second):
    """(rpm, acc, pulses, mode, sync) of the two packets of an FD, as a drive would read them."""
    assert first[0] == second[0] == 0xFD
    whole = first + second[1:]
    assert len(first) == 8 and len(second) == 5 and whole[-1] == 0x6B
    assert whole[1] in (0, 1)
    pulses = int.from_bytes(whole[5:9], "big")
    return int.from_bytes(whole[2:4], "big"), whole[4], -pulses if whole[1] else pulses, whole[9], whole[10]


# --- golden bytes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("pulses", "text"), [(3200, "FC 00 00 0C 80 6B"), (-3200, "FC FF FF F3 80 6B")])
def test_fast_target_as_in_the_notes(pulses, text):
    assert data_of(zdt.pack_fast_target(pulses), 6) == bytes.fromhex(text)


@relaxed
@given(st.integers(-(2**40), 2**40))
def test_fast_targets_are_read_back_or_bounded(pulses):
    data = data_of(zdt.pack_fast_target(pulses), 8)
    assert data[0] == 0xFC and data[5:] == b"\x6b\x00\x00"
    assert int.from_bytes(data[1:5], "big", signed=True) == min(max(pulses, -(2**31)), 2**31 - 1)


def test_position_command_as_in_the_notes_but_absolute():
    """`FD 01 0F A0 00 00 01 FA` + `FD 00 00 00 6B`: CCW, 4000 rpm, acc 0, 129536 pulses, relative, no sync.

    Ours differ in the mode byte: targets are absolute, so that a lost frame costs nothing.
    """
    first, second = zdt.pack_target(4000, 0, -129_536)
    assert data_of(first, 8) == bytes.fromhex("FD 01 0F A0 00 00 01 FA")
    assert data_of(second, 5) == bytes.fromhex("FD 00 01 00 6B")


@pytest.mark.parametrize(
    ("value", "length", "text"),
    [(zdt.READ_POSITION, 2, "36 6B"), (zdt.READ_STATUS, 2, "3A 6B"), (zdt.STOP, 4, "FE 98 00 6B")],
)
def test_short_commands(value, length, text):
    assert data_of(value, length) == bytes.fromhex(text)
    assert value >> (8 * length) == 0


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("36 01 00 01 00 00 6B", -65536),
        ("36 00 00 00 00 00 6B", 0),
        ("36 01 00 00 00 00 6B", 0),
        ("36 00 7F FF FF FF 6B", 2**31 - 1),
        ("36 01 FF FF FF FF 6B", -(2**32 - 1)),
    ],
)
def test_positions(text, counts):
    assert decode(text) == (zdt.POSITION, counts)
    assert zdt.decode.py_func(0, 7, word(text)) == (zdt.POSITION, counts)


@pytest.mark.parametrize(
    ("flags", "bits"),
    [
        (0x83, status.ENABLED | status.REACHED | status.POWER_LOST),
        (0x03, status.ENABLED | status.REACHED),
        (0x00, 0),
        (0x0D, status.ENABLED | status.STALLED | status.PROTECTED),
        (0x30, 0),  # limit switches, which this arm has none of
    ],
)
def test_status_flags(flags, bits):
    assert decode(f"3A {flags:02X} 6B") == (zdt.STATUS, bits)


@pytest.mark.parametrize(
    ("text", "kind", "function"),
    [
        ("FD 02 6B", zdt.ACCEPTED, 0xFD),
        ("FE 02 6B", zdt.ACCEPTED, 0xFE),
        ("FD E2 6B", zdt.REFUSED, 0xFD),
        ("00 EE 6B", zdt.REFUSED, 0x00),
        ("36 EE 6B", zdt.REFUSED, 0x36),
        ("FD 9F 6B", zdt.OTHER, 0),  # motion complete
    ],
)
def test_acknowledgements_and_refusals(text, kind, function):
    assert decode(text) == (kind, function)


# --- what is no reply -----------------------------------------------------------------------------------

REQUESTS = [
    "36 6B",
    "3A 6B",
    "FE 98 00 6B",
    "1F 6B",
    "33 6B",
    "42 6C 6B",
    "43 7A 6B",
    "F3 AB 01 00 6B",
    "0E 52 6B",
]
"""What the master sends in one frame; an adapter may echo it under the very id of the reply."""


@pytest.mark.parametrize("text", REQUESTS)
def test_echoes_of_requests_are_never_replies(text):
    assert decode(text) == (zdt.OTHER, 0)


@relaxed
@given(st.integers(0, 3000), st.integers(0, 255), st.integers(-(2**32) + 1, 2**32 - 1))
def test_echoes_of_position_commands_are_never_replies(rpm, acc, pulses):
    first, second = zdt.pack_target(rpm, acc, pulses)
    assert zdt.decode(0, 8, first)[0] == zdt.OTHER
    for packet in (0, 1):
        assert zdt.decode(packet, 5, second)[0] == zdt.OTHER


def test_an_echo_of_what_the_cycle_sent_changes_nothing_measured():
    """Every frame of a cycle comes back, as adapters with local echo do."""
    shared = np.zeros(1, layout.STATE)
    loop = new_loop(ARM, shared.ctypes.data, 0)
    loop[0]["core"]["mode"] = Mode.HOLDING
    count = step(loop[0], shared[0], 1_000_000)
    lines = loop[0]["tx"][:count].tobytes().split(b"\r")[:-1]
    assert len(lines) == 7
    for line in lines:
        data = bytes.fromhex(line[10:].decode())
        frame_id = int(line[1:9], 16)
        take_frame(loop[0], shared[0], frame_id, 1, len(data), word(data.hex()), 2_000_000)
    axes = loop[0]["axes"][:6]
    assert not axes["readings"].any() and not axes["status_readings"].any()
    assert (axes["unanswered_since_ns"] == 1_000_000).all()


@pytest.mark.parametrize(
    ("packet", "text"),
    [
        (1, "36 01 00 01 00 00 6B"),
        (0, "36 01 00 01 00 00 6C"),  # another checksum
        (0, "36 01 00 01 00 6B"),
        (0, "36 01 00 01 00 00 00 6B"),
        (0, "35 01 05 DC 6B"),
        (0, "37 01 00 00 00 08 6B"),
        (0, "3A 83 6C"),
        (0, "3A 83 00 6B"),
        (0, ""),
    ],
)
def test_frames_that_only_resemble_replies(packet, text):
    assert decode(text, packet)[0] == zdt.OTHER


@relaxed
@given(st.integers(0, 255), st.binary(max_size=8))
def test_any_frame_is_understood_or_left(packet, data):
    kind, value = zdt.decode(packet, len(data), word(data.hex()))
    assert kind in (zdt.OTHER, zdt.POSITION, zdt.STATUS, zdt.REFUSED, zdt.ACCEPTED)
    assert abs(value) < 2**32


def test_frames_of_strangers_and_standard_frames_reach_no_axis():
    loop, shared = new_loop(ARM, 0, 0), np.zeros(1, layout.STATE)
    reply = word("36 01 00 01 00 00 6B")
    for frame_id, extended in ((0x700, 1), (0x1FFFFF00, 1), (0x000, 1), (0x100, 0)):
        take_frame(loop[0], shared[0], frame_id, extended, 7, reply, 5)
    assert not loop[0]["axes"]["readings"].any()


@pytest.mark.parametrize(
    ("frame_id", "text", "changed"),
    [
        (0x300, "36 00 00 01 00 00 6B", {"heard": 1, "questions": 0}),
        (0x300, "3A 03 6B", {"status_readings": 1, "status": status.ENABLED | status.REACHED | status.ANSWERED}),
        (0x300, "FD E2 6B", {"refusals": 1}),
        (0x300, "FC EE 6B", {"refusals": 1}),
        (0x300, "36 E2 6B", {}),  # a question it does not answer is no motion refused
        (0x300, "FD 02 6B", {}),
        (0x301, "FD E2 6B", {}),  # of a second packet
    ],
)
def test_what_a_drive_says_reaches_its_axis(frame_id, text, changed):
    loop, shared = new_loop(ARM, 0, 0), np.zeros(1, layout.STATE)
    axis, data = loop[0]["axes"][2], bytes.fromhex(text)
    axis["questions"] = 1
    expected = {"heard": 0, "questions": 1, "status_readings": 0, "status": 0, "refusals": 0} | changed
    zdt.hear(loop[0], 2, shared[0], frame_id, 1, len(data), word(text), 5_000_000)
    assert {name: int(axis[name]) for name in expected} == expected
    assert shared[0]["counters"]["drive_errors"] == (data[1] in (0xE2, 0xEE) and frame_id == 0x300)
    if "heard" in changed:
        config = ARM.joints[2]
        turned = config.direction * 2 * math.pi / config.ratio - config.zero_rad
        assert axis["heard_rad"] == pytest.approx(turned)
        assert axis["heard_ns"] == 5_000_000 - loop[0]["joints"][2]["reply_delay_ns"]


# --- numbers --------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(0, 3000), st.integers(0, 255), st.integers(-(2**32) + 1, 2**32 - 1))
def test_commands_are_read_back_as_they_were_meant(rpm, acc, pulses):
    first, second = zdt.pack_target(rpm, acc, pulses)
    read = read_position_command(data_of(first, 8), data_of(second, 5))
    assert read == (rpm, acc, pulses, 1, 0)


@relaxed
@given(st.integers(0, 5), st.floats(0, 1))
def test_pulses_and_counts_mean_the_same_angle(joint, share):
    loop, config = new_loop(ARM, 0, 0), ARM.joints[joint]
    angle = config.lower_rad + share * (config.upper_rad - config.lower_rad)
    pulses = zdt.to_pulses(loop[0], joint, angle)
    # joint = motor turns * 360 / ratio - zero, 3200 pulses a turn
    motor_turns = pulses / 3200
    read_rad = config.direction * math.radians(motor_turns * 360 / config.ratio) - config.zero_rad
    assert read_rad == pytest.approx(angle, abs=0.51 * config.command_pulse_rad)
    assert zdt.to_radians(loop[0], joint, round(pulses * 20.48)) == pytest.approx(
        angle, abs=0.51 * (config.command_pulse_rad + config.encoder_count_rad)
    )


def led(joint, position_rad, velocity_rad_s):
    """A loop whose joint is commanded to move evenly and follows exactly."""
    loop = new_loop(ARM, 0, 0)
    axis = loop[0]["axes"][joint]
    axis["position_rad"] = axis["reference_rad"] = axis["measured_rad"] = position_rad
    axis["velocity_rad_s"] = axis["next_velocity_rad_s"] = velocity_rad_s
    axis["next_position_rad"] = position_rad + velocity_rad_s * ARM.control.period_ns * 1e-9
    return loop


joints_and_shares = st.tuples(st.integers(0, 5), st.floats(0, 1), st.floats(-1, 1))


@relaxed
@given(joints_and_shares)
def test_a_command_leads_the_drive_but_never_out_of_its_limits(case):
    joint, place, pace = case
    config = ARM.joints[joint]
    position = config.lower_rad + place * (config.upper_rad - config.lower_rad)
    velocity = pace * config.max_velocity_rad_s
    loop = led(joint, position, velocity)
    first, second = zdt.command(loop[0], joint)
    rpm, acc, pulses, mode, sync = read_position_command(data_of(first, 8), data_of(second, 5))
    assert (mode, sync) == (1, 0)
    assert 1 <= rpm <= config.motor_rpm + 1
    # the ramp of silence: 1 rpm every (256 - acc) · 50 µs, between 1.5 and 2 times the joint's limit
    ramp = 20_000 / (256 - acc) * 2 * math.pi / 60 / config.ratio
    assert 1.4 <= ramp / config.max_acceleration_rad_s2 <= 2.1
    target = pulses / 3200 * 2 * math.pi / config.ratio * config.direction - config.zero_rad
    slack = config.command_pulse_rad * 2
    assert config.lower_rad - slack <= target <= config.upper_rad + slack
    inside = config.lower_rad < target < config.upper_rad
    if inside and abs(velocity) > config.command_pulse_rad / 0.01:
        assert (target - position) * velocity > 0  # ahead of the joint, on its way


@relaxed
@given(st.integers(0, 5), st.floats(0.01, 1))
def test_the_rounding_of_the_speed_is_carried_over(joint, pace):
    """The mean of the whole rpm that are sent is the speed that was meant."""
    config = ARM.joints[joint]
    rpm_meant = max(pace * config.motor_rpm, 1.0)
    velocity = rpm_meant / config.ratio * 2 * math.pi / 60
    loop = led(joint, (config.lower_rad + config.upper_rad) / 2, velocity)
    sent = [
        read_position_command(data_of(first, 8), data_of(second, 5))[0]
        for first, second in (zdt.command(loop[0], joint) for _ in range(200))
    ]
    assert max(sent) - min(sent) <= 1
    assert np.mean(sent) == pytest.approx(rpm_meant, abs=0.01)


def test_a_joint_that_stands_is_told_where_it_stands():
    for joint, config in enumerate(ARM.joints):
        angle = (config.lower_rad + config.upper_rad) / 2
        first, second = zdt.command(led(joint, angle, 0.0)[0], joint)
        rpm, _, pulses, _, _ = read_position_command(data_of(first, 8), data_of(second, 5))
        assert rpm == 1
        assert pulses == round((angle + config.zero_rad) * config.ratio / (2 * math.pi) * 3200)


# --- targets alone ---------------------------------------------------------------------------------------


def driven(position, speed, target, ramp, duration_s):
    """Place and speed of a drive that goes to a target by its ramp for a while: as near to sqrt(2 a d) as it can."""
    steps = 400
    dt = duration_s / steps
    for _ in range(steps):
        gap = target - position
        wanted = math.copysign(math.sqrt(2.0 * ramp * abs(gap)), gap)
        speed += min(max(wanted - speed, -ramp * dt), ramp * dt)
        position += speed * dt
    return position, speed


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("acceleration_share", [0.0, 0.5, -0.5])
def test_targets_alone_lead_a_drive_along_the_plan(direction, acceleration_share):
    """With a new target every period it is on the plan when the next one comes, at an even speed and in a ramp too."""
    joint, delay_s, period_s = 2, 0.002, ARM.control.period_ns * 1e-9
    loop = new_loop(ARM, 0, 0)
    row, axis = loop[0]["joints"][joint], loop[0]["axes"][joint]
    row["command_delay_s"] = delay_s
    ramp = float(row["silence_deceleration_rad_s2"])
    start, acceleration = direction * 0.4, direction * acceleration_share * ramp

    def plan(t):
        return start * t + 0.5 * acceleration * t * t, start + acceleration * t

    position, speed = plan(delay_s)
    worst = 0.0
    for cycle in range(20):
        now_s = cycle * period_s
        axis["position_rad"], axis["velocity_rad_s"] = plan(now_s)
        axis["next_position_rad"], axis["next_velocity_rad_s"] = plan(now_s + period_s)
        axis["next_acceleration_rad_s2"] = acceleration
        axis["reference_rad"] = axis["measured_rad"] = axis["error_before_rad"] = 0.0
        data = data_of(zdt.fast_command(loop[0], joint), 6)
        pulses = int.from_bytes(data[1:5], "big", signed=True)
        target = pulses / float(row["command_per_rad"]) - float(row["zero_rad"])
        position, speed = driven(position, speed, target, ramp, period_s)
        worst = max(worst, abs(position - plan(now_s + period_s + delay_s)[0]))
    assert worst < 0.02 * abs(start) * period_s


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_targets_alone_take_an_error_back_bit_by_bit_and_never_reach_beyond_the_limits(sign):
    """An eighth of a second's share in each period, up to a quarter of what the target lies ahead; none at rest."""
    joint, speed, error = 2, 0.4, sign * 0.004
    loop = led(joint, 0.0, speed)
    config, row, axis = ARM.joints[joint], loop[0]["joints"][joint], loop[0]["axes"][joint]
    period_s, ramp = ARM.control.period_ns * 1e-9, float(row["silence_deceleration_rad_s2"])

    def target():
        pulses = int.from_bytes(data_of(zdt.fast_command(loop[0], joint), 6)[1:5], "big", signed=True)
        return pulses / float(row["command_per_rad"]) - float(row["zero_rad"])

    without = target()
    axis["reference_rad"] += error
    axis["error_before_rad"] = error
    for cycle in (1, 2):
        assert target() - without == pytest.approx(8.0 * period_s * error * cycle, abs=config.command_pulse_rad)
        assert axis["fast_offset_rad"] == pytest.approx(8.0 * period_s * error * cycle)
    for _ in range(100):
        target()
    led_rad_s = speed - ramp * period_s / 4.0
    assert axis["fast_offset_rad"] == pytest.approx(
        sign * 0.25 * (led_rad_s**2 / (2.0 * ramp) + speed * period_s), rel=1e-6
    )
    end_rad = float(row["upper_rad"] + row["slack_rad"])
    axis["next_position_rad"] = end_rad - 1e-4
    assert target() == pytest.approx(end_rad, abs=config.command_pulse_rad)
    axis["velocity_rad_s"] = axis["next_velocity_rad_s"] = 0.0
    axis["next_position_rad"] = 0.1
    assert target() == pytest.approx(0.1, abs=config.command_pulse_rad)
    assert axis["fast_offset_rad"] == 0.0
