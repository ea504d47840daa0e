"""From readings to a motion: near the hand, never faster than it, never beyond the arm, judged by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from depth import examples
from hand_readings import ENCODER_RAD, Way, limits, readings
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.distance import cdist

from rtarm.console.errors import Refusal
from rtarm.running.limits import Limits
from rtarm.teach.making import LEAD_S, Taught, make
from rtarm.teach.motion import Motion, curve, extremes, peaks
from rtarm.teach.play import motion_goal

TOLERANCE_RAD = math.radians(0.5)
LIMITS = limits()
STEP_S = 0.001
PACE_RAD_S = 0.25
"""The first joint turns evenly with this, so that where it is tells the hand's time."""


def marked(others: list[Way], pace_rad_s: float = PACE_RAD_S) -> list[Way]:
    """Ways of six joints, the first of them the marker of the hand's time."""

    def marker(times_s: np.ndarray) -> np.ndarray:
        return -1.5 + pace_rad_s * times_s

    return [marker, *others]


def swing(middle: float, size: float, hz: float, phase: float) -> Way:
    return lambda times_s: middle + size * np.sin(2.0 * np.pi * hz * times_s + phase)


MIDDLES = (0.0, 0.0, 1.5, 0.0, 1.5)
ROOM = (1.2, 1.2, 1.5, 1.5, 1.5)


FAST_WRIST = marked([*(swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES[:-1]), swing(1.5, 0.75, 1.125, 0.0)])
FAST_ELBOW = marked(
    [
        swing(0.0, 0.0, 1.0, 0.0),
        swing(0.0, 0.6, 1.1875, 0.0),
        *(swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES[2:-1]),
        swing(1.5, 0.15, 1.0, 0.0),
    ]
)


@st.composite
def hand_ways(draw: st.DrawFn) -> list[Way]:
    """Hands that swing each joint by itself, some far faster than the arm can."""
    ways = []
    for middle, room in zip(MIDDLES, ROOM, strict=True):
        size = draw(st.sampled_from([0.0, 0.01, 0.1, 0.5])) * room
        ways.append(swing(middle, size, draw(st.floats(0.05, 1.2)), draw(st.floats(0.0, 6.28))))
    return marked(ways)


