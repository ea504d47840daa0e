"""Axes that take seconds to brake: what the ROS process keeps ahead, and the control cycle, in virtual time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from arm_files import known_arm
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.schema import ArmConfig
from config.stopping import LONGEST_ALLOWED_S, longest_stop_s
from rosfront.plan import GoalPlan, Terms
from rosfront.streamer import Streamer, horizon_s
from shm.words import Entry, Fault, Mode, Outcome

NS = 1_000_000_000
SLOWEST_S = 0.999 * LONGEST_ALLOWED_S / longest_stop_s(1.0)
POINT_S = 0.1
CRUISE_S = 20.0
WAYS = ("cancel", "stop", "hold", "scale", "silence")

trials = settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.too_slow])


def slow_arm(slowness_s: float, **limits: float) -> ArmConfig:
    """Mock drives that all take so long from rest to their highest velocity, each with room for it."""
    values: dict[str, Any] = known_arm("mock") | {"limits": limits}
    values["control"]["rate_hz"] = 50
    for joint in values["joints"]:
        joint |= {"motor_rpm": joint["ratio"] / 6.0, "lower_deg": -36_000, "upper_deg": 36_000}  # 1 °/s
        joint["max_acceleration_rad_s2"] = math.radians(1.0) / slowness_s
    return ArmConfig.model_validate(values)


def there_and_back(arm: ArmConfig, ripple: float) -> tuple[np.ndarray, np.ndarray]:
    """Points as planners give them: up to full speed at the acceleration limit, on, and down again; times, (n, 6, 3).

    `ripple` of the limit is used for going faster and slower once a second instead, all along.
    """
    joint = arm.joints[0]
    depth = ripple * joint.max_acceleration_rad_s2 / (2.0 * math.pi)
    speed = joint.max_velocity_rad_s - depth
    limit = (1.0 - ripple) * joint.max_acceleration_rad_s2
    up_s = math.ceil(speed / limit / POINT_S) * POINT_S
    times = np.arange(0.0, 2.0 * up_s + CRUISE_S + POINT_S / 2, POINT_S)
    accelerations = np.where(times < up_s, speed / up_s, np.where(times < up_s + CRUISE_S, 0.0, -speed / up_s))
    velocities = np.concatenate([[0.0], np.cumsum(accelerations[:-1] * POINT_S)])
    positions = np.concatenate([[0.0], np.cumsum((velocities[:-1] + velocities[1:]) * POINT_S / 2)])
    angle = 2.0 * math.pi * times
    positions += depth * (times - np.sin(angle) / (2.0 * math.pi)) * 0.5
    velocities += depth * (1.0 - np.cos(angle)) * 0.5
    waypoints = np.stack([positions, velocities, np.zeros_like(times)], axis=1)
    return np.round(times * NS).astype(np.int64), np.repeat(waypoints[:, None, :], len(arm.joints), axis=1)


class ServedArm(VirtualArm):
    """An arm whose goals are written by the ROS process' streamer, as often as that looks."""

    streamer: Streamer | None = None

    def serve(self, times_ns: np.ndarray, waypoints: np.ndarray) -> int:
        """Begin a goal; its number."""
        rows = len(self.arm.joints)
        terms = Terms(np.zeros((rows, 3)), np.full((rows, 3), 0.1), 0.4)
        orders = np.full(len(times_ns), 3)
        plan = GoalPlan(times_ns, orders, waypoints, (1 << rows) - 1, terms, 0, 0, Entry(0), waypoints[0])
        goal = self.writer.announced_goal + 1
        self.streamer = Streamer(goal, plan, int(self.memory["goals"]["epoch"]), horizon_s(self.arm))
        return goal

    def _feed_ring(self) -> None:
        if self.streamer is not None and not self.streamer.done:
            snapshot = self.reader.snapshot()
            running = int(snapshot["goal_id"]) == self.streamer.goal_id
            clock_ns = float(snapshot["trajectory_clock_ns"]) if running else 0.0
            self.streamer.pump(self.writer, self.reader.setpoints_consumed(), clock_ns)

    def end_by(self, way: str, goal: int) -> None:
        if way == "cancel":
            self.writer.cancel(goal)
        elif way == "scale":
            self.writer.scale(0.0)
        elif way == "silence":
            self.front_alive = False
        else:
            getattr(self.writer, way)()


def stops_well(slowness_s: float, way: str, share: float, ripple: float = 0.0) -> float:
    """Stop an arm at such a share of its motion: the largest acceleration it was commanded, over its limit."""
    arm = ServedArm.brought_up(slow_arm(slowness_s))
    times_ns, waypoints = there_and_back(arm.arm, ripple)
    goal = arm.serve(times_ns, waypoints)
    positions: list[float] = []

    def cycles(count: int) -> None:
        for _ in range(count):
            arm.cycle()
            positions.append(float(arm.loop[0]["axes"]["commanded"]["position_rad"][0]))

    cycles(max(3, round(share * times_ns[-1] / arm.period_ns)))
    assert arm.memory["mode"] == Mode.EXECUTING
    arm.end_by(way, goal)
    noticed_s = arm.arm.limits.front_timeout_s if way == "silence" else 0.0
    cycles(math.ceil((noticed_s + arm.arm.longest_stop_s) * NS / arm.period_ns) + 3)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"])
    ended = {"cancel": Outcome.CANCELED, "stop": Outcome.STOPPED, "silence": Outcome.FRONT_LOST}
    kept = (Outcome.NONE, Outcome.SUCCEEDED)  # an end that is nearer than the stop is arrived at
    assert arm.outcome(goal) == ended[way] if way in ended else arm.outcome(goal) in kept
    period_s = arm.period_ns * 1e-9
    hardest = float(np.abs(np.diff(positions, 2)).max()) / period_s**2
    arm.close()
    return hardest / arm.arm.joints[0].max_acceleration_rad_s2


def test_an_axis_that_brakes_for_ten_seconds_stops_at_cruise() -> None:
    """It was braked at 1.97 times its limit, on the 2.5 s of its path that were known, and latched a fault."""
    for way in WAYS:
        assert 0.9 <= stops_well(10.0, way, 0.5) <= 1.5


@trials
@given(st.floats(0.3, SLOWEST_S), st.sampled_from(WAYS), st.floats(0.0, 0.97))
def test_whatever_ends_a_slow_motion_brakes_it_within_the_longest_stop(
    slowness_s: float, way: str, share: float
) -> None:
    assert stops_well(slowness_s, way, share) <= 1.5 * (1.0 + 1e-3)


@trials
@given(st.floats(0.3, SLOWEST_S), st.sampled_from(WAYS), st.floats(0.0, 0.97), st.floats(0.1, 0.9))
def test_a_motion_that_goes_faster_and_slower_all_along_is_stopped_too(
    slowness_s: float, way: str, share: float, ripple: float
) -> None:
    assert stops_well(slowness_s, way, share, ripple) <= 1.6
