"""How goals begin and end in the loop: outcomes, tolerances, subsets, start times, modes."""

import numpy as np
import pytest
from virtual import START_NS, VirtualArm

from config.loader import load_arm
from shm import layout
from shm.recording import newest_events
from shm.words import Event, Fault, Mode, Outcome, Phase


def straight(arm: VirtualArm, target_rad: list[float], seconds: float, **options: object) -> int:
    """A goal of one point, reached from wherever the arm is commanded."""
    joints = np.zeros((1, len(arm.arm.joints), 3))
    joints[0, :, 0] = target_rad
    return arm.send_goal(np.array([int(seconds * 1e9)]), joints, approach=True, **options)


@pytest.mark.parametrize("arm_name", ["episode1", "mock"])
def test_one_point_is_reached_from_where_the_arm_stands(virtual_arm, arm_name: str) -> None:
    arm = virtual_arm(arm_name)
    target = [0.1, -0.05, 0.1, 0.2, -0.2, 0.3]
    goal = straight(arm, target, 2.0)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.loop[0]["axes"]["commanded"]["position_rad"][:6] == pytest.approx(target)


def test_no_motion_frame_before_the_first_goal(virtual_arm) -> None:
    """init_mode 1: not one count of motion until somebody asks for it."""
    arm = virtual_arm(start_rad=[0.3, 0.2, -0.1, 1.0, 0.5, 2.0])
    arm.cycles(240)
    for joint in range(6):
        assert arm.sim.true_position_rad(joint, arm.now_ns - 1) == arm.sim.true_position_rad(joint, START_NS)
        assert len(arm.sim.truth_changes(joint)) == 2  # the beginning and now
    assert not any(b"FD" in data for _, data in arm.sent)


def test_the_commanded_position_is_the_drives_own_target(virtual_arm) -> None:
    arm = virtual_arm(start_rad=[0.3, 0.2, -0.1, 1.0, 0.5, 2.0])
    for joint, drive in enumerate(arm.sim.drives):
        config = arm.arm.joints[joint]
        target = config.direction * drive.target_counts / config.encoder_counts_per_rad - config.zero_rad
        assert arm.loop[0]["axes"][joint]["commanded"]["position_rad"] == pytest.approx(target, abs=1e-12)


def test_a_start_in_the_future_waits_at_rest(virtual_arm) -> None:
    arm = virtual_arm("mock")
    due_ns = arm.now_ns + 1_500_000_000
    goal = straight(arm, [0.1] * 6, 1.0, start_ns=due_ns)
    while arm.now_ns + 2 * arm.period_ns < due_ns:
        arm.cycle()
        assert not np.any(arm.loop[0]["axes"]["commanded"]["next_position_rad"])
    assert arm.reader.snapshot()["goal_phase"] == Phase.WAITING
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.now_ns >= due_ns + 1_000_000_000


def test_joints_outside_the_goal_hold(virtual_arm) -> None:
    arm = virtual_arm("mock")
    joints = np.full((1, 6, 3), np.nan)
    joints[0, 2] = [0.2, 0.0, 0.0]
    goal = arm.send_goal(np.array([1_000_000_000]), joints, approach=True, joint_mask=0b100)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.loop[0]["axes"]["commanded"]["position_rad"][:6] == pytest.approx([0, 0, 0.2, 0, 0, 0])


def test_joints_left_out_of_a_replacement_come_to_rest(virtual_arm) -> None:
    arm = virtual_arm("mock")
    first = straight(arm, [0.4] * 6, 2.0)
    arm.cycles(100)
    joints = np.zeros((1, 6, 3))
    joints[0, 0, 0] = 0.1
    second = arm.send_goal(np.array([2_000_000_000]), joints, approach=True, joint_mask=1)
    assert arm.end_of(second) == Outcome.SUCCEEDED
    assert arm.outcome(first) == Outcome.REPLACED
    axes = arm.loop[0]["axes"][:6]
    assert axes["commanded"]["position_rad"][0] == pytest.approx(0.1)
    assert np.all(axes["commanded"]["position_rad"][1:] > 0.1)
    assert np.all(axes["commanded"]["position_rad"][1:] < 0.45)
    assert not np.any(axes["commanded"]["velocity_rad_s"])


