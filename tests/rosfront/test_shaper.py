"""Streams that ask for more than the limits allow: plans that follow them, judged by differences of positions."""

from dataclasses import replace

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from streamed import NS, SERVO_POSE_RAD, FollowedArm, Message, recorded_servo

from config.loader import load_arm
from motion import shaping
from rosfront.goal import plan_stream
from rosfront.path import PlannedPath
from rosfront.plan import GoalPlan, Present
from rosfront.refusals import (
    AccelerationBeyondLimit,
    BeyondLimits,
    GoalRefused,
    NotFinite,
    PositionBeyondLimit,
    TooFar,
)
from rosfront.settings import Settings
from rosfront.shaper import FAR_S, STREAM_S, check_room_to_stop, largest_lag

ARM = load_arm("episode1")
NAMES = [joint.name for joint in ARM.joints]
FASTEST = np.array([joint.max_velocity_rad_s for joint in ARM.joints])
HARDEST = np.array([joint.max_acceleration_rad_s2 for joint in ARM.joints])
LOWER = np.array([joint.lower_rad for joint in ARM.joints])
UPPER = np.array([joint.upper_rad for joint in ARM.joints])
NOW_NS = 5 * NS
SOUND_STEP_NS = 2_000_000


def message(times_s: np.ndarray, positions: np.ndarray, velocities: np.ndarray | None) -> Message:
    """Points without a stamp."""
    return Message(0, 0, NAMES, np.round(np.asarray(times_s) * NS).astype(np.int64), positions, velocities)


def followed(asked: Message, state: np.ndarray, *, standing: bool = False, earlier: GoalPlan | None = None) -> GoalPlan:
    """Its plan for an arm that has a state (joints, 2)."""
    commanded = np.concatenate([state, np.zeros((len(state), 1))], axis=1)
    present = Present(commanded, standing, NOW_NS, NOW_NS)
    return plan_stream(asked.trajectory(), ARM, present, Settings.of(ARM), earlier)


def motion_of(plan: GoalPlan, every_ns: int = SOUND_STEP_NS) -> np.ndarray:
    """Positions of a plan (n, joints) from its beginning to its end."""
    return PlannedPath(plan).at(np.arange(0, plan.times_ns[-1] + 1, every_ns))[0]


def assert_keeps_limits(plan: GoalPlan) -> None:
    positions, step_s = motion_of(plan), SOUND_STEP_NS / NS
    assert (np.abs(np.diff(positions, axis=0)) / step_s <= FASTEST * (1 + 1e-6)).all()
    assert (np.abs(np.diff(positions, 2, axis=0)) / step_s**2 <= HARDEST * (1 + 1e-6) + 1e-8).all()
    assert (positions >= LOWER - 1e-9).all() and (positions <= UPPER + 1e-9).all()


