"""The trajectory clock alone: along a ramp, and which ramp is chosen, judged by arithmetic of its own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.loader import load_arm
from motion.stopping import ORDERLY, STOP_FRACTIONS
from rtloop.process.initial_state import new_loop
from rtloop.trajectory import clock, path

ARM = load_arm("mock")
PERIOD_S = ARM.control.period_ns * 1e-9
BRAKING = ARM.limits.braking_factor
HARDEST = 0.9 * ARM.limits.acceleration_margin
"""What a ramp may bring a joint's acceleration to, as a share of its limit, however much the plan asks for."""


class Clock:
    """An arm amid a straight line of constant velocity (shares of each joint's highest), of so many seconds."""

    def __init__(
        self, *, speed_share: float = 0.5, path_s: float = 60.0, at_s: float = 20.0, gap_s: float = 1.0
    ) -> None:
        self.loop = new_loop(ARM, 0, 0)[0]
        self.path = self.loop["paths"][0]
        self.loop["goals"]["active"], self.loop["clock"]["time_s"] = 0, at_s
        self.loop["search"]["checks_left"] = 10**6
        self.longest_s = float(self.loop["params"]["longest_stop_s"])
        count = round(path_s / gap_s) + 1
        self.path["taken"], self.path["joint_mask"] = count, (1 << len(ARM.joints)) - 1
        self.path["closest_ns"] = round(gap_s * 1e9)
        self.path["ended"] = 1
        waypoints = self.loop["waypoints"][:count]
        waypoints["order"] = 3
        waypoints["time_ns"] = np.round(np.arange(count) * gap_s * 1e9)
        for index, joint in enumerate(ARM.joints):
            velocity = speed_share * joint.max_velocity_rad_s
            waypoints["joints"]["velocity_rad_s"][:, index] = velocity
            waypoints["joints"]["position_rad"][:, index] = velocity * (np.arange(count) * gap_s - at_s)
            axis = self.loop["axes"][index]
            axis["commanded"]["position_rad"], axis["commanded"]["velocity_rad_s"] = 0.0, velocity
            axis["commanded"]["difference_velocity_rad_s"] = velocity

    def bend(self, joint: int, acceleration_rad_s2: float) -> None:
        """Let a joint accelerate all along instead, with the path's other words as they are."""
        times_s = self.loop["waypoints"]["time_ns"][: self.path["taken"]] * 1e-9 - self.loop["clock"]["time_s"]
        row = self.loop["waypoints"]["joints"][: self.path["taken"], joint]
        row["velocity_rad_s"] = acceleration_rad_s2 * times_s
        row["position_rad"] = 0.5 * acceleration_rad_s2 * times_s**2

    def bump(self, ahead_s: float, beside_rad: float = 0.01) -> None:
        """Let a point so far ahead lie beside the line, by more than its acceleration makes good at rate 1."""
        times_s = self.loop["waypoints"]["time_ns"][: self.path["taken"]] * 1e-9
        nearest = int(np.argmin(abs(times_s - self.loop["clock"]["time_s"] - ahead_s)))
        self.loop["waypoints"]["joints"]["position_rad"][nearest, 3] += beside_rad

    def advance(self) -> None:
        """One cycle along the path: the clock, and the commanded setpoint of each joint."""
        clock.advance_clock(self.loop)
        now_s = self.loop["clock"]["time_s"]
        waypoint = path.find_waypoint(self.loop, 0, now_s, self.path["segment"])
        self.path["segment"] = waypoint
        for index in range(len(ARM.joints)):
            commanded = self.loop["axes"][index]["commanded"]
            position, _, _ = path.sample(self.loop, 0, index, now_s, waypoint)
            commanded["difference_velocity_rad_s"] = (position - commanded["position_rad"]) / PERIOD_S
            commanded["position_rad"] = position

    def slowest_s(self) -> float:
        """The largest ratio of velocity to acceleration limit among the joints, along the line."""
        ratios = self.loop["axes"]["commanded"]["velocity_rad_s"][:6] / [
            joint.max_acceleration_rad_s2 for joint in ARM.joints
        ]
        return float(ratios.max())


# --- along a ramp ---------------------------------------------------------------------------------------------


