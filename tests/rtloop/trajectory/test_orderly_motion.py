"""Cancels, holds and newer goals keep the limits: what the simulated drives truly do, at any moment of a fast goal."""

import numpy as np
import pytest
from depth import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from streamed import NS, SERVO_POSE_RAD, Message, StreamedArm, recorded_servo
from true_motion import largest_acceleration_ratio
from virtual import VirtualArm

from config.loader import load_arm
from rosfront.refusals import GoalRefused
from rosfront.shaper import largest_lag
from shm.words import Fault, Mode, Outcome

ARM = load_arm("episode1")
FASTEST = np.array([joint.max_velocity_rad_s for joint in ARM.joints])
HARDEST = np.array([joint.max_acceleration_rad_s2 for joint in ARM.joints])
CRUISE_S, WAYPOINT_S = 0.8, 0.02
WINDOW_S = 0.04
"""One motor rpm, of which drives know only whole ones, is an eighth of joint2's acceleration limit over that time."""
ALLOWED = 1.1
trials = settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def at_full_speed(t: np.ndarray) -> np.ndarray:
    """From rest to full velocity by the whole acceleration limit, on for CRUISE_S, and to rest: (n, joints, 3)."""
    ramp_s = 1.5 * FASTEST / HARDEST  # of a smoothstep, which is steepest in its middle
    total_s = 2.0 * ramp_s + CRUISE_S
    t = np.minimum(t[:, np.newaxis], total_s)
    back = t > 0.5 * total_s
    t = np.where(back, total_s - t, t)
    x = np.minimum(t / ramp_s, 1.0)
    way = FASTEST * (ramp_s * (x**3 - 0.5 * x**4) + np.maximum(t - ramp_s, 0.0))
    way = np.where(back, FASTEST * (ramp_s + CRUISE_S) - way, way)
    velocity, acceleration = FASTEST * x * x * (3.0 - 2.0 * x), FASTEST / ramp_s * 6.0 * x * (1.0 - x)
    return np.stack([way, velocity, np.where(back, -acceleration, acceleration)], axis=2)


def amid_full_speed(share: float) -> tuple[VirtualArm, int]:
    """An arm after such a share of a goal in which each joint uses its velocity and acceleration limits; the goal."""
    way = FASTEST * (1.5 * FASTEST / HARDEST + CRUISE_S)
    room = np.array([joint.upper_rad - joint.lower_rad for joint in ARM.joints]) - 0.3
    scale = np.minimum(1.0, room / way)  # joint6 has no room for its full speed
    start = np.array([joint.lower_rad + 0.1 for joint in ARM.joints])
    arm = VirtualArm.brought_up("episode1", start_rad=start)
    here = arm.loop[0]["axes"]["commanded"]["position_rad"][:6].copy()
    times_s = np.arange(0.0, 2.0 * (1.5 * FASTEST / HARDEST).max() + CRUISE_S + 2 * WAYPOINT_S, WAYPOINT_S)
    rows = at_full_speed(times_s) * scale[:, np.newaxis]
    rows[:, :, 0] += here
    rows[-1, :, 1:] = 0.0
    goal = arm.send_goal(np.round(times_s * NS).astype(np.int64), rows)
    arm.cycles(max(2, round(share * times_s[-1] * NS / arm.period_ns)))
    return arm, goal


def truly(arm: VirtualArm, since_ns: int) -> float:
    """Largest true acceleration since then, as a multiple of the limit."""
    arm.cycles(20)
    return largest_acceleration_ratio(arm, since_ns - round(WINDOW_S * NS), WINDOW_S)


def cycles_to_rest(arm: VirtualArm) -> int:
    count = 0
    while arm.loop[0]["axes"]["commanded"]["velocity_rad_s"][:6].any():
        arm.cycle()
        count += 1
    return count


