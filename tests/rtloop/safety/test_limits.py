"""The last line of defence alone: a setpoint just inside each limit passes, one just outside is the fault it should be.

The limits are told from the arm file and by arithmetic of their own, not by the functions that are judged.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.loader import load_arm
from motion.limits import ROUNDING
from rosfront.limits import check_limits
from rosfront.plan import GoalPlan, Terms
from rosfront.refusals import BeyondLimits
from rtloop.commands import setpoint_reader
from rtloop.process.initial_state import new_loop
from rtloop.safety import setpoint_check
from rtloop.trajectory.limits import BESIDE_RAD, clamped_rad, keeps_room, stop_rad, stopping_distance_rad
from shm import layout
from shm.words import Entry, Fault, Mode, Setpoint

ARM = load_arm("episode1")
PERIOD_S = ARM.control.period_ns * 1e-9
JOINTS = (0, 3, 5)
INSIDE, OUTSIDE = 1.0, 1.0 + 3e-6
"""Shares of a limit; what lies between is left to the rounding of the arithmetic."""
both_ways = pytest.mark.parametrize("sign", [1.0, -1.0])
some_joints = pytest.mark.parametrize("joint", JOINTS)


class StandingArm:
    """An arm whose joints stand in the middle of their ranges, and whose next setpoints a test chooses."""

    def __init__(self) -> None:
        self.shared = np.zeros(1, layout.StateFile.dtype)
        self.loop = new_loop(ARM, self.shared.ctypes.data, 0)
        self.memory = self.loop[0]
        self.memory["mode"] = Mode.EXECUTING
        for joint, config in enumerate(ARM.joints):
            middle_rad = 0.5 * (config.lower_rad + config.upper_rad)
            self.choose(joint, middle_rad, middle_rad)

    def choose(self, joint: int, position_rad: float, next_rad: float, before_rad_s: float = 0.0) -> None:
        axis = self.loop[0]["axes"][joint]
        axis["commanded"]["position_rad"], axis["commanded"]["next_position_rad"] = position_rad, next_rad
        axis["commanded"]["difference_velocity_rad_s"] = before_rad_s

    def verdict(self) -> tuple[Fault, int]:
        """The fault that is latched, and its joint (-1: none)."""
        passed = setpoint_check.check_next_setpoint(self.loop[0], self.shared[0])
        assert passed == (self.memory["fault"]["code"] == Fault.NONE)
        return Fault(self.memory["fault"]["code"]), int(self.memory["fault"]["joint"])

    def said(self) -> tuple[float, float]:
        return float(self.memory["fault"]["value"]), float(self.memory["fault"]["limit"])

    def slack_rad(self, joint: int) -> float:
        return float(self.loop[0]["joints"][joint]["slack_rad"])


@pytest.fixture
def arm() -> StandingArm:
    return StandingArm()


def expected(share: float, fault: Fault, joint: int) -> tuple[Fault, int]:
    return (Fault.NONE, -1) if share <= INSIDE else (fault, joint)


@some_joints
@both_ways
@pytest.mark.parametrize("share", [INSIDE, OUTSIDE])
def test_velocity(arm: StandingArm, joint: int, sign: float, share: float) -> None:
    config = ARM.joints[joint]
    limit = ARM.limits.velocity_margin * config.max_velocity_rad_s
    middle_rad = 0.5 * (config.lower_rad + config.upper_rad)
    velocity = sign * share * limit
    arm.choose(joint, middle_rad, middle_rad + velocity * PERIOD_S, velocity)
    assert arm.verdict() == expected(share, Fault.VELOCITY_LIMIT, joint)
    if share > INSIDE:
        assert arm.said() == pytest.approx((velocity, limit), rel=1e-5)


@some_joints
@both_ways
@pytest.mark.parametrize("before_share", [0.0, 0.5])
@pytest.mark.parametrize("share", [INSIDE, OUTSIDE])
def test_acceleration(arm: StandingArm, joint: int, sign: float, before_share: float, share: float) -> None:
    """From rest, and in motion, where speeding up and slowing down are alike."""
    config = ARM.joints[joint]
    limit = ARM.limits.acceleration_margin * config.max_acceleration_rad_s2
    before = before_share * config.max_velocity_rad_s
    middle_rad = 0.5 * (config.lower_rad + config.upper_rad)
    acceleration = sign * share * limit
    arm.choose(joint, middle_rad, middle_rad + (before + acceleration * PERIOD_S) * PERIOD_S, before)
    assert arm.verdict() == expected(share, Fault.ACCELERATION_LIMIT, joint)
    if share > INSIDE:
        assert arm.said() == pytest.approx((acceleration, limit), rel=1e-5)


@some_joints
@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize(
    ("beside_rad", "next_rad", "passes"),
    [
        (-1e-9, 0.0, True),  # up to the limit, all but standing
        (0.0, 0.0, True),
        (0.0, 1e-9, False),
        (0.1, 0.1, True),  # found outside: it may stand there, and move in, but not further out
        (0.1, 0.1 - 1e-9, True),
        (0.1, 0.1 + 1e-9, False),
    ],
)
def test_position(arm: StandingArm, joint: int, upper: bool, beside_rad: float, next_rad: float, passes: bool) -> None:
    config = ARM.joints[joint]
    limit = config.upper_rad + arm.slack_rad(joint) if upper else config.lower_rad - arm.slack_rad(joint)
    sign = 1.0 if upper else -1.0
    arm.choose(joint, limit + sign * beside_rad, limit + sign * next_rad)
    assert arm.verdict() == ((Fault.NONE, -1) if passes else (Fault.POSITION_LIMIT, joint))
    if not passes:
        assert arm.said() == pytest.approx((limit + sign * next_rad, limit), abs=1e-12)


def way_rad(velocity_rad_s: float, braking_rad_s2: float) -> float:
    """Of the setpoints of a joint that brakes as hard as it can, one after the other."""
    way, step = 0.0, braking_rad_s2 * PERIOD_S
    while velocity_rad_s > step:
        velocity_rad_s -= step
        way += velocity_rad_s * PERIOD_S
    return way


@some_joints
@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize(("beyond_rad", "passes"), [(-1e-7, True), (1e-7, False)])
def test_room_to_stop(arm: StandingArm, joint: int, upper: bool, beyond_rad: float, passes: bool) -> None:
    """At an even speed towards a limit, from where all that may be commanded just stops it, and just does not."""
    config, sign = ARM.joints[joint], 1.0 if upper else -1.0
    limit = config.upper_rad + arm.slack_rad(joint) if upper else config.lower_rad - arm.slack_rad(joint)
    braking = ARM.limits.acceleration_margin * config.max_acceleration_rad_s2 * (1.0 + ROUNDING)
    velocity = 0.8 * config.max_velocity_rad_s
    next_rad = limit - sign * (way_rad(velocity, braking) - beyond_rad)
    arm.choose(joint, next_rad - sign * velocity * PERIOD_S, next_rad, sign * velocity)
    assert arm.verdict() == ((Fault.NONE, -1) if passes else (Fault.POSITION_LIMIT, joint))
    if not passes:
        assert arm.said() == pytest.approx((limit + sign * beyond_rad, limit), abs=1e-9)


@some_joints
@pytest.mark.parametrize("upper", [True, False])
def test_away_from_a_limit_needs_no_room(arm: StandingArm, joint: int, upper: bool) -> None:
    """A joint that was found outside moves in with all its speed."""
    config, sign = ARM.joints[joint], 1.0 if upper else -1.0
    outside_rad = (config.upper_rad if upper else config.lower_rad) + sign * 0.5
    velocity = -sign * config.max_velocity_rad_s
    arm.choose(joint, outside_rad, outside_rad + velocity * PERIOD_S, velocity)
    assert arm.verdict() == (Fault.NONE, -1)


@some_joints
@pytest.mark.parametrize("word", ["next_position_rad", "next_velocity_rad_s"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number(arm: StandingArm, joint: int, word: str, value: float) -> None:
    arm.loop[0]["axes"][joint]["commanded"][word] = value
    assert arm.verdict() == (Fault.NOT_FINITE, joint)


def test_the_first_joint_that_breaks_a_limit_is_the_one_that_is_named(arm: StandingArm) -> None:
    for joint in (2, 4):
        arm.loop[0]["axes"][joint]["commanded"]["next_position_rad"] += 1.0
    assert arm.verdict()[1] == 2


@given(st.floats(-5.0, 5.0), st.floats(0.05, 40.0))
def test_the_way_to_rest_is_that_of_braking_step_by_step(velocity: float, braking: float) -> None:
    way = stopping_distance_rad(velocity, braking, PERIOD_S)
    assert way == pytest.approx(math.copysign(way_rad(abs(velocity), braking), velocity), abs=1e-9)


@some_joints
def test_a_position_is_clamped_to_what_the_joint_may_be_told(arm: StandingArm, joint: int) -> None:
    row, config = arm.loop[0]["joints"][joint], ARM.joints[joint]
    low, high = config.lower_rad - config.slack_rad, config.upper_rad + config.slack_rad
    for position, clamped in (
        (low - 1.0, low),
        (low, low),
        (0.5 * (low + high), 0.5 * (low + high)),
        (high + 1.0, high),
    ):
        assert clamped_rad(row, position) == pytest.approx(clamped, abs=1e-12)


@some_joints
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_keeps_room_as_long_as_it_stops_inside(arm: StandingArm, joint: int, sign: float) -> None:
    loop, config = arm.loop[0], ARM.joints[joint]
    limit = config.upper_rad + config.slack_rad if sign > 0.0 else config.lower_rad - config.slack_rad
    velocity = sign * 0.5 * config.max_velocity_rad_s
    way = stop_rad(loop, joint, 0.0, velocity)
    assert way * sign > 0.0

    def keeps(beyond: float, velocities: tuple[float, float]) -> bool:
        position = limit - way + sign * beyond
        return bool(keeps_room(loop, joint, position, position, min(velocities), max(velocities)))

    there = (velocity, velocity)
    assert keeps(-BESIDE_RAD, there) and keeps(0.0, there) and not keeps(3.0 * BESIDE_RAD, there)
    assert not keeps(3.0 * BESIDE_RAD, (0.0, velocity)), "the fastest of a span counts"
    assert keeps(way * sign + 1.0, (0.0, 0.0)), "one at rest was found there"
    assert keeps(way * sign + 1.0, (0.0, -velocity)), "and may move in"


EVERY_JOINT = (1 << len(ARM.joints)) - 1
ULPS = st.integers(-3, 3)


def refused_before(point: np.ndarray) -> bool:
    """What the ROS process makes of a trajectory of one point (joints, 3)."""
    none = np.zeros((len(ARM.joints), 3))
    plan = GoalPlan(
        np.zeros(1, np.int64),
        np.full(1, 5),
        point[np.newaxis],
        EVERY_JOINT,
        Terms(none, none, 0.0),
        0,
        0,
        Entry(0),
        none,
    )
    try:
        check_limits(plan, ARM)
    except BeyondLimits:
        return True
    return False


def refused_in_the_cycle(point: np.ndarray) -> bool:
    """What the control process makes of the same point when it takes it from the ring."""
    arm = StandingArm()
    record = arm.memory["scratch"]
    record["kind"], record["order"] = Setpoint.WAYPOINT, 5
    for joint, state in enumerate(point):
        for word, value in zip(("position_rad", "velocity_rad_s", "acceleration_rad_s2"), state, strict=True):
            record["joints"][joint][word] = value
    arm.memory["paths"][0]["joint_mask"] = EVERY_JOINT
    joint, _, _ = setpoint_reader.wrong_waypoint(arm.loop[0], 0)
    return bool(joint != setpoint_reader.SOUND)


def moved(value: float, ulps: int) -> float:
    """A number so many steps of double precision up, or down."""
    for _ in range(abs(ulps)):
        value = math.nextafter(value, math.copysign(math.inf, ulps))
    return value


@given(st.sampled_from(range(len(ARM.joints))), st.integers(0, 2), st.sampled_from([-1.0, 1.0]), ULPS)
def test_a_point_is_refused_before_just_where_the_cycle_would_refuse_it(
    joint: int, word: int, sign: float, ulps: int
) -> None:
    config = ARM.joints[joint]
    limit = (
        config.upper_rad + config.slack_rad if sign > 0.0 else config.lower_rad - config.slack_rad,
        sign * ARM.limits.velocity_margin * config.max_velocity_rad_s,
        sign * ARM.limits.acceleration_margin * config.max_acceleration_rad_s2,
    )[word]
    point = np.zeros((len(ARM.joints), 3))
    point[:, 0] = [0.5 * (config.lower_rad + config.upper_rad) for config in ARM.joints]
    point[joint, word] = moved(limit, ulps if sign > 0.0 else -ulps)
    assert refused_before(point) == refused_in_the_cycle(point) == (ulps > 0)