@given(st.floats(0.0, 1.5), st.floats(0.0, 1.5), st.floats(0.02, 2.0), st.floats(-1.0, 1.0))
def test_a_ramp_leads_to_its_rate_and_the_clock_goes_as_far_as_its_integral(
    rate: float, target: float, duration: float, slope: float
) -> None:
    """The integral of a cubic from its ends: T (s₀ + s₁) / 2 + u T² / 12; then the clock runs at the new rate."""
    it = Clock()
    it.loop["clock"]["rate"], it.loop["clock"]["slope"], it.loop["clock"]["time_s"] = rate, slope, 0.0
    clock.begin_ramp(it.loop, target, duration, ORDERLY)
    cycles = int(np.ceil(duration / PERIOD_S)) + 3
    for number in range(1, cycles + 1):
        before = float(it.loop["clock"]["time_s"])
        clock.advance_clock(it.loop)
        if number * PERIOD_S < duration:
            mean = (float(it.loop["clock"]["time_s"]) - before) / PERIOD_S
            shares = (np.array([number - 1.0, number - 0.5, number]) * PERIOD_S / duration)[:, np.newaxis]
            hermite = np.hstack(
                [1 - 3 * shares**2 + 2 * shares**3, shares * (1 - shares) ** 2, 3 * shares**2 - 2 * shares**3]
            )
            rates = hermite @ [rate, slope * duration, target]
            assert mean == pytest.approx(rates @ [1 / 6, 4 / 6, 1 / 6], abs=1e-9)
            assert it.loop["clock"]["rate"] == pytest.approx(rates[-1], abs=1e-9)
    way = duration * (rate + target) / 2.0 + slope * duration**2 / 12.0 + (cycles * PERIOD_S - duration) * target
    assert it.loop["clock"]["time_s"] == pytest.approx(way, abs=1e-9)
    assert (it.loop["clock"]["rate"], it.loop["clock"]["slope"], it.loop["clock"]["ramp_s"]) == (target, 0.0, 0.0)


def test_a_steady_clock_goes_on_at_its_rate() -> None:
    it = Clock()
    clock.set_rate(it.loop, 0.25)
    assert (
        it.loop["clock"]["rate"],
        it.loop["clock"]["rate_target"],
        it.loop["clock"]["slope"],
        it.loop["clock"]["ramp_s"],
    ) == (0.25, 0.25, 0.0, 0.0)
    clock.advance_clock(it.loop)
    assert it.loop["clock"]["time_s"] - 20.0 == pytest.approx(0.25 * PERIOD_S)


