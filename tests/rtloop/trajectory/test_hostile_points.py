"""Points closer together than a cycle whose velocities jump to and fro: refused, or played without a fault.

A cycle sees such a trajectory at one phase only, so the check of the front has to hold at all of them. On the mock
arm, through the real checks of the front and the real cycle, with the start at any phase of the cycle.
"""

from types import SimpleNamespace

import numpy as np
from depth import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from plain_messages import goal_of, point, trajectory
from virtual import VirtualArm

from config.loader import load_arm
from rosfront.goal import plan_goal, plan_stream
from rosfront.plan import GoalPlan, Present
from rosfront.refusals import GoalRefused
from rosfront.settings import Settings
from shm.words import Fault, Mode, Outcome

trials = settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.too_slow])
REFUSALS = (Outcome.REFUSED_START, Outcome.REFUSED_LIMITS)


class Hostile:
    """An arm and random messages for it."""

    def __init__(self, seed: int, rate_hz: float) -> None:
        self.random = np.random.default_rng(seed)
        self.arm = VirtualArm.brought_up(load_arm("mock", overrides={"control": {"rate_hz": rate_hz}}))
        self.settings = Settings.of(self.arm.arm)

    def present(self) -> Present:
        """Where the arm is commanded now; ROS time is the time of the loop."""
        now = self.arm.loop[0]["axes"]["commanded"][: len(self.arm.arm.joints)]
        words = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
        commanded = np.stack([now[word] for word in words], axis=1)
        standing = int(self.arm.memory["mode"]) == Mode.HOLDING
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
            point(times_ns[i] * 1e-9, position[i], velocity[i], acceleration[i] if bent else ()) for i in range(count)
        ]
        stamp_ns = 0 if random.random() < 0.3 else self.arm.now_ns + int(random.integers(-2 * period_ns, 2 * period_ns))
        return trajectory(points, [self.arm.arm.joints[joint].name for joint in joints], stamp_ns * 1e-9)

    def way(self, joint: int, times_s: np.ndarray, *, ends_at_rest: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A smooth way from where the joint is, with a ripple that changes the velocity by what a cycle allows."""
        random, config, now = self.random, self.arm.arm.joints[joint], self.arm.loop[0]["axes"][joint]["commanded"]
        period_s, count = self.arm.period_ns * 1e-9, len(times_s)
        hardest = self.arm.arm.limits.acceleration_margin * config.max_acceleration_rad_s2
        at = np.arange(count)
        ripple = [
            np.where(at % 2 == 0, 1.0, -1.0),
            random.uniform(-1.0, 1.0, count),
            np.sin(2.0 * np.pi * times_s / period_s * random.choice([0.5, 1.0, 1.0, 2.0]) + random.uniform(0.0, 6.0)),
        ][int(random.integers(3))]
        growing = np.minimum(1.0, at * random.uniform(0.02, 2.0))
        velocity = float(now["velocity_rad_s"]) + hardest * (
            period_s * random.uniform(0.1, 0.7) * growing * ripple + random.uniform(-0.7, 0.7) * times_s
        )
        velocity = np.clip(velocity, -config.max_velocity_rad_s, config.max_velocity_rad_s)
        if ends_at_rest:
            velocity[-1] = 0.0
        gaps_s = np.diff(times_s, prepend=times_s[0])
        position = float(now["position_rad"]) + random.normal(0.0, 1e-4)
        position = position + np.cumsum(gaps_s * 0.5 * (velocity + np.roll(velocity, 1)))
        if random.random() < 0.3:
            position += random.normal(0.0, 0.1 * hardest * period_s, count) * gaps_s
        return position, velocity, random.uniform(-1.0, 1.0, count) * hardest

    def send(self, plan: GoalPlan) -> int:
        return self.arm.send_goal(
            plan.times_ns,
            plan.joints,
            order=int(plan.orders[-1]),
            approach=plan.approach,
            stream=plan.stream,
            start_ns=plan.start_ns,
            joint_mask=plan.joint_mask,
        )


class Edge:
    """A goal whose velocities ripple just as much as the front accepts, and an arm that it is sent to."""

    def __init__(self, seed: int, rate_hz: float) -> None:
        self.seed = seed
        self.hostile = Hostile(seed, rate_hz)

    def plan(self) -> GoalPlan | None:
        """The plan of the strongest ripple that is accepted; None when not even the smooth way is."""
        best = self.accepted(0.0)
        if best is None:
            return None
        low, high = 0.0, 4.0
        for _ in range(8):
            middle = 0.5 * (low + high)
            plan = self.accepted(middle)
            if plan is None:
                high = middle
            else:
                low, best = middle, plan
        return best

    def accepted(self, strength: float) -> GoalPlan | None:
        hostile = self.hostile
        try:
            return plan_goal(goal_of(self.message(strength)), hostile.arm.arm, hostile.present(), hostile.settings)
        except GoalRefused:
            return None

    def message(self, strength: float) -> SimpleNamespace:
        """From standing to standing with constant acceleration and a cruise, plus a ripple of that strength."""
        random = np.random.default_rng(self.seed)  # the same shape for every strength
        arm = self.hostile.arm.arm
        period_s = self.hostile.arm.period_ns * 1e-9
        joints = random.permutation(len(arm.joints))[: int(random.choice([1, 2, 6]))]
        gap_s = period_s * random.choice([0.05, 0.13, 0.25, 0.5, 0.5, 0.9, 1.0, 1.1, 2.5])
        count = min(int(random.choice([0.8, 1.5, 3.0]) / gap_s), 2000)
        times_s, at = np.arange(count) * gap_s, np.arange(count)
        to_end = np.minimum(at, count - 1 - at)
        positions, velocities = [], []
        for joint in joints:
            config = arm.joints[joint]
            hardest = config.max_acceleration_rad_s2
            pace = hardest * random.uniform(0.3, 0.9)
            cruise = config.max_velocity_rad_s * random.uniform(0.3, 0.95)
            ripple = [
                np.where(at % 2 == 0, 1.0, -1.0),
                random.uniform(-1.0, 1.0, count),
                np.sin(
                    2.0 * np.pi * times_s / period_s * random.choice([0.33, 0.5, 1.0, 2.0]) + random.uniform(0.0, 6.0)
                ),
                (random.random(count) < 0.03) * random.choice([-1.0, 1.0], count),
            ][int(random.integers(4))]
            if random.random() < 0.5:  # somewhere on the way only
                ripple = ripple * (np.abs(times_s - random.uniform(0.0, 0.6)) < random.uniform(0.01, 0.2))
            velocity = np.minimum(pace * gap_s * to_end, cruise) * random.choice([-1.0, 1.0])
            velocity = velocity + strength * hardest * period_s * ripple * np.minimum(1.0, to_end / 5.0)
            steps = 0.5 * gap_s * (velocity[1:] + velocity[:-1])
            offset = random.uniform(-1.0, 1.0) * random.choice([0.0, 2e-3, 0.04, 0.045])
            positions.append(offset + np.concatenate([[0.0], np.cumsum(steps)]))
            velocities.append(velocity)
        late_s = random.choice([0.0, 0.0, 0.001, 0.05])
        points = [
            point(times_s[i] + late_s, [way[i] for way in positions], [way[i] for way in velocities])
            for i in range(count)
        ]
        return trajectory(points, [arm.joints[joint].name for joint in joints])


@trials
@given(st.integers(0, 10**9), st.sampled_from([100.0, 120.0, 200.0]))
def test_a_hostile_goal_is_refused_or_succeeds(seed: int, rate_hz: float) -> None:
    hostile = Hostile(seed, rate_hz)
    message = goal_of(hostile.message(ends_at_rest=True))
    try:
        plan = plan_goal(message, hostile.arm.arm, hostile.present(), hostile.settings)
    except GoalRefused as refusal:
        assert str(refusal).endswith(".")
        return
    arm = hostile.arm
    goal = hostile.send(plan)
    arm.end_of(goal)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.outcome(goal) in (Outcome.SUCCEEDED, *REFUSALS)
    arm.close()


@trials
@given(st.integers(0, 10**9), st.sampled_from([100.0, 120.0, 200.0]), st.integers(1, 8))
@example(4232059, 120.0, 2)  # braked so late on the way onto it that a limit is 8 µrad too near
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
    arm.until(lambda: arm.memory["mode"] != Mode.EXECUTING, at_most_s=5.0)
    assert arm.memory["fault"]["code"] == Fault.NONE
    arm.close()


@trials
@given(
    st.integers(0, 10**9),
    st.sampled_from([50.0, 100.0, 120.0, 200.0, 500.0]),
    st.sampled_from(["nobody", "cancel", "hold", "speed", "slow"]),
)
@example(2575, 200.0, "hold")  # the ramp that resumes it hits a phase at which two setpoints are too far apart
@example(2852, 50.0, "hold")
@example(3175, 200.0, "hold")  # before it has begun
@example(1112583, 500.0, "cancel")  # a cycle cannot look at all setpoints of the stop
@example(498, 500.0, "hold")
@example(571, 500.0, "hold")
def test_what_the_front_just_accepts_is_followed_whatever_the_clock_does(seed: int, rate_hz: float, who: str) -> None:
    edge = Edge(seed, rate_hz)
    arm = edge.hostile.arm
    plan = edge.plan()
    if plan is None:
        return
    random, ends = np.random.default_rng(seed), Outcome.SUCCEEDED
    if who == "slow":
        arm.writer.scale(float(random.uniform(0.2, 0.95)))
        arm.cycles(2)
    goal = edge.hostile.send(plan)
    arm.cycles(int(random.integers(1, max(2, round(plan.duration_s * rate_hz)))))
    if who == "cancel":
        arm.writer.cancel(goal)
        ends = Outcome.CANCELED
    elif who == "hold":
        if arm.memory["mode"] != Mode.EXECUTING:  # what is held before it has begun never begins
            ends = Outcome.REFUSED_HELD
        arm.writer.hold()
        arm.cycles(round(0.3 * rate_hz))
        arm.writer.resume()
    elif who == "speed":
        arm.writer.scale(float(random.uniform(0.1, 0.9)))
        arm.cycles(round(0.05 * rate_hz))
        arm.writer.scale(1.0)
    arm.end_of(goal, at_most_s=60.0)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.outcome(goal) in (ends, *REFUSALS)
    arm.close()