def played(motion: Motion, speed: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """What the arm is told at every millisecond: times (n,), positions (n, joints); from the goal's own fields."""
    points = motion_goal(motion, speed)["trajectory"]["points"]
    times_s = np.array([p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in points])
    way = CubicHermiteSpline(times_s, [p["positions"] for p in points], [p["velocities"] for p in points])
    every_s = np.arange(0.0, times_s[-1], STEP_S)
    return every_s, way(every_s)


def assert_inside_limits(positions_rad: np.ndarray, limits: Limits) -> None:
    """By finite differences, from rest to rest."""
    at_rest = np.concatenate([positions_rad[:1], positions_rad, positions_rad[-1:]])
    speed = np.diff(at_rest, axis=0) / STEP_S
    acceleration = np.diff(positions_rad, 2, axis=0) / STEP_S**2
    assert (np.abs(speed) <= limits.velocity_rad_s * (1.0 + 1e-6)).all()
    assert (np.abs(acceleration) <= limits.acceleration_rad_s2 * (1.0 + 1e-3)).all()
    assert (positions_rad >= limits.lower_rad).all() and (positions_rad <= limits.upper_rad).all()


def taught(ways: list[Way], seconds: float, *, seed: int = 0, tremor_rad: float = 0.0, lost: float = 0.0) -> Taught:
    read = readings(ways, seconds, seed=seed, tremor_rad=tremor_rad, lost=lost)
    return make("episode1", LIMITS, "2026-11-22T12:00:00+00:00", read, TOLERANCE_RAD)


@settings(deadline=None, max_examples=examples(25))
@given(hand_ways(), st.floats(2.0, 8.0), st.integers(0, 1000), st.sampled_from([0.0, 0.1]), st.sampled_from([0.0, 0.4]))
@example(FAST_WRIST, 2.0, 0, 0.0, 0.0)
@example(FAST_WRIST, 2.0, 0, 0.0, 0.4)
@example(FAST_ELBOW, 2.0, 0, 0.0, 0.4)
def test_any_hand_makes_a_motion_near_it_inside_the_limits_and_never_faster(
    ways: list[Way], seconds: float, seed: int, tremor_deg: float, lost: float
) -> None:
    read = readings(ways, seconds, seed=seed, tremor_rad=math.radians(tremor_deg), lost=lost)
    made = make("episode1", LIMITS, "now", read, TOLERANCE_RAD)
    positions_rad = played(made.motion)[1]

    assert_inside_limits(positions_rad, LIMITS)

    # every place of the hand has one on the way that is near it, whenever the arm is there; the hand itself is asked,
    # for a straight line between two readings is farther from a fast hand than the tolerance where some are missing
    begin_s = max(joint.times_s[0] for joint in read) + 1.5 * LEAD_S
    at_s = np.arange(begin_s, min(joint.times_s[-1] for joint in read) - 1.5 * LEAD_S, 0.02)
    where = np.column_stack([way(at_s) for way in ways])
    beside = cdist(where, positions_rad, "chebyshev").min(axis=1).max()
    half_a_step = 0.5 * np.abs(np.diff(positions_rad, axis=0)).max()  # a fast joint goes far in a millisecond
    assert beside <= TOLERANCE_RAD + half_a_step + math.radians(tremor_deg) + ENCODER_RAD
    assert made.motion.deviation_rad <= TOLERANCE_RAD

    # the marker tells the hand's time: what the hand took a second for takes the arm a second or more
    hand_s = (positions_rad[:, 0] - positions_rad[0, 0]) / PACE_RAD_S
    apart = 500
    passed_s = hand_s[apart:] - hand_s[:-apart]
    blur_s = 2.0 * TOLERANCE_RAD / PACE_RAD_S
    assert (passed_s <= apart * STEP_S + blur_s).all()
    assert made.motion.duration_s >= made.hand_s - 1e-6

    # and slower only as far as needed: evenly slowed down it would take this long
    assert made.motion.duration_s <= made.hand_s * evenly_slowed(ways, seconds, tremor_deg) * 1.5 + 2.0


def evenly_slowed(ways: list[Way], seconds: float, tremor_deg: float) -> float:
    """By how much a hand must be slowed down as a whole, with the tremor that smoothing may leave."""
    times_s = np.arange(0.0, seconds, 0.001)
    way = np.column_stack([way(times_s) for way in ways])
    speed = np.abs(np.gradient(way, times_s, axis=0)).max(0)
    bend = np.abs(np.gradient(np.gradient(way, times_s, axis=0), times_s, axis=0))[5:-5].max(0)
    left = math.radians(tremor_deg) * (2.0 * math.pi * 9.0) ** 2
    return float(
        max(1.0, (speed / LIMITS.velocity_rad_s).max(), np.sqrt((bend + left) / LIMITS.acceleration_rad_s2).max())
    )


def test_a_slow_hand_keeps_its_rhythm_pauses_included() -> None:
    def with_pause(times_s: np.ndarray) -> np.ndarray:
        first, second = (np.clip((times_s - begin) / 2.0, 0.0, 1.0) for begin in (0.5, 5.5))
        return 0.2 * (first**3 * (10 - 15 * first + 6 * first**2) + second**3 * (10 - 15 * second + 6 * second**2))

    made = taught(
        [with_pause, *(swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES)], 9.0, tremor_rad=math.radians(0.05)
    )
    assert made.slowed == ()
    assert made.motion.duration_s == pytest.approx(made.hand_s, abs=0.15)
    times_s, positions_rad = played(made.motion)
    stands = np.abs(positions_rad[:, 0] - 0.2) < math.radians(0.5)
    assert times_s[stands].max() - times_s[stands].min() == pytest.approx(3.0 + 2 * 0.28, abs=0.3)


def test_only_the_part_that_is_too_fast_is_slower() -> None:
    """A marker that turns evenly, and in the middle a joint that swings far too fast for a second."""

    def burst(times_s: np.ndarray) -> np.ndarray:
        inside = np.clip((times_s - 4.0) / 1.0, 0.0, 1.0)
        return 0.5 * inside**3 * (10 - 15 * inside + 6 * inside**2)

    made = taught(marked([burst, *(swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES[1:])]), 8.0)
    assert made.slowed == ("joint2",)
    times_s, positions_rad = played(made.motion)
    hand_s = (positions_rad[:, 0] + 1.5) / PACE_RAD_S
    pace = np.gradient(hand_s, times_s)
    early, amid, late = (pace[(hand_s > begin) & (hand_s < end)] for begin, end in ((0.5, 3.5), (4.4, 4.6), (5.5, 7.5)))
    assert early == pytest.approx(1.0, abs=0.03)
    assert amid.max() < 0.5
    assert late == pytest.approx(1.0, abs=0.03)
    assert_inside_limits(positions_rad, LIMITS)


def test_a_joint_led_beyond_its_limits_stays_inside_and_is_told_of() -> None:
    upper_rad = LIMITS.upper_rad[2]
    ways = [swing(0.0, 0.0, 1.0, 0.0) for _ in range(6)]
    ways[2] = lambda times_s: upper_rad - 0.1 + 0.2 * np.sin(np.pi * np.clip(times_s - 1.0, 0.0, 4.0) / 4.0)
    made = taught(ways, 6.0)
    assert list(made.beyond_rad) == ["joint3"]
    assert made.beyond_rad["joint3"] == pytest.approx(0.1, abs=1e-3)
    highest = extremes(made.motion.curve)[1][2]
    assert upper_rad - 2 * TOLERANCE_RAD < highest < upper_rad


def test_the_still_parts_at_both_ends_are_cut() -> None:
    def late(times_s: np.ndarray) -> np.ndarray:
        return 0.3 * np.clip((times_s - 5.0) / 3.0, 0.0, 1.0)

    made = taught([late, *(swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES)], 20.0, tremor_rad=math.radians(0.05))
    assert made.hand_s == pytest.approx(3.0 + 2 * LEAD_S, abs=0.5)


@pytest.mark.parametrize("seconds", [0.0, 0.02, 1.0, 20.0])
def test_no_motion_is_none(seconds: float) -> None:
    still = [swing(middle, 0.0, 1.0, 0.0) for middle in (0.0, *MIDDLES)]
    with pytest.raises(Refusal, match=r"Nothing was saved\."):
        taught(still, seconds, tremor_rad=math.radians(0.05))


def test_a_second_of_motion_is_enough() -> None:
    made = taught(marked([swing(middle, 0.02, 1.0, 0.0) for middle in MIDDLES]), 1.0)
    assert 0.5 < made.hand_s < 1.0
    assert_inside_limits(played(made.motion)[1], LIMITS)


def test_readings_that_jump_are_no_motion_of_this_arm_or_a_slow_one() -> None:
    """A hand cannot, but drives whose readings come in bursts can look so."""
    ways = marked([swing(middle, 0.0, 1.0, 0.0) for middle in MIDDLES])
    ways[1] = lambda times_s: np.where(times_s < 2.0, 0.0, 0.3)
    made = taught(ways, 4.0)
    assert_inside_limits(played(made.motion)[1], LIMITS)
    assert made.motion.deviation_rad <= TOLERANCE_RAD


@settings(deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 12))
def test_peaks_are_what_looking_closely_finds(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    times_s = np.cumsum(random.uniform(0.05, 1.0, count))
    path = curve(times_s, random.normal(size=(count, 2)))
    close_s = np.linspace(times_s[0], times_s[-1], 20_000)
    speed, acceleration = peaks(path)
    assert np.abs(path(close_s, 1)).max(0) == pytest.approx(speed, rel=1e-4)
    assert np.abs(path(close_s, 2)).max(0) == pytest.approx(acceleration, rel=1e-2)
    assert (np.abs(path(close_s, 1)).max(0) <= speed * (1 + 1e-12)).all()


def test_the_largest_factor_is_the_one_at_which_a_limit_is_reached() -> None:
    made = taught(marked([swing(middle, 0.1, 0.3, 0.0) for middle in MIDDLES]), 6.0)
    fastest = made.motion.fastest()
    assert fastest >= 1.0
    assert_inside_limits(played(made.motion, fastest)[1], LIMITS)
    with pytest.raises(AssertionError):
        assert_inside_limits(played(made.motion, fastest * 1.02)[1], LIMITS)