# --- which ramp -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [ORDERLY, BRAKING])
@pytest.mark.parametrize("speed_share", [0.02, 0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize(("rate", "target"), [(1.0, 0.0), (0.0, 1.0), (1.0, 0.5), (0.2, 0.9)])
def test_on_a_straight_line_the_shortest_candidate_is_taken_that_brakes_no_harder_than_it_may(
    speed_share: float, rate: float, target: float, factor: float
) -> None:
    """It is steepest in its middle, with 1.5 · change / T (`motion.stopping`)."""
    it = Clock(speed_share=speed_share)
    clock.set_rate(it.loop, rate)
    steepest = 1.5 * abs(target - rate) * it.slowest_s() / factor
    expected = next(share * it.longest_s for share in STOP_FRACTIONS if share * it.longest_s >= steepest)
    duration, strain = clock.ramp_duration(it.loop, target, factor)
    assert duration == pytest.approx(expected)
    assert strain == pytest.approx(steepest / expected)


@pytest.mark.parametrize(
    ("planned_share", "present_share", "factor", "allowed_share"),
    [
        (0.0, 0.0, ORDERLY, ORDERLY),
        (0.0, 0.0, BRAKING, BRAKING),
        (0.98, 0.0, ORDERLY, 1.03),
        (-0.98, 0.0, ORDERLY, 1.03),
        (1.3, 0.0, ORDERLY, 1.35),
        (1.3, 0.0, BRAKING, BRAKING),
        (9.0, 0.0, ORDERLY, HARDEST),
        (-9.0, 0.0, BRAKING, HARDEST),
        (0.0, 0.9, ORDERLY, ORDERLY),
        (0.0, -1.2, ORDERLY, 1.2),
    ],
)
def test_where_the_plan_asks_for_much_a_ramp_may_add_to_that(
    planned_share: float, present_share: float, factor: float, allowed_share: float
) -> None:
    """0.05 more than the plan, nine tenths of a margin of 2 at the most, and what the joint has already."""
    it = Clock()
    limit = ARM.joints[2].max_acceleration_rad_s2
    it.loop["axes"][2]["commanded"]["acceleration_rad_s2"] = present_share * limit
    allowed = clock.allowed_acceleration(it.loop, 2, planned_share * limit, factor, 0.05)
    assert allowed == pytest.approx(allowed_share * limit)


def test_a_stop_may_push_as_hard_as_the_plan_did_without_it() -> None:
    """A plan at 1.2 times the limit: what the falling rate takes from its own share is the stop's."""
    it = Clock(speed_share=0.0)
    limit = ARM.joints[1].max_acceleration_rad_s2
    it.bend(1, 1.2 * limit)
    clock.set_rate(it.loop, 1.0)
    assert clock.ramp_strain(it.loop, 0.0, PERIOD_S, ORDERLY) <= 1.0


def test_what_the_plan_itself_asks_for_is_part_of_the_strain() -> None:
    """At rest in the joint's turning point, where a ramp adds nothing and only the plan pushes."""
    it = Clock(speed_share=0.0)
    limit = ARM.joints[1].max_acceleration_rad_s2
    it.bend(1, 0.5 * limit)
    clock.set_rate(it.loop, 1.0)
    assert clock.ramp_strain(it.loop, 1.0, PERIOD_S, ORDERLY) == pytest.approx(0.5 / ORDERLY, rel=1e-6)
    assert clock.ramp_strain(it.loop, 1.0, PERIOD_S, BRAKING) == pytest.approx(0.5 / BRAKING, rel=1e-6)


def test_a_clock_that_would_run_backwards_or_too_fast_is_impossible() -> None:
    it = Clock(speed_share=0.0)
    clock.set_rate(it.loop, 0.5)
    it.loop["clock"]["slope"] = -20.0
    assert clock.ramp_strain(it.loop, 0.0, 1.0, ORDERLY) == clock.IMPOSSIBLE
    it.loop["clock"]["slope"] = 20.0
    assert clock.ramp_strain(it.loop, 0.0, 1.0, ORDERLY) == clock.IMPOSSIBLE
    it.loop["clock"]["slope"] = 0.0
    assert clock.ramp_strain(it.loop, 0.0, 1.0, ORDERLY) == 0.0


def test_a_ramp_needs_path_that_is_known() -> None:
    """A stop of T from the full rate goes T / 2 further; a path that ends at rest may be passed."""
    it = Clock(speed_share=0.0, path_s=20.3, gap_s=0.29)
    clock.set_rate(it.loop, 1.0)
    assert clock.ramp_strain(it.loop, 0.0, 0.59, ORDERLY) == 0.0
    it.path["ended"] = 0
    assert clock.ramp_strain(it.loop, 0.0, 0.59, ORDERLY) == 0.0
    assert clock.ramp_strain(it.loop, 0.0, 0.8, ORDERLY) == pytest.approx(clock.NO_PATH + 0.1)


@pytest.mark.parametrize(("duration", "expected"), [(0.3, True), (0.33, True), (0.31, False), (0.1, False)])
def test_rough(duration: float, expected: bool) -> None:
    """Points are 10 ms apart, which is a cycle: a ramp of 32 such gaps sees each of them."""
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    it.path["closest_ns"] = 10_000_001 if not expected else 10_000_000
    if duration > 0.32:
        it.path["closest_ns"] = round(duration / 32 * 1e9)
    assert clock.is_rough(it.loop, duration) == expected


@pytest.mark.parametrize("target", [0.0, 0.5])
def test_a_bump_on_the_way_or_just_behind_it_is_seen_setpoint_by_setpoint(target: float) -> None:
    """A point 0.3 s ahead lies beside the line by more than the joint's acceleration makes good."""
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    clock.set_rate(it.loop, 1.0)
    assert clock.setpoint_strain(it.loop, target, 0.7) == 0.0
    it.bump(0.3)
    assert clock.setpoint_strain(it.loop, target, 0.7) == clock.BREAKS_A_LIMIT
    it.loop["search"]["checks_left"] = 3
    assert clock.setpoint_strain(it.loop, target, 0.7) == 0.0, "a lower rate cannot wait"
    clock.set_rate(it.loop, 0.2)
    it.loop["axes"]["commanded"]["difference_velocity_rad_s"] *= 0.2
    it.loop["search"]["checks_left"] = 3
    assert clock.setpoint_strain(it.loop, 0.5, 0.7) == clock.UNPROVEN, "a higher one can"


@given(st.integers(1, 40), st.integers(20, 120))
def test_setpoints_are_judged_the_same_in_one_cycle_or_in_many(looks: int, bump_cycles: int) -> None:
    """The rest of a cubic ramp is the cubic ramp of what is left, so what was judged stays judged as it runs on."""
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    clock.begin_ramp(it.loop, 0.0, 0.8, ORDERLY)
    if bump_cycles < 100:
        it.bump(bump_cycles * PERIOD_S / 2)
    at_once = clock.setpoints_within_limits(it.loop, 0.0, 0.8, 0)
    assert (at_once < clock.setpoints_to_judge(it.loop, 0.8)) == (bump_cycles < 80)
    for cycle in range(1, 80):
        it.loop["search"]["checks_left"] = looks
        breaks = clock.ramp_breaks_a_limit(it.loop)
        assert it.loop["clock"]["ramp_judged"] == min(at_once - cycle + 1, (looks - 1) * cycle + 1), cycle
        if breaks:
            assert bump_cycles < 80
            return
        it.advance()
    assert bump_cycles >= 80


# --- when one is begun ----------------------------------------------------------------------------------------


def test_a_ramp_is_begun_when_another_rate_is_wanted_and_then_runs_on() -> None:
    it = Clock()
    clock.steer_rate(it.loop, 1.0, ORDERLY)
    assert it.loop["clock"]["ramp_s"] == 0.0, "it has that rate"
    it.loop["goals"]["arriving"] = 1
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    duration = float(it.loop["clock"]["ramp_s"])
    assert duration == pytest.approx(clock.ramp_duration(it.loop, 0.0, ORDERLY)[0])
    assert (it.loop["clock"]["rate_target"], it.loop["clock"]["rate_start"], it.loop["goals"]["arriving"]) == (
        0.0,
        1.0,
        0,
    )
    clock.advance_clock(it.loop)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    assert it.loop["clock"]["ramp_elapsed_s"] == pytest.approx(PERIOD_S), "it is not begun anew"


def test_an_urgent_stop_cuts_an_orderly_one_short_and_none_is_made_longer() -> None:
    it = Clock(speed_share=1.0)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    clock.advance_clock(it.loop)
    left_s = float(it.loop["clock"]["ramp_s"]) - PERIOD_S
    clock.steer_rate(it.loop, 0.0, BRAKING)
    assert it.loop["clock"]["ramp_s"] < left_s and it.loop["clock"]["ramp_elapsed_s"] == 0.0
    clock.advance_clock(it.loop)
    urgent_s = float(it.loop["clock"]["ramp_s"])
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    assert (it.loop["clock"]["ramp_s"], it.loop["clock"]["ramp_elapsed_s"]) == (urgent_s, pytest.approx(PERIOD_S))
    while it.loop["clock"]["ramp_s"] > 0.0:
        clock.steer_rate(it.loop, 0.0, BRAKING)
        clock.advance_clock(it.loop)
        assert it.loop["clock"]["ramp_s"] in (urgent_s, 0.0), "a stop that is nearly over is not begun anew"


def believed(it: Clock, share: float, *, bump_rad: float, ahead_s: float) -> float:
    """An orderly stop over a bump, of a share of the longest, runs since a cycle and is not looked at yet; how long."""
    it.bump(ahead_s, bump_rad)
    duration = share * it.longest_s
    clock.begin_ramp(it.loop, 0.0, duration, ORDERLY)
    it.advance()
    return duration


def test_a_stop_on_which_a_bump_is_found_gives_way_to_a_longer_one_once() -> None:
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    duration = believed(it, 0.35, bump_rad=0.001, ahead_s=0.25)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    longer = float(it.loop["clock"]["ramp_s"])
    assert longer > duration and it.loop["clock"]["ramp_elapsed_s"] == 0.0
    assert clock.setpoint_strain(it.loop, 0.0, duration) == clock.BREAKS_A_LIMIT
    assert clock.setpoint_strain(it.loop, 0.0, longer) == 0.0
    while it.loop["clock"]["ramp_s"] > 0.0:
        it.loop["search"]["checks_left"] = 10**6
        clock.steer_rate(it.loop, 0.0, ORDERLY)
        it.advance()
        assert it.loop["clock"]["ramp_s"] in (longer, 0.0) and it.loop["clock"]["rate_target"] == 0.0


def test_a_stop_that_no_longer_one_spares_a_bump_runs_on() -> None:
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    duration = believed(it, 0.13, bump_rad=0.01, ahead_s=0.1)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    assert 0 < it.loop["clock"]["ramp_judged"] < 12
    assert clock.ramp_duration(it.loop, 0.0, ORDERLY, duration)[1] >= clock.BREAKS_A_LIMIT
    assert (it.loop["clock"]["ramp_s"], it.loop["clock"]["ramp_elapsed_s"]) == (duration, pytest.approx(PERIOD_S))


def test_an_urgent_stop_is_asked_for_before_the_orderly_one_is_looked_at() -> None:
    it = Clock(path_s=20.0, at_s=10.0, gap_s=0.01)
    duration = believed(it, 0.35, bump_rad=0.001, ahead_s=0.25)
    urgent, strain = clock.ramp_duration(it.loop, 0.0, BRAKING)
    assert strain <= 1.0 and urgent < duration
    clock.steer_rate(it.loop, 0.0, BRAKING)
    assert (it.loop["clock"]["ramp_s"], it.loop["clock"]["ramp_factor"]) == (urgent, BRAKING)


def test_a_running_ramp_that_cannot_be_turned_round_runs_on() -> None:
    """At six times the joints' highest velocity no ramp keeps the limits; from a steady rate one is begun at once."""
    it = Clock(speed_share=6.0)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    assert it.loop["clock"]["ramp_s"] == pytest.approx(it.longest_s), "as gently as can be"
    clock.begin_ramp(it.loop, 0.5, it.longest_s, ORDERLY)
    clock.steer_rate(it.loop, 0.0, ORDERLY)
    assert it.loop["clock"]["rate_target"] == 0.5


@pytest.mark.parametrize(
    ("left_s", "ended", "braking", "expected"),
    [
        (10.0, 0, False, False),
        (10.0, 0, True, False),  # ample path again
        (0.0, 1, True, False),  # its end is known: nothing lacks
        (0.0, 0, False, True),
    ],
)
def test_a_path_that_runs_out_without_an_end_is_braked_for(
    left_s: float, ended: int, braking: bool, expected: bool
) -> None:
    it = Clock(path_s=60.0, at_s=60.0 - left_s)
    it.path["ended"] = ended
    assert clock.must_brake_for_lack_of_path(it.loop, braking) == expected


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_braking_begins_when_the_stop_just_fits(rate: float) -> None:
    """The stop of T goes rate · T / 2; three cycles are kept in reserve. Once begun, the longest stop must fit."""
    for beside_s in (-1e-6, 1e-6):
        it = Clock()
        it.path["ended"] = 0
        clock.set_rate(it.loop, rate)
        duration, _ = clock.ramp_duration(it.loop, 0.0, BRAKING)
        assert duration < it.longest_s
        it.loop["clock"]["time_s"] = 60.0 - 0.5 * rate * duration - 3.0 * PERIOD_S - beside_s
        assert clock.must_brake_for_lack_of_path(it.loop, False) == (beside_s < 0.0)
        assert clock.must_brake_for_lack_of_path(it.loop, True)
        it.loop["operator"]["speed_scale"] = rate
        it.loop["clock"]["time_s"] = 60.0 - 0.5 * rate * it.longest_s - 3.0 * PERIOD_S - beside_s
        assert clock.must_brake_for_lack_of_path(it.loop, True) == (beside_s < 0.0)