def test_a_first_point_too_far_away_is_refused_by_name(virtual_arm) -> None:
    arm = virtual_arm("mock")
    joints = np.zeros((2, 6, 3))
    joints[:, 3, 0] = 0.2
    goal = arm.send_goal(np.array([0, 10**9]), joints)
    assert arm.end_of(goal) == Outcome.REFUSED_START
    result = arm.result(goal)
    assert (result["joint"], result["value"], result["limit"]) == (3, pytest.approx(0.2), pytest.approx(0.05))
    assert arm.memory["mode"] == Mode.HOLDING


def test_a_bad_newer_goal_leaves_the_running_one_alone(virtual_arm) -> None:
    arm = virtual_arm("mock")
    first = straight(arm, [0.2] * 6, 1.0)
    arm.cycles(20)
    joints = np.zeros((2, 6, 3))
    joints[:, 3, 0] = 1.0
    second = arm.send_goal(np.array([0, 10**9]), joints)
    assert arm.end_of(second) == Outcome.REFUSED_START
    assert arm.end_of(first) == Outcome.SUCCEEDED


def test_a_refused_newer_goal_leaves_a_running_stream_alone(virtual_arm) -> None:
    """The running goal's later waypoints still come through the ring while the newer one is looked at."""
    arm = virtual_arm("mock")
    times = np.arange(60) * 100_000_000
    joints = np.zeros((60, 6, 3))
    joints[:, 0, 0] = 0.2 * (1 - np.cos(np.linspace(0, np.pi, 60)))
    joints[:, 0, 1] = 0.2 * np.sin(np.linspace(0, np.pi, 60)) * np.pi / 5.9
    first = arm.send_goal(times, joints, order=3)
    late = arm.pending[32:]
    del arm.pending[32:]
    arm.cycles(60)
    far = np.zeros((2, 6, 3))
    far[:, 3, 0] = 1.0
    second = arm.send_goal(np.array([0, 10**9]), far)
    arm.cycles(3)
    arm.pending += late
    assert arm.end_of(second) == Outcome.REFUSED_START
    assert arm.end_of(first) == Outcome.SUCCEEDED


def test_path_tolerance_is_judged_on_measured_positions(virtual_arm) -> None:
    """A held shaft: the goal ends with the joint and the amount, and the arm stops."""
    from sim.faults import Stall

    arm = virtual_arm(goal="scale_1_0")
    goal = arm.play("scale_1_0", tolerances=(0.02, 0.0, 0.0))
    arm.sim.inject(Stall(joint="joint2", at_s=0.3), since_ns=arm.now_ns)
    assert arm.end_of(goal) == Outcome.PATH_TOLERANCE
    result = arm.result(goal)
    assert result["joint"] == 1
    assert abs(result["value"]) > 0.02
    assert result["limit"] == pytest.approx(0.02)


def test_goal_tolerance_not_reached_in_time(virtual_arm) -> None:
    from sim.faults import Stall

    arm = virtual_arm()
    goal = straight(arm, [0.0, 0.0, 0.03, 0.0, 0.0, 0.0], 1.0, goal_time_s=0.3)
    arm.sim.inject(Stall(joint="joint3", at_s=0.0), since_ns=arm.now_ns)
    assert arm.end_of(goal) == Outcome.GOAL_TOLERANCE
    assert arm.result(goal)["joint"] == 2


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), float("inf")])
def test_a_speed_scale_out_of_range_is_passed_over(virtual_arm, value: float) -> None:
    arm = virtual_arm("mock")
    arm.scale(0.5)
    arm.scale(value)
    assert arm.memory["operator"]["speed_scale"] == 0.5


def test_a_canceled_waiting_goal_never_moves(virtual_arm) -> None:
    arm = virtual_arm("mock")
    goal = straight(arm, [0.1] * 6, 1.0, start_ns=arm.now_ns + 10**9)
    arm.cycles(10)
    arm.writer.cancel(goal)
    assert arm.end_of(goal) == Outcome.CANCELED
    arm.cycles(150)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["position_rad"])


def test_a_stop_by_a_person_ends_the_goal(virtual_arm) -> None:
    arm = virtual_arm("mock")
    goal = straight(arm, [0.4] * 6, 2.0)
    arm.cycles(60)
    arm.writer.stop()
    assert arm.end_of(goal) == Outcome.STOPPED
    assert arm.memory["mode"] == Mode.HOLDING


