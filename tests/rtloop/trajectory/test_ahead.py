"""Looking ahead: the answer is that of differencing every setpoint, and no cycle looks at more than it may."""

import numpy as np
from depth import examples
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from virtual import VirtualArm

from config.loader import load_arm
from rtloop.trajectory import ahead, entry, limits, path
from shm.words import Fault, Outcome

trials = settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.too_slow])
ENOUGH = 10**6


def arm_with_blend(seed: int, rate_hz: float) -> tuple[VirtualArm, int, float]:
    """An arm at rest, a goal that lies in the path not running with a blend onto it, and the rate it is entered at."""
    random = np.random.default_rng(seed)
    arm = VirtualArm.brought_up(load_arm("mock", overrides={"control": {"rate_hz": rate_hz}}))
    arm.memory["operator"]["speed_scale"] = 0.0  # nothing starts
    joints = arm.arm.joints
    gap_s = random.choice([0.2, 0.7, 1.0, 1.7, 10.0, 60.0]) / rate_hz
    count = int(random.uniform(0.5, 1.2) / gap_s) + 2
    gaps_s = gap_s * (random.uniform(0.2, 1.8, count) if random.random() < 0.5 else np.ones(count))
    times_s = np.cumsum(gaps_s) - gaps_s[0]
    waypoints = np.zeros((count, len(joints), 3))
    for index, joint in enumerate(joints):
        hardest = joint.max_acceleration_rad_s2
        swing = random.uniform(0.1, 1.6) * hardest * np.sin(random.uniform(0.5, 6.0) * times_s)
        ripple = random.choice([0.0, 0.1, 0.5, 1.0]) * hardest / rate_hz * random.uniform(-1.0, 1.0, count)
        velocity = np.clip(0.1 * swing + ripple, -joint.max_velocity_rad_s, joint.max_velocity_rad_s)
        steps = 0.5 * np.diff(times_s) * (velocity[1:] + velocity[:-1])
        waypoints[:, index, 0] = random.normal(0.0, 0.001) + np.concatenate([[0.0], np.cumsum(steps)])
        waypoints[:, index, 1] = velocity
    arm.send_goal((times_s * 1e9).astype(int), waypoints, order=int(random.choice([1, 3, 3, 3])))
    arm.until(lambda: not arm.pending)
    arm.cycles(25)  # until all of it is taken
    assume(arm.waiting_goal != 0)  # it was not refused for a waypoint beyond its limits
    rate = float(random.choice([1.0, 0.5, 0.3]))
    index = 1 - int(arm.memory["goals"]["active"])
    entry.lay_blend(arm.loop[0], index, rate, 0.0, float(random.choice([0.1, 0.3, 0.45])))
    if random.random() < 0.5:
        joint = int(random.integers(len(joints)))
        farthest_rad = max(positions_rad(arm, index, rate, joint))
        arm.loop["joints"]["upper_rad"][0, joint] = farthest_rad + random.uniform(-5e-4, 5e-5)
    return arm, index, rate


def clocks_s(arm: VirtualArm, index: int, rate: float) -> list[float]:
    """Path times of the setpoints to two cycles after the blend."""
    way, step_s = arm.loop["paths"][0, index], rate * arm.period_ns * 1e-9
    count = int(np.ceil(way["blend_s"] / step_s)) + ahead.CYCLES_AFTER_BLEND
    return [float(way["entry_s"]) + i * step_s for i in range(1, count + 1)]


def positions_rad(arm: VirtualArm, index: int, rate: float, joint: int) -> list[float]:
    """The commanded setpoint of a joint, and those at these path times."""
    loop = arm.loop[0]
    ahead_rad = [
        path.sample(loop, index, joint, clock_s, path.find_waypoint(loop, index, clock_s, 0))[0]
        for clock_s in clocks_s(arm, index, rate)
    ]
    return [float(loop["axes"][joint]["commanded"]["position_rad"]), *ahead_rad]


def differences_keep_limits(arm: VirtualArm, index: int, rate: float) -> bool:
    """Every setpoint to two cycles after the blend, differenced as the last defence does."""
    loop = arm.loop[0]
    period_s = arm.period_ns * 1e-9
    # else the clock stops before
    assume(path.goes_on_past_end(loop, index) or clocks_s(arm, index, rate)[-1] <= path.end_s(loop, index))
    for joint in range(len(arm.arm.joints)):
        positions = positions_rad(arm, index, rate, joint)
        velocity = np.diff(positions) / period_s
        acceleration = np.diff(velocity, prepend=0.0) / period_s
        if np.max(np.abs(velocity)) > limits.highest_rad_s(loop, joint):
            return False
        if np.max(np.abs(acceleration)) > limits.hardest_rad_s2(loop, joint):
            return False
        room = [limits.keeps_room(loop, joint, p, p, v, v) for p, v in zip(positions[1:], velocity, strict=True)]
        assume(all(room[-ahead.CYCLES_AFTER_BLEND :]))  # of the plan alone, which the front has judged
        if not all(room):
            return False
    return True


@trials
@given(st.integers(0, 10**9), st.sampled_from([50.0, 120.0, 500.0, 1000.0]))
def test_spans_and_setpoints_say_what_every_setpoint_says(seed: int, rate_hz: float) -> None:
    arm, index, rate = arm_with_blend(seed, rate_hz)
    arm.loop["search"]["checks_left"] = ENOUGH
    keeps = ahead.blend_keeps_limits(arm.loop[0], index, rate)
    assert keeps == differences_keep_limits(arm, index, rate)
    arm.close()


@trials
@given(st.integers(0, 10**9), st.integers(3, 50))
def test_a_search_over_several_cycles_says_what_one_says(seed: int, looks: int) -> None:
    arm, index, rate = arm_with_blend(seed, 500.0)
    loop = arm.loop[0]
    loop["search"]["checks_left"] = ENOUGH
    at_once = ahead.blend_keeps_limits(loop, index, rate)
    needed = ENOUGH - int(loop["search"]["checks_left"])
    keeps, cycles = False, 0
    loop["search"]["checks_left"] = -1
    while not keeps and loop["search"]["checks_left"] < 0:
        before = int(loop["search"]["judged"])
        loop["search"]["checks_left"] = looks
        keeps = ahead.blend_keeps_limits(loop, index, rate)
        cycles += 1
        assert cycles <= needed
        assert loop["search"]["judged"] >= before
    assert keeps == at_once
    assert cycles >= needed / looks
    arm.close()


def test_a_bump_that_every_way_meets_is_found_over_several_cycles() -> None:
    arm = VirtualArm.brought_up(load_arm("mock", overrides={"control": {"rate_hz": 1000.0}}))
    times_s = np.arange(3000) * 0.0009
    waypoints = np.zeros((3000, 6, 3))
    waypoints[295, :, 0] = [10.0 * joint.max_acceleration_rad_s2 * 1e-6 for joint in arm.arm.joints]
    goal = arm.send_goal((times_s * 1e9).astype(int), waypoints, order=3)
    arm.until(lambda: arm.waiting_goal == goal)
    begun = int(arm.memory["timing"]["cycle"])
    assert arm.end_of(goal) == Outcome.REFUSED_LIMITS
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert (
        int(arm.memory["timing"]["cycle"]) - begun > 5
    )  # hundreds of setpoints lie before the bump, on each of a dozen ways
    arm.close()
