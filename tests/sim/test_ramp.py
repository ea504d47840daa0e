"""Properties of the speed ramp, whatever it is told: its steps, its end, and no drift."""

from __future__ import annotations

from itertools import pairwise

import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.drives.ramp import GRAINS_PER_REVOLUTION, NEVER, Ramp

PULSE = GRAINS_PER_REVOLUTION // 3200
SETTLING_NS = 10**13

targets = st.integers(-20_000, 20_000).map(lambda pulses: pulses * PULSE)
speeds = st.integers(1, 600)
ticks = st.one_of(st.just(0), st.integers(1, 255).map(lambda acc: (256 - acc) * 50_000))


class Recorder:
    """Every change of speed: time, position, speed."""

    def __init__(self, start: int = 0) -> None:
        self.changes = [(0, start, 0)]
        self.ramp = Ramp(0, start, lambda *change: self.changes.append(change))

    def consistent(self) -> None:
        """Every position follows from the one before; arrivals are rounded by less than a nanosecond."""
        for (t0, p0, v0), (t1, p1, _) in pairwise(self.changes):
            assert t1 >= t0
            assert abs(p0 + v0 * (t1 - t0) - p1) < max(abs(v0), 1)


@given(targets, speeds, ticks)
def test_one_move_rises_and_falls_by_one_rpm_a_tick_and_ends_on_the_target(target, rpm, tick_ns):
    recorder = Recorder()
    recorder.ramp.seek(target, rpm, tick_ns)
    recorder.ramp.advance(SETTLING_NS)
    recorder.consistent()
    assert recorder.ramp.position == target
    assert recorder.ramp.idle
    passed = [position for _, position, _ in recorder.changes]
    assert min(passed) >= min(0, target)
    assert max(passed) <= max(0, target)
    velocities = [abs(speed) for _, _, speed in recorder.changes]
    assert max(velocities) <= rpm
    if tick_ns:
        steps = [b - a for a, b in pairwise(velocities)]
        assert set(steps) <= {-1, 1}
        assert steps == sorted(steps, reverse=True)  # up, then down
        times = [time for time, _, _ in recorder.changes[1:]]
        assert all(b - a >= tick_ns for a, b in pairwise(times))


@given(st.integers(0, 2000), st.integers(2, 60), st.integers(200, 255))
def test_a_move_takes_as_long_as_its_trapezoid(pulses, rpm, acc):
    """From the continuous trapezoid it differs by a few ticks and the slow last steps at most."""
    tick_ns = (256 - acc) * 50_000
    recorder = Recorder()
    recorder.ramp.seek(pulses * PULSE, rpm, tick_ns)
    recorder.ramp.advance(SETTLING_NS)
    distance = pulses * PULSE
    rate = 1 / tick_ns
    peak = min(float(rpm), (distance * rate) ** 0.5)
    ideal_ns = 2 * peak / rate + (distance - peak * peak / rate) / peak if pulses else 0.0
    assert recorder.changes[-1][0] == pytest.approx(ideal_ns, rel=0.08, abs=4 * tick_ns)


retargets = st.lists(st.tuples(st.integers(0, 60_000_000), targets, st.integers(0, 600), ticks), max_size=25)


@given(retargets, targets)
@settings(max_examples=examples(150))
def test_retargeting_never_jumps_and_still_ends_on_the_last_target(commands, last):
    recorder = Recorder()
    now_ns = 0
    changed_ns = -NEVER
    for wait_ns, target, rpm, tick_ns in [*commands, (0, last, 50, 2_050_000)]:
        recorder.ramp.seek(target, rpm, tick_ns)
        speed_before = recorder.ramp.speed_rpm
        known = len(recorder.changes)
        now_ns += wait_ns
        recorder.ramp.advance(now_ns)
        ceiling = max(abs(speed_before), rpm)
        for time_ns, position, speed in recorder.changes[known:]:
            assert abs(speed) <= ceiling
            if tick_ns:
                assert abs(speed - speed_before) == 1
                # Only the halt on the target itself may come before its tick.
                assert time_ns - changed_ns >= tick_ns or (speed == 0 and position == target)
            speed_before, changed_ns = speed, time_ns
    recorder.ramp.advance(now_ns + SETTLING_NS)
    recorder.consistent()
    assert recorder.ramp.position == last
    assert recorder.ramp.idle


def test_a_target_too_near_is_passed_and_come_back_to():
    recorder = Recorder()
    recorder.ramp.run(300, 1_000_000)
    recorder.ramp.advance(400_000_000)
    here = recorder.ramp.position
    target = here + 10 * PULSE
    recorder.ramp.seek(target, 300, 1_000_000)
    recorder.ramp.advance(SETTLING_NS)
    assert recorder.ramp.position == target
    assert max(position for _, position, _ in recorder.changes) > target + 100 * PULSE
    assert min(speed for _, _, speed in recorder.changes) < 0


def test_ten_thousand_retargets_leave_no_drift():
    recorder = Recorder()
    for cycle in range(10_000):
        recorder.ramp.advance(cycle * 8_333_333)
        recorder.ramp.seek((cycle * 37 % 3200) * PULSE, 1 + cycle % 251, (1 + cycle % 256) * 50_000)
    recorder.ramp.seek(777 * PULSE, 60, 0)
    recorder.ramp.advance(SETTLING_NS)
    recorder.consistent()
    assert recorder.ramp.position == 777 * PULSE


def test_speed_zero_does_not_move():
    recorder = Recorder()
    for tick_ns in (0, 2_050_000):
        recorder.ramp.seek(PULSE, 0, tick_ns)
        recorder.ramp.advance(recorder.ramp.time_ns + 10**9)
        assert recorder.ramp.position == 0


@given(st.lists(st.tuples(st.integers(0, 500), st.integers(-300, 300), ticks), max_size=10))
def test_speed_commands_change_by_one_rpm_a_tick(commands):
    recorder = Recorder()
    now_ns = 0
    for wait_ms, rpm, tick_ns in commands:
        recorder.ramp.run(rpm, tick_ns)
        known = len(recorder.changes)
        before = recorder.ramp.speed_rpm
        now_ns += wait_ms * 1_000_000
        recorder.ramp.advance(now_ns)
        for _, _, speed in recorder.changes[known:]:
            assert abs(speed - before) == 1 or tick_ns == 0
            before = speed
    recorder.consistent()