def test_a_shutdown_stops_the_arm_first(virtual_arm) -> None:
    arm = virtual_arm("mock")
    goal = straight(arm, [0.4] * 6, 2.0)
    arm.cycles(60)
    arm.memory["motion"]["closing"] = 1
    assert arm.end_of(goal) == Outcome.SHUTDOWN
    arm.until(lambda: arm.running_goal == 0)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["velocity_rad_s"])


def test_a_goal_of_more_waypoints_than_the_window_runs_to_its_end(virtual_arm) -> None:
    """The window turns round: a long goal of close points runs to its end through the ring."""
    arm = virtual_arm("mock")
    count = 6000
    times = np.arange(count) * 1_000_000
    joints = np.zeros((count, 6, 3))
    phase = np.linspace(0, np.pi, count)
    joints[:, :, 0] = (0.1 * (1 - np.cos(phase)))[:, None]
    joints[:, :, 1] = (0.1 * np.sin(phase) * np.pi / (times[-1] * 1e-9))[:, None]
    goal = arm.send_goal(times, joints, order=3)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    assert arm.loop[0]["axes"]["commanded"]["position_rad"][:6] == pytest.approx([0.2] * 6, abs=1e-6)
    assert arm.memory["fault"]["code"] == Fault.NONE


def mock_arm_with(lower_deg: float, upper_deg: float, joint: int = 2):
    arm = load_arm("mock")
    joints = list(arm.joints)
    joints[joint] = joints[joint].model_copy(update={"lower_deg": lower_deg, "upper_deg": upper_deg})
    return arm.model_copy(update={"joints": joints})


@pytest.mark.parametrize(("lower", "upper", "sign"), [(20.0, 80.0, 1.0), (-80.0, -20.0, -1.0)])
def test_limits_that_do_not_straddle_zero_are_kept(virtual_arm, lower: float, upper: float, sign: float) -> None:
    """A cubic between legal waypoints that dips beyond the limit: the last defence stops it at the limit."""
    arm = virtual_arm(mock_arm_with(lower, upper))
    config = arm.arm.joints[2]
    near = config.lower_rad if sign > 0 else config.upper_rad
    joints = np.zeros((2, 6, 3))
    joints[:, 2, 0] = near
    joints[0, 2, 1], joints[1, 2, 1] = -sign * 0.4, sign * 0.4
    goal = arm.send_goal(np.array([0, 1_500_000_000]), joints, order=3)
    for _ in range(300):
        arm.cycle()
        assert (
            config.lower_rad - 0.01
            <= arm.loop[0]["axes"][2]["commanded"]["next_position_rad"]
            <= config.upper_rad + 0.01
        )
    assert arm.outcome(goal) in (Outcome.FAULT, Outcome.REFUSED_LIMITS)


def test_a_joint_found_just_outside_its_limit_may_move_in(virtual_arm) -> None:
    outside = load_arm("episode1").joints[2].lower_rad - 0.01
    arm = virtual_arm(start_rad=[0.0, 0.0, outside, 0.0, 0.0, 0.0])
    assert arm.loop[0]["axes"][2]["reference"]["referenced"] == 1
    goal = straight(arm, [0.0, 0.0, outside + 0.2, 0.0, 0.0, 0.0], 2.0)
    assert arm.end_of(goal) == Outcome.SUCCEEDED
    goal = straight(arm, [0.1, 0.0, outside + 0.2, 0.0, 0.0, 0.0], 2.0)
    assert arm.end_of(goal) == Outcome.SUCCEEDED


def test_nothing_moves_at_speed_scale_zero(virtual_arm) -> None:
    arm = virtual_arm("mock")
    arm.writer.scale(0.0)
    arm.cycle()
    goal = straight(arm, [0.1] * 6, 1.0)
    arm.cycles(200)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["next_position_rad"])
    arm.writer.scale(1.0)
    assert arm.end_of(goal) == Outcome.SUCCEEDED


def test_a_raised_speed_scale_speeds_up_a_goal_of_one_point(virtual_arm) -> None:
    arm = virtual_arm("mock")
    arm.writer.scale(0.1)
    arm.cycle()
    goal = straight(arm, [0.1] * 6, 1.0)
    arm.cycles(50)
    arm.writer.scale(1.0)
    assert arm.end_of(goal, at_most_s=3.0) == Outcome.SUCCEEDED


