"""Streams of points: smooth whatever their rate, and a stop in a straight line when they dry up."""

import numpy as np
import pytest
from commanded import CommandedArm, acceleration_ratios
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servo import Servo, Way, waves
from streamed import JudgedPoints, JudgedServo, StreamedArm
from true_motion import largest_acceleration_ratio

from shm.words import Fault, Mode, Outcome, Phase

trials = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def error_to(arm: CommandedArm, way: Way, begun_ns: int, delay_s: float, first: int) -> float:
    """Largest distance between what was commanded and the way, a delay ago, as a share of the way's size."""
    at = [way(max((t - begun_ns) * 1e-9 - delay_s, 0.0))[0] for t in arm.times[first:]]
    wanted, got = np.array(at), np.array(arm.positions[first:])
    return float((np.abs(got - wanted) / np.ptp(wanted, axis=0)).max())


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 125.0, 250.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_servo_window_is_followed_exactly_when_it_is_due(rate_hz: float, seed: int) -> None:
    """Every entry is carried out at its own stamp: Servo's own latency is all there is."""
    arm = CommandedArm()
    way = waves(arm, 0.7, seed)
    servo = Servo(arm, way, rate_hz)
    servo.run(4.0)
    assert arm.memory["fault"]["code"] == Fault.NONE and servo.sent > 3.5 * rate_hz
    planned = np.array([way(i * arm.period_ns * 1e-9)[0] for i in range(400)])
    assert arm.acceleration_ratio() <= 1.05 * np.abs(acceleration_ratios(planned, arm)).max()
    assert error_to(arm, way, servo.begun_ns, 0.1, first=100) < 0.003
    arm.close()


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize("rate_hz", [30.0, 50.0, 100.0, 250.0])
def test_single_points_are_followed_smoothly(rate_hz: float, velocities: bool) -> None:
    """Points without a stamp, to be reached at once: the arm follows softly, a little behind."""
    arm = StreamedArm()
    way = waves(arm, 0.5 if velocities else 0.05, 3)  # positions alone say "rest here" at each of them
    sender = JudgedPoints(arm, way, rate_hz, velocities=velocities)
    sender.run(4.0)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.acceleration_ratio() <= 1.06
    errors = {delay: error_to(arm, way, sender.begun_ns, delay, first=100) for delay in np.arange(0.0, 0.5, 0.01)}
    lag_s = min(errors, key=lambda delay: errors[delay])
    assert lag_s <= (0.04 if velocities else 0.1)
    assert errors[lag_s] < 0.1
    arm.close()


@trials
@given(st.integers(0, 10**6), st.sampled_from([50.0, 100.0, 250.0]), st.floats(0.6, 3.0))
def test_a_dried_up_stream_stops_in_a_straight_line(seed: int, rate_hz: float, seconds: float) -> None:
    arm = CommandedArm()
    servo = Servo(arm, waves(arm, 0.7, seed), rate_hz)
    servo.run(seconds)
    arm.cycle()  # the last message is in
    running = arm.running_goal
    last = len(arm.positions)
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=3.0)
    assert arm.outcome(running) == Outcome.RAN_DRY and arm.memory["fault"]["code"] == Fault.NONE
    assert arm.acceleration_ratio(last - 3) <= 1.6
    # where the path ended, and how fast: from there on all joints are the same share of that velocity along
    end_s, end_v = servo.entries[-2][0], servo.entries[-2][1][:, 1]
    times, positions = np.array(arm.times), np.array(arm.positions)
    after = positions[times >= end_s]
    beyond = after - servo.entries[-2][1][:, 0]
    fast = np.abs(end_v) > 0.05 * np.abs(end_v).max()
    along = beyond[:, fast] / end_v[fast]
    assert np.abs(along - along.mean(axis=1, keepdims=True)).max() < 0.03 * along.max()
    assert (np.diff(along.mean(axis=1)) >= -1e-9).all()  # never back
    arm.close()


def test_a_stream_that_ends_at_rest_is_a_goal_that_succeeds() -> None:
    arm = CommandedArm()
    rows = np.zeros((1, 6, 3))
    rows[0, :, 0] = 0.02
    goal = arm.send_goal(np.array([500_000_000]), rows, stream=True, approach=True)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.positions[-1] == pytest.approx([0.02] * 6)
    arm.close()


def test_a_late_message_is_taken_up_while_the_arm_is_stopping() -> None:
    """The stream breaks off for 0.2 s: the arm slows down and goes on, and no setpoint jumps."""
    arm = StreamedArm()
    way = waves(arm, 0.4, 5)
    servo = JudgedServo(arm, way, 100.0)
    servo.run(1.0)
    arm.cycles(22)
    assert arm.reader.snapshot()["goal_phase"] == Phase.STOPPING
    servo.begun_ns += arm.now_ns - servo.due_ns
    servo.due_ns = arm.now_ns
    servo.entries.clear()
    servo.run(1.5)
    assert arm.memory["mode"] == Mode.EXECUTING and arm.memory["fault"]["code"] == Fault.NONE
    assert arm.acceleration_ratio() <= 1.06
    assert error_to(arm, way, servo.begun_ns, 0.1, first=len(arm.positions) - 60) < 0.03
    arm.close()


