"""What holds for every codec of a drive, whatever the numbers: judged by `codec_drives`, none of which is our code."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from codec_drives import DRIVES, RPM, Drive
from codec_rig import Rig, families, frame_of, golden
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.memory import status
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.link import TX_BYTES
from shm.words import Fault

relaxed = settings(deadline=None, max_examples=examples(60))  # of each of nine drives
KNOWN_STATUS = sum(value for name, value in vars(status).items() if name.isupper())
every_drive = pytest.mark.parametrize("kind", DRIVES, ids="-".join)
Kind = tuple[str, str]
Mount = tuple[int, int, float]


def chosen(*conditions: Callable[[Drive], bool]) -> Any:
    kinds = [kind for kind, drive in DRIVES.items() if all(holds(drive) for holds in conditions)]
    return pytest.mark.parametrize("kind", kinds, ids="-".join)


mounts = st.tuples(st.integers(0, 2), st.sampled_from([1, -1]), st.sampled_from([0.0, 10.0, -90.0]))
"""Which of a drive's gears, direction, zero (degrees)."""
shares = st.floats(0, 1)
paces = st.one_of(st.just(0.0), st.floats(0.001, 1), st.floats(-1, -0.001))
errors = st.sampled_from([0.0, 0.2, -0.2])


def rig_of(kind: Kind, mount: Mount) -> Rig:
    """A joint with such a drive, mounted like that."""
    gear, direction, zero_deg = mount
    ratio = DRIVES[kind].gears[gear]
    rpm = 60 if ratio <= 2 else 600
    return Rig.named(*kind, ratio=ratio, motor_rpm=rpm, direction=direction, zero_deg=zero_deg)


def moving(kind: Kind, mount: Mount, place: float, pace: float, error_rad: float = 0.0) -> Rig:
    """The same at a share of its range, at a share of its highest speed, and behind by an error."""
    rig = rig_of(kind, mount)
    config = rig.config
    position = config.lower_rad + place * (config.upper_rad - config.lower_rad)
    rig.stands(position, pace * config.max_velocity_rad_s)
    rig.axis["measured"]["position_rad"], rig.axis["tracking"]["error_before_rad"] = position - error_rad, error_rad
    return rig


def command(rig: Rig, drive: Drive) -> tuple[float, float]:
    """Angle and speed of the joint (rad, rad/s) that its drive makes of what leads it."""
    read = drive.reads([frame_of(text)[0].data for text in rig.sends("lead")])
    config = rig.config
    return (
        seen(rig, drive, config.direction * read.rad / config.ratio - config.zero_rad),
        (read.rad_s if drive.plans else config.direction * read.rad_s) / config.ratio,
    )


def seen(rig: Rig, drive: Drive, angle_rad: float) -> float:
    """An angle of the joint; where it comes round each turn of the drive, the one that is nearest to its middle."""
    if not drive.comes_round:
        return angle_rad
    middle_rad = (rig.config.lower_rad + rig.config.upper_rad) / 2
    return middle_rad + math.remainder(angle_rad - middle_rad, 2 * math.pi / rig.config.ratio)


def test_every_family_with_golden_frames_has_its_laws() -> None:
    assert {family for family, _ in DRIVES} == set(families())


# --- what leads a drive ---------------------------------------------------------------------------------------


@every_drive
@relaxed
@given(mounts, shares, paces, errors)
def test_no_command_leads_out_of_the_limits(
    kind: Kind, mount: Mount, place: float, pace: float, error_rad: float
) -> None:
    rig, drive = moving(kind, mount, place, pace, error_rad), DRIVES[kind]
    target, speed = command(rig, drive)
    config, slack = rig.config, 3 * rig.config.command_pulse_rad
    assert config.lower_rad - slack <= target <= config.upper_rad + slack
    if drive.plans:
        step = drive.step_rad_s / config.ratio
        assert 0.0 < speed <= (1.05 if error_rad else 1.0) * config.max_velocity_rad_s * (1 + 1e-6) + step


@chosen(lambda drive: drive.plans)
@relaxed
@given(mounts, shares, paces, errors)
def test_a_target_lies_so_far_ahead_that_the_speed_alone_sets_the_pace(
    kind: Kind, mount: Mount, place: float, pace: float, error_rad: float
) -> None:
    """By the way of the period after this one, and what its ramp needs or where its own loop begins to slow down."""
    rig, drive = moving(kind, mount, place, pace, error_rad), DRIVES[kind]
    target, speed = command(rig, drive)
    config, axis = rig.config, rig.axis
    ahead = target - axis["commanded"]["next_position_rad"]
    if pace == 0.0 or not config.lower_rad < target < config.upper_rad:
        return
    sure = max(speed - drive.step_rad_s / config.ratio, 0.0)
    brakes = sure**2 / (2 * 2.1 * config.max_acceleration_rad_s2) if drive.loop_s == 0.0 else sure * drive.loop_s
    assert abs(ahead) >= sure * rig.period_s + brakes - drive.off_rad / config.ratio
    if error_rad == 0.0 and abs(axis["commanded"]["velocity_rad_s"]) * rig.period_s > 2 * config.command_pulse_rad:
        assert ahead * pace > 0