@trials
@given(st.floats(0.05, 0.95))
def test_a_cancel_keeps_the_limits(share: float) -> None:
    arm, goal = amid_full_speed(share)
    asked_ns = arm.now_ns
    arm.writer.cancel(goal)
    assert arm.end_of(goal) in (Outcome.CANCELED, Outcome.SUCCEEDED)
    assert arm.now_ns - asked_ns <= (arm.loop[0]["params"]["longest_stop_s"] + 0.1) * NS
    assert truly(arm, asked_ns) <= ALLOWED
    arm.close()


@trials
@given(st.floats(0.05, 0.95), st.integers(1, 100))
def test_a_hold_and_its_resume_keep_the_limits(share: float, cycles: int) -> None:
    arm, goal = amid_full_speed(share)
    asked_ns = arm.now_ns
    arm.hold()
    arm.cycles(cycles)
    arm.resume()
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert truly(arm, asked_ns) <= ALLOWED
    arm.close()


@trials
@given(st.floats(0.05, 0.95), st.floats(-1.0, 1.0), st.floats(0.4, 1.0), st.booleans())
@example(0.625, -1.0, 0.5, False)  # no way in motion: the arm stops first, farther from its start than a goal may begin
def test_a_goal_that_begins_at_rest_where_the_arm_is_measured_keeps_the_limits(
    share: float, back: float, slowness: float, twice: bool
) -> None:
    """MoveIt plans from the measured state and takes it for standing; at full speed that is a stop and a way back."""
    arm, goal = amid_full_speed(share)
    asked_ns = arm.now_ns
    for _ in range(1 + twice):
        here = arm.loop[0]["axes"]["measured"]["position_rad"][:6].copy()
        duration_s = 1.5 * slowness
        rows = np.zeros((2, 6, 3))
        way = np.minimum(0.17 * HARDEST * duration_s**2, 0.5 * FASTEST * duration_s)  # of a quintic within its limits
        rows[:, :, 0] = here, here + back * way * np.where(here > 0, -1, 1)
        rows[1, :, 0] = np.clip(rows[1, :, 0], *np.array([(j.lower_rad, j.upper_rad) for j in ARM.joints]).T)
        newer = arm.send_goal(np.array([0, round(duration_s * NS)]), rows)
        arm.cycles(15)
    assert arm.end_of(newer) == Outcome.SUCCEEDED
    assert arm.outcome(goal) in (Outcome.REPLACED, Outcome.SUCCEEDED) and arm.memory["fault"]["code"] == Fault.NONE
    assert truly(arm, asked_ns) <= ALLOWED
    arm.close()


