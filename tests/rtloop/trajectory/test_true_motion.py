"""What the simulated drives truly do while recorded MoveIt goals run, and when something interrupts them.

Everything is judged by the drives' own velocity history, never by a variable of the loop. Accelerations are
differences of mean velocities over adjoining windows of 20 ms, since a drive's speed is a staircase of whole
rpm (see tests/motion_figures.py).
"""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motion_figures import sampled_truth
from true_motion import commanded_until_end, largest_acceleration_ratio, moving, path_error_deg, velocity_ripple
from virtual import GOALS, VirtualArm, recorded_goal

from config.derived import derived_table
from config.loader import load_arm
from shm.words import Fault, Mode, Outcome

NAMES = sorted(path.stem for path in GOALS.glob("*.json"))
INTERRUPTED = ("large", "scale_1_0", "near_limits_high", "around_box", "small", "single_joint", "cartesian")
AFTER_CYCLES = 40

moments = st.tuples(st.sampled_from(INTERRUPTED), st.floats(0.05, 0.95))
trials = settings(
    max_examples=6,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def stays_inside_limits(arm: VirtualArm, start_ns: int) -> None:
    for joint, config in enumerate(arm.arm.joints):
        _, position_rad, velocity_rad_s = sampled_truth(arm.sim, joint, start_ns, arm.sim.now_ns)
        slack = 2 * config.command_pulse_rad
        assert position_rad.min() >= config.lower_rad - slack
        assert position_rad.max() <= config.upper_rad + slack
        one_rpm = 2 * math.pi / 60 / config.ratio
        # a margin of 5 % on the plan, 5 % for catching up with it, and the whole-rpm speed field
        assert np.abs(velocity_rad_s).max() <= 1.10 * config.max_velocity_rad_s + one_rpm


@pytest.mark.parametrize("name", NAMES)
def test_recorded_goals_run_true(name: str) -> None:
    """Path error, acceleration and final error of every recorded goal."""
    goal = recorded_goal(name)
    arm = VirtualArm.at_start_of(name)
    started_ns = arm.now_ns
    goal_id = arm.play(name)
    commanded = commanded_until_end(arm, goal_id)
    assert arm.outcome(goal_id) == Outcome.SUCCEEDED
    assert (arm.now_ns - started_ns) * 1e-9 < goal["times_ns"][-1] * 1e-9 + 0.1
    arm.cycles(AFTER_CYCLES)
    assert largest_acceleration_ratio(arm, started_ns) <= 1.6
    stays_inside_limits(arm, started_ns)
    for joint, config in enumerate(arm.arm.joints):
        if joint < 3:
            assert path_error_deg(arm, joint, *commanded) <= 0.02
        end_rad = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        assert abs(end_rad - goal["joints"][-1, joint, 0]) <= config.slack_rad
    arm.close()


@pytest.mark.parametrize(("joint", "motor_rpm"), [(0, 100.0), (2, 100.0), (1, 60.0), (0, 10.0), (1, 10.0), (2, 10.0)])
def test_velocity_ripple_at_constant_speed(joint: int, motor_rpm: float) -> None:
    """The speed field holds whole rpm, of which two in turn may be half an rpm off (rms): nothing roughens it further.

    The beginning in each of six cycles, since a status is read of another drive in each, which shifts the readings.
    """
    ripples = []
    for wait_cycles in range(6):
        arm = VirtualArm.brought_up()
        arm.cycles(wait_cycles)
        speed_rad_s = motor_rpm * 2 * math.pi / 60 / arm.arm.joints[joint].ratio
        # away from joint limits on every joint, and through negative counts
        ripples.append(velocity_ripple(arm, joint, -speed_rad_s, 2.0, 0.6))
        arm.close()
    assert max(ripples) <= 0.5 / motor_rpm, ripples


@trials
@given(moments)
def test_silence_is_a_controlled_stop(moment: tuple[str, float]) -> None:
    """The stream is cut: every joint brakes by itself within 2.2 times its limit and stands soon."""
    arm, _, started_ns = moving(*moment)
    arm.sim.run_until(arm.now_ns + 2_000_000_000)
    assert largest_acceleration_ratio(arm, started_ns) <= 2.2
    for joint in range(6):
        assert arm.sim.true_velocity_rad_s(joint, arm.sim.now_ns - 1) == 0.0
    arm.close()


@pytest.mark.parametrize("joint", range(5))  # joint6 has no room for its full speed and a stop
def test_coast_in_silence_is_what_the_configuration_says(joint: int) -> None:
    """From the last frame heard at full speed until standstill; `rtarm config check` prints it."""
    config = load_arm("episode1").joints[joint]
    start_rad = [0.0] * 6
    start_rad[joint] = config.lower_rad + 0.02
    arm = VirtualArm.brought_up(start_rad=start_rad)
    speed = config.max_velocity_rad_s
    speed_up_s = speed / config.max_acceleration_rad_s2
    way = speed * speed_up_s / 2
    on_s = min(1.0, (config.upper_rad - config.lower_rad - 0.1 - 2 * way) / speed)
    times_s = np.array([0.0, speed_up_s, speed_up_s + on_s, 2 * speed_up_s + on_s])
    joints = np.zeros((4, 6, 3))
    joints[:, joint, 0] = start_rad[joint] + np.array([0.0, way, way + on_s * speed, 2 * way + on_s * speed])
    joints[:, joint, 1] = [0.0, speed, speed, 0.0]
    arm.send_goal((times_s * 1e9).astype(np.int64), joints, order=3)
    arm.cycles(int((speed_up_s + 0.8 * on_s) / arm.period_ns * 1e9))
    heard = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
    heard_ns = arm.sim.now_ns
    arm.sim.run_until(heard_ns + 2_000_000_000)
    coast_deg = math.degrees(abs(arm.sim.true_position_rad(joint, arm.sim.now_ns - 1) - heard))
    stop = derived_table(arm.arm)[joint].silence
    delay_s = arm.loop[0]["joints"][joint]["command_delay_s"]
    # the last frame itself was still on its way when the simulated bus was asked where the joint is
    on_its_way_deg = math.degrees(speed) * (delay_s + 0.002)
    assert coast_deg == pytest.approx(stop.coast_deg, abs=0.06 * stop.coast_deg + on_its_way_deg)
    arm.close()


@trials
@given(moments)
def test_cancel_stops_on_the_path(moment: tuple[str, float]) -> None:
    arm, goal_id, started_ns = moving(*moment)
    asked_ns = arm.now_ns
    arm.writer.cancel(goal_id)
    assert arm.end_of(goal_id) in (Outcome.CANCELED, Outcome.SUCCEEDED)
    assert (arm.now_ns - asked_ns) * 1e-9 <= arm.loop[0]["params"]["longest_stop_s"] + 0.1
    arm.cycles(AFTER_CYCLES)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 1.75
    stays_inside_limits(arm, started_ns)
    assert distance_from_path(arm, moment[0]) <= 0.02
    arm.close()


def distance_from_path(arm: VirtualArm, name: str) -> float:
    """Distance (rad, largest joint) of the standing arm from the nearest point of the recorded path."""
    goal = recorded_goal(name)
    from motion import segment

    seconds = goal["times_ns"] * 1e-9
    best = math.inf
    here = np.array([arm.sim.true_position_rad(joint, arm.sim.now_ns - 1) for joint in range(6)])
    for i in range(len(seconds) - 1):
        duration = seconds[i + 1] - seconds[i]
        a, b = goal["joints"][i], goal["joints"][i + 1]
        coefficients = segment.quintic(a[:, 0], a[:, 1], a[:, 2], b[:, 0], b[:, 1], b[:, 2], duration)
        for t in np.linspace(0.0, duration, 25):
            best = min(best, float(np.abs(segment.evaluate(*coefficients, t)[0] - here).max()))
    return best


@trials
@given(moments, st.integers(3, 120), st.integers(1, 60))
def test_pause_and_resume_keep_the_goal(moment: tuple[str, float], pause: int, again: int) -> None:
    """A pause of any length, resumed, paused and resumed again: the goal ends where it should."""
    arm, goal_id, started_ns = moving(*moment)
    for wait, ask in ((pause, arm.writer.hold), (again, arm.writer.resume), (again, arm.writer.hold)):
        ask()
        arm.cycles(wait)
    arm.writer.resume()
    assert arm.end_of(goal_id) == Outcome.SUCCEEDED
    arm.cycles(AFTER_CYCLES)
    assert largest_acceleration_ratio(arm, started_ns) <= 2.0
    stays_inside_limits(arm, started_ns)
    arm.close()


@trials
@given(moments, st.floats(0.0, 1.0), st.integers(1, 40), st.floats(0.0, 1.0))
def test_speed_override_live(moment: tuple[str, float], first: float, wait: int, second: float) -> None:
    arm, goal_id, started_ns = moving(*moment)
    arm.writer.scale(first)
    arm.cycles(wait)
    arm.writer.scale(second)
    arm.cycles(120)
    arm.writer.scale(1.0)
    assert arm.end_of(goal_id) == Outcome.SUCCEEDED
    assert largest_acceleration_ratio(arm, started_ns) <= 2.0
    stays_inside_limits(arm, started_ns)
    arm.close()


@trials
@given(moments, st.floats(0.3, 1.2))
def test_replacement_in_motion(moment: tuple[str, float], slowness: float) -> None:
    """A newer goal, back to where the arm came from, takes over without a jump."""
    name, _ = moment
    arm, goal_id, started_ns = moving(*moment)
    goal = recorded_goal(name)
    here = arm.loop[0]["axes"]["commanded"]["position_rad"][:6]
    speeds = np.array([joint.max_velocity_rad_s for joint in arm.arm.joints])
    back = goal["joints"][:1].copy()
    back[:, :, 1:] = 0.0
    duration_s = max(0.6, float((2.0 * np.abs(back[0, :, 0] - here) / speeds).max()) / slowness)
    newer = arm.send_goal(np.array([int(duration_s * 1e9)]), back, approach=True)
    arm.end_of(newer, at_most_s=200)
    assert arm.outcome(goal_id) in (Outcome.REPLACED, Outcome.SUCCEEDED)
    assert arm.outcome(newer) == Outcome.SUCCEEDED
    arm.cycles(AFTER_CYCLES)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 1.9
    stays_inside_limits(arm, started_ns)
    arm.close()


@trials
@given(st.sampled_from(INTERRUPTED), st.floats(0.05, 1.0))
def test_starvation_brakes_while_there_is_path(name: str, share: float) -> None:
    """The front dries up after some waypoints and never says END."""
    goal = recorded_goal(name)
    arm = VirtualArm.at_start_of(name)
    started_ns = arm.now_ns
    goal_id = arm.play(name, end=False)
    waypoints = max(1, int(share * len(goal["times_ns"])))
    del arm.pending[2 + waypoints :]
    assert arm.end_of(goal_id) == Outcome.STARVED
    arm.cycles(AFTER_CYCLES)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.memory["mode"] == Mode.HOLDING
    assert largest_acceleration_ratio(arm, started_ns) <= 1.75
    stays_inside_limits(arm, started_ns)
    arm.close()


@trials
@given(moments)
def test_front_lost_stops_on_the_path(moment: tuple[str, float]) -> None:
    arm, goal_id, started_ns = moving(*moment)
    arm.front_alive = False
    arm.until(lambda: arm.outcome(goal_id) != Outcome.NONE and arm.memory["mode"] == Mode.HOLDING)
    assert arm.outcome(goal_id) in (Outcome.FRONT_LOST, Outcome.SUCCEEDED)
    arm.cycles(AFTER_CYCLES)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 1.75
    assert distance_from_path(arm, moment[0]) <= 0.02
    arm.close()


@trials
@given(moments, st.integers(13, 400))
def test_a_long_gap_ends_the_goal_where_the_drives_stopped(moment: tuple[str, float], periods: int) -> None:
    """The loop is away for longer than the drives' look-ahead: they braked by themselves, nothing jumps back."""
    arm, goal_id, started_ns = moving(*moment)
    running = arm.running_goal == goal_id
    arm.cycle(periods)
    arm.cycles(3)
    stood = [arm.sim.true_position_rad(joint, arm.sim.now_ns - 1) for joint in range(6)]
    arm.cycles(120)
    if running and periods * arm.period_ns > 100_000_000:
        assert arm.outcome(goal_id) in (Outcome.CLOCK_GAP, Outcome.SUCCEEDED)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert largest_acceleration_ratio(arm, started_ns) <= 2.2
    if periods > 120:
        for joint, config in enumerate(arm.arm.joints):
            end = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
            assert abs(end - stood[joint]) <= 2 * config.command_pulse_rad
    arm.close()


@trials
@given(moments, st.floats(0.3, 3600.0))
def test_a_suspended_machine_ends_the_goal_where_the_drives_stopped(
    moment: tuple[str, float], duration_s: float
) -> None:
    """CLOCK_MONOTONIC stands still meanwhile, so that to the loop no time has passed; the drives braked long ago."""
    arm, goal_id, started_ns = moving(*moment)
    assert arm.running_goal == goal_id
    arm.cycles(1)
    arm.suspend(duration_s)
    arm.cycles(3)
    assert arm.outcome(goal_id) == Outcome.CLOCK_GAP
    stood = [arm.sim.true_position_rad(joint, arm.sim.now_ns - 1) for joint in range(6)]
    arm.cycles(120)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.memory["mode"] == Mode.HOLDING
    for joint, config in enumerate(arm.arm.joints):
        end = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        assert abs(end - stood[joint]) <= 2 * config.command_pulse_rad
    assert largest_acceleration_ratio(arm, max(started_ns, arm.sim.now_ns - 2_000_000_000)) <= 2.2
    arm.close()


@trials
@given(moments, st.integers(2, 11))
def test_a_short_gap_neither_faults_nor_ends_the_goal(moment: tuple[str, float], periods: int) -> None:
    """The machine stalls for less than the look-ahead: the drives ran on meanwhile, which is nobody's error."""
    arm, goal_id, started_ns = moving(*moment)
    arm.cycle(periods)
    arm.end_of(goal_id)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.outcome(goal_id) == Outcome.SUCCEEDED
    arm.cycles(AFTER_CYCLES)
    assert largest_acceleration_ratio(arm, started_ns) <= 2.2
    stays_inside_limits(arm, started_ns)
    arm.close()