def test_goal_ids_are_never_taken_twice(virtual_arm) -> None:
    arm = virtual_arm("mock")
    first = straight(arm, [0.1] * 6, 0.8)
    assert arm.end_of(first) == Outcome.SUCCEEDED
    taken = int(arm.state.record["counters"]["knots_taken"])
    straight(arm, [0.3] * 6, 0.8, goal_id=first)
    arm.cycles(60)
    assert int(arm.state.record["counters"]["knots_taken"]) == taken
    assert arm.memory["mode"] == Mode.HOLDING


def test_the_same_inputs_give_the_same_bytes() -> None:
    """The cycle is a function of its inputs."""
    streams = []
    for _ in range(2):
        arm = VirtualArm.at_start_of("small", seed=5)
        arm.end_of(arm.play("small"))
        streams.append(arm.sent)
        arm.close()
    assert streams[0] == streams[1]


def test_a_cancel_that_overtakes_its_goal_keeps_it_from_starting(virtual_arm) -> None:
    """Requests are taken before setpoints, so both may come in one cycle, the cancel first."""
    arm = virtual_arm("mock")
    arm.writer.cancel(1)
    goal = straight(arm, [0.1] * 6, 1.0)
    assert arm.end_of(goal) == Outcome.CANCELED
    arm.cycles(20)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["position_rad"][:6])
    assert arm.end_of(straight(arm, [0.1] * 6, 1.0)) == Outcome.SUCCEEDED


@pytest.mark.parametrize("seen", [0, 5])
def test_cancels_that_overtake_their_goals_keep_all_of_them_from_starting(virtual_arm, seen: int) -> None:
    """Several at once, as when a front closes: not one starts, whichever is taken first."""
    arm = virtual_arm("mock")
    for _ in range(seen):
        arm.end_of(straight(arm, [0.0] * 6, 0.1))
    goals = range(seen + 1, seen + 5)
    for goal in goals:
        arm.writer.cancel(goal)
    arm.cycle()
    for goal in goals:
        assert straight(arm, [0.1] * 6, 1.0) == goal
        arm.cycles(3)
        assert arm.outcome(goal) == Outcome.CANCELED
    arm.cycles(20)
    assert not np.any(arm.loop[0]["axes"]["commanded"]["position_rad"][:6])
    assert arm.end_of(straight(arm, [0.1] * 6, 1.0)) == Outcome.SUCCEEDED


def test_a_result_stands_until_as_many_newer_ones_as_there_are_rows(virtual_arm) -> None:
    """Also that of a goal that ends after many newer ones, which were refused while it stopped."""
    arm = virtual_arm("mock")
    first = newest = arm.send_shift(0.3)
    arm.cycles(100)
    arm.writer.stop()
    while arm.outcome(first) == Outcome.NONE:
        newest = arm.send_shift(0.1)
        arm.cycle()
        assert arm.outcome(newest) == Outcome.REFUSED_HELD
    assert newest > first + layout.RESULT_SLOTS
    for _ in range(layout.RESULT_SLOTS - 2):
        newest = arm.send_shift(0.1)
        arm.cycle()
        assert arm.outcome(first) == Outcome.STOPPED and arm.outcome(newest) == Outcome.REFUSED_HELD
    for _ in range(2):
        arm.send_shift(0.1)
        arm.cycle()
    assert arm.outcome(first) == Outcome.NONE


def test_what_a_goal_was_told_before_it_stands_is_not_told_again(virtual_arm) -> None:
    """Also where so many newer ones were refused meanwhile that its row is taken."""
    arm = virtual_arm("mock")
    first = arm.send_shift(0.3)
    arm.cycles(100)
    arm.memory["motion"]["closing"] = 1
    arm.cycles(2)
    assert arm.outcome(first) == Outcome.SHUTDOWN and arm.running_goal == first
    while arm.running_goal == first:
        arm.send_shift(0.1)
        arm.cycle()
    assert arm.outcome(first) == Outcome.NONE
    told = list(newest_events(arm.state.array[0], layout.EVENT_SLOTS)["kind"])
    assert told.count(Event.RESULT) == told.count(Event.GOAL) > layout.RESULT_SLOTS