def test_a_point_too_far_away_is_refused_and_the_stream_before_it_goes_on() -> None:
    arm = CommandedArm()
    servo = Servo(arm, waves(arm, 0.4, 6), 100.0)
    servo.run(1.0)
    running = arm.running_goal
    rows = np.zeros((1, 6, 3))
    rows[0, :, 0] = arm.positions[-1] + 0.3
    far = arm.send_goal(np.array([10_000_000]), rows, order=3, stream=True, approach=True)
    arm.cycles(2)
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=3.0)
    assert arm.outcome(far) in (Outcome.REFUSED_LIMITS, Outcome.REFUSED_START)
    assert arm.outcome(running) in (Outcome.RAN_DRY, Outcome.REPLACED)
    assert arm.acceleration_ratio() <= 1.6 and arm.memory["fault"]["code"] == Fault.NONE
    arm.close()


@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 10**6), st.floats(0.6, 2.5))
def test_the_drives_truly_move_like_that(seed: int, seconds: float) -> None:
    """The same on the simulated drives' true motion, until they stand."""
    arm = CommandedArm("episode1", start_rad=[0.3, 0.2, -0.1, 1.0, 0.5, 2.0])
    begun_ns = arm.now_ns
    servo = Servo(arm, waves(arm, 0.6, seed), 100.0)
    servo.run(seconds)
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=3.0)
    arm.cycles(40)
    assert arm.memory["fault"]["code"] == Fault.NONE
    assert arm.sim is not None
    assert largest_acceleration_ratio(arm, begun_ns) <= 2.0
    for joint, config in enumerate(arm.arm.joints):
        end = arm.sim.true_position_rad(joint, arm.sim.now_ns - 1)
        assert abs(end - arm.positions[-1][joint]) <= config.slack_rad
    arm.close()


# --- people against streams -----------------------------------------------------------------------------


def test_a_hold_stops_a_stream_and_what_comes_meanwhile_is_refused() -> None:
    arm = CommandedArm()
    servo = Servo(arm, waves(arm, 0.5, 7), 100.0)
    servo.run(1.0)
    arm.writer.hold()
    servo.run(1.0)
    assert arm.memory["operator"]["held"] == 1 and not arm.loop[0]["axes"]["commanded"]["velocity_rad_s"].any()
    stood = arm.positions[-1]
    servo.run(0.5)
    assert (arm.positions[-1] == stood).all()
    assert arm.outcome(servo.sent - 1) == Outcome.REFUSED_HELD
    assert arm.acceleration_ratio() <= 1.9
    arm.close()


@pytest.mark.parametrize("dry_cycles", [0, 14])
def test_a_stop_ends_a_stream_even_while_it_runs_dry(dry_cycles: int) -> None:
    arm = CommandedArm()
    servo = Servo(arm, waves(arm, 0.6, 8), 100.0)
    servo.run(1.2)
    arm.cycles(dry_cycles)
    running = arm.running_goal
    arm.writer.stop()
    arm.cycle()
    servo.due_ns = arm.now_ns
    servo.run(0.1)  # its messages wait until the arm stands
    assert arm.memory["mode"] in (Mode.STOPPING, Mode.HOLDING) and arm.running_goal in (running, 0)
    assert arm.end_of(running) == Outcome.STOPPED
    assert arm.acceleration_ratio() <= 1.9
    arm.close()


@pytest.mark.parametrize("scale", [0.05, 0.5])
def test_a_speed_scale_leaves_a_stream_its_own_time(scale: float) -> None:
    """A stream says where to be when; only a factor of 0 stops it."""
    arm = CommandedArm()
    arm.writer.scale(scale)
    way = waves(arm, 0.5, 9)
    servo = Servo(arm, way, 100.0)
    servo.run(3.0)
    assert error_to(arm, way, servo.begun_ns, 0.1, first=100) < 0.003
    arm.writer.scale(0.0)
    servo.run(1.0)
    assert not arm.loop[0]["axes"]["commanded"]["velocity_rad_s"].any() and arm.memory["fault"]["code"] == Fault.NONE
    arm.close()


def test_a_last_point_at_rest_with_an_acceleration_is_the_end() -> None:
    """Nothing is added to a stream that says it ends: the arm stands at its last point."""
    arm = CommandedArm()
    rows = np.zeros((2, 6, 3))
    rows[1, :, 0] = 0.01
    rows[1, :, 2] = -1.0
    goal = arm.send_goal(np.array([0, 400_000_000]), rows, order=5, stream=True)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert np.array(arm.positions).max() <= 0.0105 and arm.positions[-1] == pytest.approx([0.01] * 6)
    arm.close()


def test_a_stream_for_one_joint_stops_the_others_inside_their_limits() -> None:
    """joint5 is on its way to a stop just before its limit when a message for joint1 alone takes over."""
    arm = CommandedArm()
    upper = arm.arm.joints[4].upper_rad
    times = np.array([0, 700_000_000, 1_000_000_000])
    joints = np.zeros((3, 6, 3))
    joints[:, 4, 0] = [0.0, upper - 0.3, upper - 0.002]
    joints[:, 4, 1] = [0.0, 2.4, 0.0]
    first = arm.send_goal(times, joints, order=3)
    arm.cycles(80)
    alone = np.zeros((1, 6, 3))
    alone[0, 0] = [0.0, 0.05, 0.0]
    arm.send_goal(np.array([10_000_000]), alone, order=3, stream=True, approach=True, joint_mask=1)
    arm.until(lambda: arm.memory["mode"] == Mode.HOLDING, at_most_s=5.0)
    assert arm.memory["fault"]["code"] == Fault.NONE and arm.outcome(first) != Outcome.FAULT
    assert np.array(arm.positions)[:, 4].max() <= upper + 1e-3
    arm.close()