def test_an_arm_that_was_slowed_to_a_standstill_does_not_go_back_to_a_goal_of_before() -> None:
    arm, goal = amid_full_speed(0.5)
    rows = np.zeros((2, 6, 3))
    rows[:, :, 0] = arm.loop[0]["axes"]["measured"]["position_rad"][:6]
    newer = arm.send_goal(np.array([0, NS // 10]), rows)
    arm.writer.scale(0.0)
    assert arm.end_of(newer) == Outcome.REFUSED_START
    arm.writer.scale(1.0)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    arm.close()


def test_a_persons_stop_brakes_harder_also_amid_an_orderly_one() -> None:
    """It may use the braking factor, and need not wait for a cancel or a hold that is gentler."""
    took = {}
    for before in ("nothing", "cancel", "hold", "only a cancel"):
        arm, goal = amid_full_speed(0.5)
        if "cancel" in before:
            arm.cancel(goal)
        if before == "hold":
            arm.hold()
        if before == "only a cancel":
            arm.cycle()
        else:
            arm.stop()
        took[before] = cycles_to_rest(arm)
        arm.end_of(goal)
        arm.close()
    assert took["nothing"] <= 0.75 * took["only a cancel"]
    assert took["cancel"] <= took["nothing"] + 4 and took["hold"] <= took["nothing"] + 4, took


# --- streams --------------------------------------------------------------------------------------------


def ended(arm: StreamedArm) -> set[Outcome]:
    """How the streams ended that the loop still remembers."""
    return {Outcome(arm.outcome(goal)) for goal in arm.streams[-8:]}


@pytest.mark.parametrize("late_ns", [0, 100_000_000])
def test_the_recorded_servo_is_followed_within_the_limits(late_ns: int) -> None:
    """All of it, on the simulated drives: nothing is dropped, refused or late by more than a moment."""
    arm = StreamedArm("episode1", start_rad=SERVO_POSE_RAD)
    begun_ns, lags = arm.now_ns, []
    seen: set[Outcome] = set()
    messages = recorded_servo()
    for message in messages:
        while arm.now_ns < arm.front.begun_ns + message.came_ns + late_ns:
            arm.cycle()
            seen |= ended(arm)
        lags.append(largest_lag(arm.take(message))[1])
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=3.0)
    seen |= ended(arm)
    assert seen <= {Outcome.NONE, Outcome.REPLACED, Outcome.SUCCEEDED}
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert 0 < arm.front.shaped <= 80 and max(lags) < 0.005  # 76 of the 639, half as many if they come late
    assert arm.acceleration_ratio() <= 1.05
    assert arm.positions[-1] == pytest.approx(messages[-1].positions[-1], abs=1e-6)
    assert truly(arm, begun_ns + 100_000_000) <= ALLOWED
    arm.close()


@settings(trials, max_examples=examples(15))
@given(st.integers(0, 2**32 - 1), st.sampled_from([20, 50, 100]), st.floats(0.5, 6.0), st.booleans())
@example(seed=0, rate_hz=20, speed=1.0, velocities=False).via(
    "the way from rest was left to a blend that took 1.38 x the limit"
)
@example(seed=0, rate_hz=50, speed=1.0, velocities=False).via(
    "it never began: each message was refused by the control process"
)
@example(seed=1, rate_hz=20, speed=1.0 / 3.0, velocities=True).via(
    "beyond a limit of position by less than the arm's slack"
)
@example(seed=3475229416, rate_hz=100, speed=4.8, velocities=True).via(
    "it never began: messages were over before the arm followed"
)
def test_a_wild_stream_is_followed_within_the_limits_and_to_its_end(
    seed: int, rate_hz: int, speed: float, velocities: bool
) -> None:
    """Points one by one, at up to six times the velocity limit; the last one is repeated until the arm is there."""
    random = np.random.default_rng(seed)
    arm = StreamedArm("mock")
    names = [joint.name for joint in arm.arm.joints]
    fastest = np.array([joint.max_velocity_rad_s for joint in arm.arm.joints])
    low, high = np.array([(joint.lower_rad, joint.upper_rad) for joint in arm.arm.joints]).T
    target, velocity, dropped = arm.commanded(), np.zeros(6), 0
    for number in range(rate_hz * 3):
        while arm.now_ns < arm.front.begun_ns + number * NS // rate_hz:
            arm.cycle()
        if number < rate_hz:
            velocity = np.clip(velocity + random.uniform(-0.5, 0.5, 6) * fastest, -speed * fastest, speed * fastest)
        else:
            velocity = np.zeros(6)
        moved = np.clip(target + velocity / rate_hz, low, high)
        speeds = velocity[np.newaxis] if velocities else None
        try:
            arm.take(Message(0, 0, names, np.array([NS // rate_hz]), moved[np.newaxis], speeds))
            target = moved
        except GoalRefused:
            dropped += 1
            velocity = np.zeros(6)
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=20.0)
    assert arm.memory["fault"]["code"] == Fault.NONE
    positions = np.array(arm.positions)
    period_s = arm.period_ns / NS
    assert (np.abs(np.diff(positions, axis=0)) / period_s <= fastest * 1.05).all()
    assert arm.acceleration_ratio() <= 1.06
    slack = np.array([joint.slack_rad for joint in arm.arm.joints])
    assert (positions >= low - slack).all() and (positions <= high + slack).all(), "as any path: to a pulse and a count"
    assert positions[-1] == pytest.approx(target, abs=1e-6), dropped
    arm.close()
