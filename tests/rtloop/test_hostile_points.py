"""Points closer together than a cycle whose velocities jump to and fro: refused, or played without a fault.

A cycle sees such a trajectory at one phase only, so the check of the front has to hold at all of them. On the mock
arm, through the real checks of the front and the real cycle, with the start at any phase of the cycle.
"""

from types import SimpleNamespace

import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.loader import load_arm
from rosfront.goal import plan_goal, plan_stream
from rosfront.plan import GoalPlan, Present
from rosfront.refusals import GoalRefused
from rosfront.settings import Settings
from shm.words import Fault, Mode, Outcome

trials = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
REFUSALS = (Outcome.REFUSED_START, Outcome.REFUSED_LIMITS)


class Hostile:
    """An arm and random messages for it."""

    def __init__(self, seed: int, rate_hz: float) -> None:
        self.random = np.random.default_rng(seed)
        self.arm = VirtualArm(load_arm("mock", overrides={"control": {"rate_hz": rate_hz}}))
        assert self.arm.bring_up().failure is None
        self.settings = Settings.of(self.arm.arm)

    def present(self) -> Present:
        """Where the arm is commanded now; ROS time is the time of the loop."""
        axes = self.arm.loop[0]["axes"][: len(self.arm.arm.joints)]
        words = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
        commanded = np.stack([axes[word] for word in words], axis=1)
        standing = int(self.arm.core["mode"]) == Mode.HOLDING
        return Present(commanded, standing, self.arm.now_ns, self.arm.now_ns)

    def message(self, *, ends_at_rest: bool) -> SimpleNamespace:
        """Points for some joints, at a gap of their own, with a stamp that is due at any phase of the cycle."""
        random, period_ns = self.random, self.arm.period_ns
        joints = random.permutation(len(self.arm.arm.joints))[: int(random.choice([1, 1, 2, 6]))]
        count = int(random.integers(2, 40))
        gap_ns = period_ns * random.choice([0.05, 0.1, 0.25, 0.5, 0.5, 1.0, 1.0, 1.3])
        gaps_ns = gap_ns * (np.ones(count) if random.random() < 0.5 else random.uniform(0.1, 2.0, count))
        times_ns = np.cumsum(gaps_ns.astype(int))
        if random.random() < 0.5:
            times_ns -= times_ns[0]
        ways = [self.way(joint, times_ns * 1e-9, ends_at_rest=ends_at_rest) for joint in joints]
        position, velocity, acceleration = (np.array(rows).T.tolist() for rows in zip(*ways, strict=True))
        bent = random.random() < 0.3
        points = [
            SimpleNamespace(
                time_from_start=SimpleNamespace(sec=0, nanosec=int(times_ns[i])),
                positions=position[i],
                velocities=velocity[i],
                accelerations=acceleration[i] if bent else [],
                effort=[],
            )
            for i in range(count)
        ]
        stamp_ns = 0 if random.random() < 0.3 else self.arm.now_ns + int(random.integers(-2 * period_ns, 2 * period_ns))
        return SimpleNamespace(
            header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=stamp_ns)),
            joint_names=[self.arm.arm.joints[joint].name for joint in joints],
            points=points,
        )

    def way(self, joint: int, times_s: np.ndarray, *, ends_at_rest: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A smooth way from where the joint is, with a ripple that changes the velocity by what a cycle allows."""
        random, config, axis = self.random, self.arm.arm.joints[joint], self.arm.loop[0]["axes"][joint]
        period_s, count = self.arm.period_ns * 1e-9, len(times_s)
        hardest = self.arm.arm.limits.acceleration_margin * config.max_acceleration_rad_s2
        at = np.arange(count)
        ripple = [
            np.where(at % 2 == 0, 1.0, -1.0),
            random.uniform(-1.0, 1.0, count),
            np.sin(2.0 * np.pi * times_s / period_s * random.choice([0.5, 1.0, 1.0, 2.0]) + random.uniform(0.0, 6.0)),
        ][int(random.integers(3))]
        growing = np.minimum(1.0, at * random.uniform(0.02, 2.0))
        velocity = float(axis["velocity_rad_s"]) + hardest * (
            period_s * random.uniform(0.1, 0.7) * growing * ripple + random.uniform(-0.7, 0.7) * times_s
        )
        velocity = np.clip(velocity, -config.max_velocity_rad_s, config.max_velocity_rad_s)
        if ends_at_rest:
            velocity[-1] = 0.0
        gaps_s = np.diff(times_s, prepend=times_s[0])
        position = float(axis["position_rad"]) + random.normal(0.0, 1e-4)
        position = position + np.cumsum(gaps_s * 0.5 * (velocity + np.roll(velocity, 1)))
        if random.random() < 0.3:
            position += random.normal(0.0, 0.1 * hardest * period_s, count) * gaps_s
        return position, velocity, random.uniform(-1.0, 1.0, count) * hardest

    def send(self, plan: GoalPlan) -> int:
        return self.arm.send_goal(
            plan.times_ns,
            plan.joints,
            order=int(plan.orders[-1]),
            bridge=plan.bridge,
            stream=plan.stream,
            start_ns=plan.start_ns,
            joint_mask=plan.joint_mask,
        )


def as_goal(trajectory: SimpleNamespace) -> SimpleNamespace:
    """A goal message around a trajectory, with the default tolerances."""
    return SimpleNamespace(
        trajectory=trajectory,
        multi_dof_trajectory=SimpleNamespace(joint_names=[], points=[]),
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=[],
        component_goal_tolerance=[],
        goal_time_tolerance=SimpleNamespace(sec=0, nanosec=0),
    )


@trials
@given(st.integers(0, 10**9), st.sampled_from([100.0, 120.0, 200.0]))
def test_a_hostile_goal_is_refused_or_succeeds(seed: int, rate_hz: float) -> None:
    hostile = Hostile(seed, rate_hz)
    message = as_goal(hostile.message(ends_at_rest=True))
    try:
        plan = plan_goal(message, hostile.arm.arm, hostile.present(), hostile.settings)
    except GoalRefused as refusal:
        assert str(refusal).endswith(".")
        return
    arm = hostile.arm
    goal = hostile.send(plan)
    arm.until(lambda: arm.outcome(goal) != Outcome.NONE)
    assert arm.core["fault"] == Fault.NONE
    assert arm.outcome(goal) in (Outcome.SUCCEEDED, *REFUSALS)
    arm.close()


@trials
@given(st.integers(0, 10**9), st.sampled_from([100.0, 120.0, 200.0]), st.integers(1, 8))
@example(1529, 100.0, 5)  # the acceleration of the last point carries it beyond its velocity limit
def test_hostile_messages_of_a_stream_are_refused_or_followed(seed: int, rate_hz: float, messages: int) -> None:
    hostile = Hostile(seed, rate_hz)
    arm = hostile.arm
    for _ in range(messages):
        message = hostile.message(ends_at_rest=bool(hostile.random.random() < 0.3))
        try:
            plan = plan_stream(message, arm.arm, hostile.present(), hostile.settings)
        except GoalRefused as refusal:
            assert str(refusal).endswith(".")
            arm.cycle()
            continue
        hostile.send(plan)
        arm.cycles(int(hostile.random.integers(1, 12)))
    arm.until(lambda: arm.core["mode"] != Mode.EXECUTING, at_most_s=5.0)
    assert arm.core["fault"] == Fault.NONE
    arm.close()