@chosen(lambda drive: not drive.plans)
@relaxed
@given(mounts, st.floats(0.1, 0.9), paces)
def test_a_setpoint_is_read_as_it_was_meant(kind: Kind, mount: Mount, place: float, pace: float) -> None:
    """Within a step of its fields: where the joint is in this period or the next, and how fast."""
    rig, drive = moving(kind, mount, place, pace), DRIVES[kind]
    target, speed = command(rig, drive)
    position, velocity, step = (
        rig.axis["commanded"]["position_rad"],
        rig.axis["commanded"]["velocity_rad_s"],
        drive.off_rad / rig.config.ratio,
    )
    way = velocity * rig.period_s
    assert min(0, 2 * way) - step <= target - position <= max(0, 2 * way) + step
    assert abs(target - position) >= 0.5 * abs(way) - step
    if not math.isnan(drive.step_rad_s):
        assert speed == pytest.approx(velocity, abs=drive.step_rad_s / rig.config.ratio)


@every_drive
@relaxed
@given(mounts, shares)
def test_a_joint_that_stands_is_told_where_it_stands(kind: Kind, mount: Mount, place: float) -> None:
    """With a speed, where there is one: with none it would be no limit at all, or nothing would be led."""
    rig, drive = moving(kind, mount, place, 0.0), DRIVES[kind]
    target, speed = command(rig, drive)
    assert target == pytest.approx(rig.axis["commanded"]["position_rad"], abs=1.01 * drive.off_rad / rig.config.ratio)
    if drive.rounds:
        assert speed == pytest.approx(drive.step_rad_s / rig.config.ratio)
    elif drive.plans:
        assert speed == pytest.approx(0.25 * rig.config.max_velocity_rad_s, rel=1e-6)


@chosen(lambda drive: drive.rounds)
@settings(deadline=None, max_examples=examples(25))
@given(mounts, st.floats(0.01, 1))
def test_the_rounding_of_the_speed_is_carried_over(kind: Kind, mount: Mount, pace: float) -> None:
    """The mean of the whole numbers that are sent is the speed that was meant."""
    rig, drive = rig_of(kind, mount), DRIVES[kind]
    step = drive.step_rad_s / rig.config.ratio
    velocity = max(pace * rig.config.max_velocity_rad_s, step)
    rig.stands(0.0, velocity)
    sent = [round(command(rig, drive)[1] / step) for _ in range(200)]
    assert max(sent) - min(sent) <= 1
    assert np.mean(sent) == pytest.approx(velocity / step, abs=0.01)


@chosen(lambda drive: drive.acc > 0)
@pytest.mark.parametrize("gear", range(3))
def test_the_ramp_of_silence_is_that_of_every_motion(kind: Kind, gear: int) -> None:
    """1 rpm every (256 - acc) · 50 µs: between 1.5 and 2 times the joint's limit, but for the steps of acc."""
    rig, drive = rig_of(kind, (gear, 1, 0.0)).stands(0.0), DRIVES[kind]
    acc = b"".join(frame_of(text)[0].data for text in rig.sends("lead"))[drive.acc]
    coarse = 1 / (256 - acc)
    ramp = 20_000 * coarse * RPM / rig.config.ratio / rig.config.max_acceleration_rad_s2
    assert 1.5 * (1 - coarse) <= ramp <= 2.0 * (1 + coarse)


