"""The servo's shaft: what its laws promise, whatever is asked of them and whenever."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.drives.servo import (
    STEP_NS,
    STEP_S,
    TURN_RAD,
    Cascade,
    Hold,
    Interpolation,
    Law,
    Limp,
    Load,
    Plan,
    Servo,
    Spin,
    Torque,
)

SECOND = 1_000_000_000
MILLISECOND = 1_000_000

turns = st.floats(-5.0, 5.0)
speeds = st.floats(0.5, 20.0)
ramps = st.floats(2.0, 500.0)
times = st.integers(1, 400 * MILLISECOND)


def driven(law: Law, time_ns: int, load: Load | None = None) -> Servo:
    """A shaft that a law has led from rest for a time."""
    servo = Servo(0, 0.0, load)
    servo.obey(law)
    servo.advance(time_ns)
    return servo


def moved(servo: Servo) -> tuple[np.ndarray, np.ndarray]:
    """Positions and speeds of every step so far [rev, rev/s]."""
    end_ns = int(servo.changes_ns()[-1]) + STEP_NS
    positions, rpm = servo.history(np.arange(0, end_ns, STEP_NS))
    return positions, rpm / 60.0


def is_continuous(servo: Servo, top: float) -> None:
    """No position was left out: between two steps no more than the speed allows."""
    positions, speeds = moved(servo)
    assert np.allclose(np.diff(positions), speeds[:-1] * STEP_S, atol=1e-12)
    assert np.abs(speeds).max(initial=0.0) <= top * (1 + 1e-12)


@settings(deadline=None)
@given(turns, speeds, ramps, ramps)
def test_a_plan_keeps_its_limits_and_stands_on_its_target(target, top, up, down):
    servo = Servo(0, 0.0)
    servo.obey(Plan(target, top, up, down))
    # As long as the trapezoid takes, and two steps of each of its phases.
    takes_s = abs(target) / top + top / up + top / down + math.sqrt(2 * abs(target) * (1 / up + 1 / down))
    servo.advance(round(takes_s * 1e9) + 6 * STEP_NS)
    assert servo.position_at(round(takes_s * 1e9) + 6 * STEP_NS) == pytest.approx(target, abs=2e-9)
    assert servo.speed == 0.0
    is_continuous(servo, top)
    positions, velocities = moved(servo)
    gained = np.diff(np.abs(velocities))
    assert gained.max(initial=0.0) <= up * STEP_S * (1 + 1e-9)
    assert gained.min(initial=0.0) >= -down * STEP_S * (1 + 1e-9)
    assert np.all(np.diff(positions) * np.sign(target) >= 0.0)
    assert np.abs(positions).max() <= abs(target) + 2e-9


@settings(deadline=None)
@given(st.lists(st.tuples(times, turns, speeds, ramps, ramps), min_size=1, max_size=6))
def test_a_plan_that_is_changed_on_the_way_never_jumps(orders):
    servo, now_ns, plan = Servo(0, 0.0), 0, Plan(0.0, 1.0, 1.0)
    servo.obey(plan)
    steepest = fastest = 0.0
    for pause_ns, target, top, up, down in orders:
        before = servo.past(now_ns)
        plan.target, plan.top, plan.acceleration, plan.deceleration = target, top, up, down
        servo.obey(plan)
        assert servo.past(now_ns) == before
        steepest, fastest = max(steepest, up, down), max(fastest, top)
        now_ns += pause_ns
        servo.advance(now_ns)
    is_continuous(servo, fastest)
    assert np.abs(np.diff(moved(servo)[1])).max(initial=0.0) <= steepest * STEP_S * (1 + 1e-9)
    now_ns += 40 * SECOND
    servo.advance(now_ns)
    assert servo.position_at(now_ns) == pytest.approx(orders[-1][1], abs=2e-9)


def test_a_plan_takes_the_time_of_its_trapezoid():
    servo = driven(Plan(10.0, 5.0, 20.0, 10.0), 10 * SECOND)
    # Up in 0.25 s over 0.625 rev, down in 0.5 s over 1.25 rev, the rest at 5 rev/s.
    arrived_s = servo.changes_ns()[-1] * 1e-9
    assert arrived_s == pytest.approx(0.25 + 0.5 + (10 - 0.625 - 1.25) / 5, abs=3 * STEP_S)


@settings(deadline=None)
@given(st.floats(-20, 20), ramps)
def test_a_speed_is_reached_by_its_ramp(target, ramp):
    servo = Servo(0, 0.0)
    servo.obey(Spin(target, ramp))
    half_ns = round(abs(target) / ramp * 0.5e9)
    servo.advance(half_ns)
    assert abs(servo.speed) == pytest.approx(abs(target) / 2, abs=ramp * STEP_S * 1.01)
    servo.advance(2 * half_ns + 2 * STEP_NS)
    assert servo.speed == target


@settings(deadline=None)
@given(st.floats(-50, 50, allow_subnormal=False), st.floats(1e-5, 0.1), st.floats(0.0, 1.0, allow_subnormal=False))
def test_the_energy_of_a_limp_shaft_never_grows(speed, inertia, friction):
    """Subnormal friction is none: its share of a step is rounded to 0."""
    servo = driven(Spin(speed, 1e9), 2 * STEP_NS, Load(inertia, friction))
    servo.obey(Limp())
    servo.advance(SECOND)
    speeds = np.abs(moved(servo)[1][2:])
    assert np.all(np.diff(speeds) <= 0.0)
    assert servo.torque_nm == 0.0
    stops_s = abs(speed) * TURN_RAD * inertia / friction if friction else math.inf
    if stops_s < 0.99:
        assert servo.speed == 0.0


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            times, st.floats(-30, 30), st.floats(-30, 30), st.floats(0, 500), st.floats(0, 5), st.floats(-50, 50)
        ),
        min_size=1,
        max_size=4,
    ),
    st.floats(1e-4, 0.1),
    st.floats(0.1, 20.0),
)
def test_no_gain_makes_a_torque_greater_than_the_motor(orders, inertia, strongest):
    load = Load(inertia, 0.02, strongest)
    servo, now_ns, law = Servo(0, 0.0, load), 0, Torque()
    servo.obey(law)
    for pause_ns, law.position_rad, law.speed_rad_s, law.kp, law.kd, law.torque_nm in orders:
        servo.obey(law)
        now_ns += pause_ns
        servo.advance(now_ns)
        assert abs(servo.torque_nm) <= strongest
    is_continuous(servo, math.inf)
    most = load.gain(strongest + load.friction_nm)
    assert np.abs(np.diff(moved(servo)[1])).max(initial=0.0) <= most * (1 + 1e-9)


def test_a_stiff_shaft_settles_as_near_as_friction_lets_it():
    load = Load(0.001, 0.02)
    servo = driven(Torque(position_rad=1.0, kp=30.0, kd=0.5), 2 * SECOND, load)
    assert servo.position_at(2 * SECOND) * TURN_RAD == pytest.approx(1.0, abs=0.02 / 30 + 1e-6)
    assert servo.speed == 0.0


def test_a_torque_below_friction_moves_nothing_and_one_above_accelerates():
    load = Load(0.001, 0.02)
    servo = driven(Torque(torque_nm=0.019), SECOND, load)
    assert len(servo.changes_ns()) == 1
    servo.obey(Torque(torque_nm=0.03))
    servo.advance(2 * SECOND)
    assert servo.speed * TURN_RAD == pytest.approx((0.03 - 0.02) / 0.001, rel=0.01)
    assert servo.torque_nm == pytest.approx(0.03)


@settings(deadline=None)
@given(turns, st.floats(1.0, 20.0))
def test_a_cascade_keeps_its_velocity_limit_and_arrives(target, top):
    servo = Servo(0, 0.0, Load(1e-4, 0.01, 2.0))
    servo.obey(Cascade(target, 20.0, 0.2, top))
    now_ns = round((abs(target) / top + 3.0) * 1e9)
    servo.advance(now_ns)
    assert servo.position_at(now_ns) == pytest.approx(target, abs=2e-9)
    assert servo.law.rests
    is_continuous(servo, top)


def test_velocity_ahead_takes_the_lag_out_of_a_cascade():
    errors = []
    for ahead in (0.0, 1.0):
        servo = Servo(0, 0.0, Load(1e-4, 0.01, 2.0))
        law = Cascade(0.0, 20.0, 0.2, 10.0)
        servo.obey(law)
        for tick in range(1000):
            law.target, law.speed_ahead = tick * 1e-3, ahead
            servo.obey(law)
            servo.advance(tick * MILLISECOND)
        errors.append(law.target - servo.position_at(999 * MILLISECOND))
    assert errors[0] == pytest.approx(1.0 / 20.0, rel=0.05)
    assert abs(errors[1]) < 2e-3


@settings(deadline=None)
@given(st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=50), st.sampled_from([1, 2, 4, 10]))
def test_interpolation_stays_by_its_line(ways, beat_ms):
    servo, law = Servo(0, 0.0), Interpolation(0.0, 1e4)
    servo.obey(law)
    target, now_ns, beat_ns = 0.0, 0, beat_ms * MILLISECOND
    for way in ways:
        target += way
        law.aim(now_ns, target, beat_ns)
        servo.obey(law)
        now_ns += beat_ns
        servo.advance(now_ns)
        assert law.line(now_ns)[0] == pytest.approx(target, abs=1e-12)
        assert abs(servo.position_at(now_ns) - target) <= 0.06
    now_ns += SECOND
    servo.advance(now_ns)
    assert servo.position_at(now_ns) == pytest.approx(target, abs=2e-9)
    is_continuous(servo, math.inf)


def test_interpolation_follows_a_steady_line_without_ripple():
    servo, law = Servo(0, 0.0), Interpolation(0.0, 1e4)
    servo.obey(law)
    for tick in range(200):
        law.aim(tick * 2 * MILLISECOND, (tick + 1) * 0.01, 2 * MILLISECOND)
        servo.obey(law)
        servo.advance((tick + 1) * 2 * MILLISECOND)
    speeds = moved(servo)[1][-800:]
    assert np.allclose(speeds, 5.0, rtol=1e-3)


laws: list[Law] = [
    Plan(3.0, 5.0, 50.0),
    Spin(5.0, 50.0),
    Cascade(3.0, 20.0, 0.2, 5.0),
    Torque(position_rad=20.0, kp=5.0, kd=0.1),
]


@pytest.mark.parametrize("law", laws, ids=lambda law: type(law).__name__)
def test_a_stop_holds_a_shaft_and_is_felt(law):
    servo = Servo(0, 0.0)
    servo.high = 1.0
    servo.obey(law)
    servo.advance(5 * SECOND)
    assert servo.position_at(5 * SECOND) == pytest.approx(1.0, abs=1e-12)
    assert 0 < servo.pressed_ns < 5 * SECOND
    assert servo.torque_nm > 0.0
    assert moved(servo)[0].max() <= 1.0 + 1e-12
    servo.obey(Hold())
    servo.advance(6 * SECOND)
    assert servo.pressed_ns > 6 * SECOND


def test_the_past_can_be_forgotten_and_the_present_stays():
    servo = driven(Plan(3.0, 5.0, 50.0), SECOND)
    middle, end = servo.past(SECOND // 10), servo.past(SECOND)
    servo.forget_before(SECOND // 10)
    assert servo.changes_ns()[0] <= SECOND // 10
    assert (servo.past(SECOND // 10), servo.past(SECOND)) == (middle, end)