@st.composite
def states(draw: st.DrawFn) -> np.ndarray:
    """Positions inside the limits, and velocities from which the arm can still stop there; (joints, 2)."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    position = random.uniform(LOWER, UPPER)
    edge = draw(st.sampled_from([0.0, 0.01, 1.0]))
    position = np.where(random.random(6) < 0.3, UPPER - edge * random.random(6) * 0.1, position)
    room = np.minimum(UPPER - position, position - LOWER)
    fastest = np.minimum(FASTEST, np.sqrt(2.0 * HARDEST * np.maximum(room - 0.04 * FASTEST, 0.0)))
    return np.stack([position, random.uniform(-1, 1, 6) * fastest * draw(st.sampled_from([0.0, 0.5, 1.0]))], axis=1)


@settings(max_examples=examples(200), deadline=None)
@given(
    states(),
    st.integers(0, 2**32 - 1),
    st.integers(1, 25),
    st.sampled_from([0.002, 0.01, 0.04, 0.1]),
    st.sampled_from([0.3, 1.0, 4.0, 30.0]),
    st.sampled_from(["none", "fitting", "wild", "at rest in the end"]),
)
def test_whatever_a_message_asks_for_is_followed_within_the_limits(
    state: np.ndarray, seed: int, count: int, gap_s: float, wildness: float, velocities: str
) -> None:
    """Points that wander, each up to so many times as far from the last one as the joints can go."""
    random = np.random.default_rng(seed)
    steps = random.uniform(-1, 1, (count, 6)) * wildness * FASTEST * gap_s
    steps[0] *= min(1.0, 0.05 / wildness)
    points = np.clip(state[:, 0] + state[:, 1] * 0.035 + np.cumsum(steps, axis=0), LOWER, UPPER)
    speeds = {
        "none": None,
        "fitting": np.gradient(points, gap_s, axis=0) if count > 1 else np.zeros_like(points),
        "wild": random.uniform(-1, 1, (count, 6)) * wildness * FASTEST,
        "at rest in the end": np.zeros_like(points),
    }[velocities]
    asked = message(gap_s * np.arange(1, count + 1), points, speeds)
    try:
        plan = followed(asked, state)
    except TooFar:
        return
    if plan.wanted is None:
        return
    assert plan.joints[0, :, :2] == pytest.approx(state, abs=1e-12), "entering it is no motion of its own"
    assert_keeps_limits(plan)
    check_room_to_stop(plan, ARM)
    if speeds is None or (np.abs(speeds[-1]) < 1e-3).all():
        assert plan.joints[-1, :, 0] == pytest.approx(points[-1], abs=1e-9), "it ends where the message ends"
        assert (plan.joints[-1, :, 1] == 0.0).all()


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.2), st.floats(0.0, 0.7))
def test_the_lag_decays_when_the_stream_can_be_followed(seed: int, lag_rad: float, share: float) -> None:
    """A target at a steady speed, some way off: the arm is on it before long, and stays."""
    random = np.random.default_rng(seed)
    limits = (LOWER, UPPER, FASTEST, HARDEST)
    speed = share * FASTEST * random.choice([-1, 1], 6)
    position = (LOWER + UPPER) / 2 - lag_rad * random.choice([-1, 1], 6)
    target, velocity, step_s = (LOWER + UPPER) / 2 - speed, np.zeros(6), 0.01
    lags = []
    for _ in range(200):
        target = np.clip(target + speed * step_s, LOWER, UPPER)
        after = shaping.next_velocity(position, velocity, target, speed, limits, step_s)
        position, velocity = position + 0.5 * step_s * (velocity + after), after
        lags.append(np.abs(target - position))
    start = np.abs(speed) * 1.0 + lag_rad
    takes_s = 2.0 * FASTEST / HARDEST + start / ((1.0 - share) * FASTEST) + 2.0 * np.sqrt(2.0 * start / (0.5 * HARDEST))
    for joint in range(6):
        after = int(takes_s[joint] / step_s) + 2
        if after < len(lags):
            assert max(lag[joint] for lag in lags[after:]) < 1e-9


@pytest.mark.parametrize("late_ns", [0, 100_000_000])
def test_no_message_of_the_recorded_servo_is_dropped(late_ns: int) -> None:
    """Its filter asks for up to 13 rad/s² in four places: the arm is 0.3° behind for a moment, and ends where it does.

    The recording does not say how old the stamps were when messages came: they may lie ahead by all of Servo's latency.
    """
    arm = FollowedArm(ARM, np.array(SERVO_POSE_RAD))
    reasons, lags, shaped_s = [], [0.0], set()
    messages = recorded_servo()
    for one in messages:
        while arm.now_ns < arm.front.begun_ns + one.came_ns + late_ns:
            arm.cycle()
        plan = arm.take(one)
        if plan.wanted is not None:
            assert_keeps_limits(plan)
            lags.append(largest_lag(plan)[1])
            shaped_s.add(round(one.came_ns / NS, 1))
        if plan.reason is not None:
            reasons.append(plan.reason)
    for _ in range(120):
        arm.cycle()
    assert reasons and all(isinstance(reason, AccelerationBeyondLimit) for reason in reasons)
    assert 0.001 < max(lags) < 0.006
    assert shaped_s <= {*np.round(np.arange(0, 0.8, 0.1), 1), 3.2, 3.3, *np.round(np.arange(4, 4.8, 0.1), 1)} | {
        *np.round(np.arange(6.6, 7.6, 0.1), 1)
    }, "elsewhere it is followed to the digit"
    assert arm.here == pytest.approx(messages[-1].positions[-1], abs=1e-9)


def test_a_stream_that_leaves_no_room_to_stop_is_stopped_inside_its_limits() -> None:
    """It would run on beyond its last point."""
    upper = UPPER[0]
    here = np.zeros((6, 2))
    here[0] = upper - 0.06, 0.4
    points = np.zeros((1, 6))
    points[0, 0] = upper - 0.03
    speeds = np.zeros((1, 6))
    speeds[0, 0] = 0.4
    plan = followed(message([0.05], points, speeds), here)
    assert_keeps_limits(plan)
    assert plan.joints[-1, 0, 1] == 0.0 and upper - 0.03 < plan.joints[-1, 0, 0] <= upper


def test_an_end_just_beyond_a_limit_as_rounding_makes_it_is_the_limit() -> None:
    joint = ARM.joints[0]
    here = np.zeros((6, 2))
    here[0] = UPPER[0] - 0.04, 0.1
    point = np.zeros((1, 6))
    point[0, 0] = UPPER[0] + 0.5 * joint.slack_rad
    plan = followed(message([0.01], point, None), here)
    assert_keeps_limits(plan)
    assert plan.joints[-1, 0, 0] == pytest.approx(UPPER[0], abs=1e-9) and plan.joints[-1, 0, 1] == 0.0


def test_what_is_absurd_is_refused() -> None:
    """Beyond position limits, not a number, or farther than a joint goes in a tenth of a second from where it was."""
    here = np.zeros((6, 2))
    here[:, 1] = 0.1 * FASTEST
    far = np.zeros((1, 6))
    far[0, 2] = ARM.limits.start_tolerance_rad + FAR_S * FASTEST[2] + 0.02
    with pytest.raises(TooFar, match="joint3"):
        followed(message([0.01], far, None), here)
    far[0, 2] -= 0.04
    assert followed(message([0.01], far, None), here).wanted is not None
    far[0, 2] = UPPER[2] + 0.01
    with pytest.raises(PositionBeyondLimit):
        followed(message([0.01], far, None), here)
    far[0, 2] = np.nan
    with pytest.raises(NotFinite):
        followed(message([0.01], far, None), here)


def test_a_whole_trajectory_on_the_topic_is_judged_like_a_goal() -> None:
    times_s = np.array([0.0, 0.2, STREAM_S + 0.1])
    points = np.zeros((3, 6))
    points[1:, 0] = 0.3
    with pytest.raises(GoalRefused):
        followed(message(times_s, points, None), np.zeros((6, 2)), standing=True)
    assert followed(message([0.0, 0.2, STREAM_S - 0.1], points, None), np.zeros((6, 2)), standing=True).wanted


def test_a_message_that_lies_ahead_is_begun_when_it_is_due() -> None:
    """Also where it begins at the end of the stream before, which is a jump only for a message that is due now."""
    began = np.zeros((6, 2))
    times_s = np.array([0.0, 1.0])
    first = followed(message(times_s, np.array([np.zeros(6), np.full(6, 0.1)]), np.zeros((2, 6))), began)
    for start in (0.05, 0.1):
        ahead = message(times_s, np.array([np.full(6, start), np.full(6, start + 0.1)]), np.zeros((2, 6)))
        ahead = replace(ahead, stamp_ns=NOW_NS + NS)
        plan = followed(ahead, began, earlier=first)
        assert plan.wanted is None and plan.start_ns == NOW_NS + NS


def test_a_message_that_lies_ahead_and_asks_for_too_much_is_refused() -> None:
    times_s = np.array([0.0, 0.1])
    wild = message(times_s, np.array([np.zeros(6), np.full(6, 0.5)]), None)
    with pytest.raises(BeyondLimits):
        followed(replace(wild, stamp_ns=NOW_NS + 2 * NS), np.zeros((6, 2)), standing=True)