@every_drive
@pytest.mark.parametrize(
    ("part", "word"),
    [
        ("commanded", "next_position_rad"),
        ("commanded", "next_velocity_rad_s"),
        ("commanded", "next_acceleration_rad_s2"),
        ("measured", "position_rad"),
        ("tracking", "error_before_rad"),
    ],
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_becomes_one_on_the_wire(kind: Kind, part: str, word: str, value: float) -> None:
    """Neither of the setpoint nor of what a family makes of it; what does not matter to a family is as ever."""
    rig, sound = (Rig.named(*kind).stands(0.0, 0.1) for _ in range(2))
    rig.axis[part][word] = value
    sent, fault, config = rig.sends("lead"), rig.record["fault"], rig.config
    if not sent:
        assert (fault["code"], fault["joint"], fault["limit"]) == (Fault.NOT_FINITE, 0, 0.0)
        assert not math.isfinite(fault["value"])
        assert rig.record["motion"]["per_joint_stop"] == 1 and rig.axis["sent"]["stop_frames_due"] > 0
    elif sent != sound.sends("lead"):
        assert math.isinf(value) and part != "commanded", "an error takes back no more than it may"
        read = DRIVES[kind].reads([frame_of(text)[0].data for text in sent])
        angle_rad = config.direction * read.rad / config.ratio - config.zero_rad
        slack_rad = 3 * config.command_pulse_rad
        assert config.lower_rad - slack_rad <= angle_rad <= config.upper_rad + slack_rad
        assert abs(read.rad_s) <= config.ratio * 1.05 * config.max_velocity_rad_s
    assert math.isfinite(rig.axis["sent"]["rpm_remainder"])


@every_drive
def test_a_setpoint_that_is_no_number_stops_the_joint_in_a_fault_as_well(kind: Kind) -> None:
    rig = Rig.named(*kind).stands(0.0, 0.1)
    rig.axis["commanded"]["next_acceleration_rad_s2"] = math.nan
    rig.record["fault"]["code"] = Fault.COMMAND_RING  # in which the path is trusted
    assert rig.sends("lead") == [] and rig.record["fault"]["code"] == Fault.COMMAND_RING
    assert rig.record["motion"]["per_joint_stop"] == 1 and rig.axis["sent"]["stop_frames_due"] > 0


@every_drive
def test_where_there_is_no_room_nothing_is_said(kind: Kind) -> None:
    rig = Rig.named(*kind).stands(0.0)
    rig.axis["measured"]["readings"] = 1
    rig.record["buses"][0]["outgoing"]["length"] = TX_BYTES - 1
    for function in ("lead", "ask_position", "ask_status"):
        getattr(rig.codec, function)(rig.record, 0, rig.shared[0])
    assert not rig.codec.stop(rig.record, 0, rig.shared[0])
    assert (rig.record["buses"][0]["outgoing"]["frames"], rig.axis["reply"]["questions"]) == (0, 0)
    assert len(rig.sends("ask_position")) == DRIVES[kind].is_asked, "it has not been asked yet"


@every_drive
def test_an_echo_of_what_was_sent_tells_nothing(kind: Kind) -> None:
    """Every frame comes back, as adapters with local echo do."""
    rig = Rig.named(*kind).stands(0.5)
    rig.axis["measured"]["readings"] = 1
    sent = [text for function in ("lead", "ask_position", "ask_status", "stop") for text in rig.sends(function)]
    assert sent
    before = rig.axis.tobytes()
    assert rig.hears(*sent) == {}
    assert rig.axis.tobytes() == before


# --- what a drive tells ---------------------------------------------------------------------------------------


@every_drive
@relaxed
@given(mounts, st.floats(-12.5, 12.5), st.floats(-30, 30), st.floats(-28, 28), st.integers(-128, 127))
def test_what_a_drive_says_of_itself_is_the_joints(
    kind: Kind, mount: Mount, rad: float, rad_s: float, nm: float, celsius: int
) -> None:
    """Behind its gear, in its direction and from its zero."""
    rig = rig_of(kind, mount)
    config, said = rig.config, DRIVES[kind].says(rad, rad_s, nm, celsius)
    exactly = {
        "position_rad": seen(rig, DRIVES[kind], config.direction * said.rad / config.ratio - config.zero_rad),
        "velocity_rad_s": config.direction * said.rad_s / config.ratio,
        "effort_nm": config.direction * said.nm * config.ratio,
        "temperature_c": said.celsius,
    }
    told = rig.hears(*said.frames)
    for name, value in exactly.items():
        assert math.isnan(value) == (name not in told), name
        if name in told:
            assert told[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


@st.composite
def spoilt(draw: st.DrawFn, family: str) -> tuple[int, bytes]:
    """A golden frame with other bytes in it, or none that has ever been seen."""
    texts = [text for vector in golden(family)["vectors"] for text in vector.get("hears", ())]
    frame, _ = frame_of(draw(st.sampled_from(texts + golden(family)["ignored"])))
    data = bytearray(draw(st.one_of(st.just(frame.data), st.binary(max_size=8))))
    for at, value in draw(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 255)), max_size=3)):
        data[at : at + 1] = bytes((value,))
    return frame.id, bytes(data[: draw(st.integers(0, 8))] if draw(st.booleans()) else data)[:8]


@every_drive
@settings(deadline=None, max_examples=examples(200))
@given(data=st.data(), form=st.sampled_from([STANDARD, EXTENDED, EXTENDED, STANDARD | REMOTE, EXTENDED | REMOTE]))
def test_whatever_comes_only_a_position_is_taken_for_one_and_no_number_is_none(
    kind: Kind, data: st.DataObject, form: int
) -> None:
    family, drive = kind[0], DRIVES[kind]
    frame_id, content = data.draw(spoilt(family))
    if not form & EXTENDED:
        frame_id &= 0x7FF
    rig = Rig.named(*kind)
    rig.takes(frame_id, content, form)
    told = rig.told()
    own_form = EXTENDED if family in ("zdt", "robstride", "vesc") else STANDARD
    assert ("position_rad" in told) == (form == own_form and drive.is_position(frame_id, content))
    assert all(math.isfinite(value) for value in told.values())
    assert told.get("status", 0) & ~KNOWN_STATUS == 0


@pytest.mark.parametrize("family", families())
@relaxed
@given(frame_id=st.integers(0, 0x1FFFFFFF), data=st.binary(max_size=8), form=st.sampled_from([STANDARD, EXTENDED]))
def test_frames_of_any_identifier_are_understood_or_left(family: str, frame_id: int, data: bytes, form: int) -> None:
    rig = Rig.named(family)
    rig.takes(frame_id if form else frame_id & 0x7FF, data, form)
    assert all(math.isfinite(value) for value in rig.told().values())
