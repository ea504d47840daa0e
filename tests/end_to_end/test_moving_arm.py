"""A real action client, the front, shared memory, the compiled cycle, SLCAN bytes, simulated drives, and back."""

import json
import math
import os
import signal
import time

import numpy as np
import pytest
from stack import run_rtarm

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

import itertools

from observer import judge, motion_violations
from ros_client import ABORTED, SUCCEEDED, Client, recorded
from waiting import until

from config.loader import load_arm

pytestmark = pytest.mark.process

TOURS = (
    ("small", "single_joint", "large", "large_back", "scale_1_0"),
    ("near_limits_high", "near_limits_low", "joint2_end"),
    ("scale_0_5",),
    ("scale_0_1",),
    ("around_box",),
    ("cartesian", "cartesian_slow"),
)
"""All recorded goals: in each row, each begins where the last one ended, up to 1e-4 rad."""
SMOKE_TOUR = ("around_box",)


@pytest.fixture
def stack(served_at, request):
    tour = getattr(request, "param", TOURS[0])
    stack = served_at(recorded(tour[0]).trajectory.points[0].positions)
    stack.tour = tour
    return stack


def status(stack):
    return json.loads(run_rtarm("status", stack.name, "--json").stdout)


def play(client, *names):
    for name in names:
        state, _, words = client.run(recorded(name))
        assert state == SUCCEEDED, words


def newest_position(client):
    client.states.clear()
    until(lambda: client.states, "a joint state")
    return np.array(client.states[-1][1].position)


def moving(client, joint, from_rad, by_rad=0.05):
    until(lambda: abs(newest_position(client)[joint] - from_rad) > by_rad, "motion")


@pytest.mark.parametrize(
    "stack",
    [pytest.param(tour, id=tour[0], marks=[pytest.mark.smoke] if tour == SMOKE_TOUR else []) for tour in TOURS],
    indirect=True,
)
def test_recorded_goals_arrive_to_the_pulse(stack):
    """Every joint ends within one command pulse plus one encoder count; /joint_states tells of each cycle."""
    client, joints = stack.client, load_arm(stack.arm_file).joints
    for name in stack.tour:
        goal = recorded(name)
        state, code, words = client.run(goal)
        assert (state, code) == (SUCCEEDED, 0), words
        wanted = np.array(goal.trajectory.points[-1].positions)
        allowed = np.array([joint.slack_rad for joint in joints])
        until(
            lambda w=wanted, a=allowed: np.all(np.abs(newest_position(client) - w) <= a),
            "the last pulse",
            1.0,
        )

    client.states.clear()
    until(lambda: len(client.states) >= 300, "300 joint states", 20.0)
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in client.states]
    # By the times of measurement; a busy machine leaves out single ones.
    assert np.median(np.diff(stamps)) == pytest.approx(1e9 / 120.0, rel=0.01)
    assert status(stack)["mode"] == "holding"

    truth = stack.truth()
    goal = recorded(stack.tour[-1])
    for joint, wanted in zip(joints, goal.trajectory.points[-1].positions, strict=True):
        ends = truth[joint.name].position_at(np.array([time.monotonic_ns()]))
        assert abs(ends[0] - wanted) <= joint.slack_rad


@pytest.mark.smoke
def test_kill_9_of_the_front_stops_on_the_path_and_a_new_front_serves(stack):
    client = stack.client
    began_ns = time.monotonic_ns()
    goal = recorded("large")
    play(client, "small", "single_joint")
    start = newest_position(client)
    client.send(goal)
    moving(client, 0, start[0], 0.3)
    stack.front.process.kill()
    until(lambda: status(stack)["mode"] == "holding", "holding", 5.0)
    truth = stack.truth()
    arm = load_arm(stack.arm_file)
    now_ns = time.monotonic_ns()
    for joint in arm.joints:
        assert truth[joint.name].velocity_at(np.array([now_ns]))[0] == 0.0
    positions = np.array([truth[j.name].position_at(np.array([now_ns]))[0] for j in arm.joints])
    away_rad = distance_from(goal, positions)
    judge([f"stands {away_rad:.4f} rad away from its path"] if away_rad > 0.02 else [])
    judge(motion_violations(arm, truth, began_ns, now_ns))

    stack.start_front()
    client.close()
    stack.client = client = Client(f"controller_{stack.name}")
    here = newest_position(client)
    again = recorded("large")
    again.trajectory.points = [again.trajectory.points[0]]
    again.trajectory.points[0].positions = list(here + 0.05)
    again.trajectory.points[0].velocities = [0.0] * 6
    again.trajectory.points[0].accelerations = []
    again.trajectory.points[0].time_from_start.sec = 2
    state, _, words = client.run(again)
    assert state == SUCCEEDED, words


def distance_from(goal, positions):
    points = np.array([point.positions for point in goal.trajectory.points])
    best = math.inf
    for a, b in itertools.pairwise(points):
        for share in np.linspace(0.0, 1.0, 20):
            best = min(best, float(np.abs(a + share * (b - a) - positions).max()))
    return best


@pytest.mark.smoke
def test_kill_9_of_the_loop_ends_the_goal_and_the_drives_brake_by_themselves(stack):
    client = stack.client
    began_ns = time.monotonic_ns()
    play(client, "small", "single_joint")
    start = newest_position(client)
    handle = client.send(recorded("large"))
    moving(client, 0, start[0], 0.3)
    killed_ns = time.monotonic_ns()
    stack.loop.process.kill()
    state, _, words = client.result(handle)
    assert time.monotonic_ns() - killed_ns < 500_000_000
    assert state == ABORTED
    assert "ended" in words
    client.states.clear()
    until(lambda: ended_coasting(stack), "standing drives", 5.0)
    assert client.states == []

    arm, truth = load_arm(stack.arm_file), stack.truth()
    judge(motion_violations(arm, truth, began_ns, time.monotonic_ns()))

    stood = [truth[joint.name].position_at(np.array([time.monotonic_ns()]))[0] for joint in arm.joints]
    stack.start_loop()
    until(lambda: client.states, "joint states of the new loop")
    assert newest_position(client) == pytest.approx(stood, abs=2e-3)
    report = status(stack)
    assert all(joint["referenced"] for joint in report["joints"])
    truth = stack.truth()
    for joint, position in zip(arm.joints, stood, strict=True):
        assert truth[joint.name].position_at(np.array([time.monotonic_ns()]))[0] == pytest.approx(position, abs=1e-9)


def ended_coasting(stack):
    truth, now_ns = stack.truth(), np.array([time.monotonic_ns()])
    return all(joint.velocity_at(now_ns)[0] == 0.0 for joint in truth.values())


def test_a_frozen_loop_is_a_hung_one(stack):
    """SIGSTOP: the goal aborts with a sentence, the drives brake; after SIGCONT the arm holds where it is."""
    client = stack.client
    began_ns = time.monotonic_ns()
    play(client, "small", "single_joint")
    start = newest_position(client)
    handle = client.send(recorded("large"))
    moving(client, 0, start[0], 0.3)
    os.kill(stack.loop.process.pid, signal.SIGSTOP)
    state, _, words = client.result(handle)
    assert state == ABORTED, words
    until(lambda: ended_coasting(stack), "standing drives", 5.0)
    truth = stack.truth()
    arm = load_arm(stack.arm_file)
    stood = [truth[joint.name].position_at(np.array([time.monotonic_ns()]))[0] for joint in arm.joints]
    os.kill(stack.loop.process.pid, signal.SIGCONT)
    until(lambda: status(stack)["mode"] == "holding", "holding", 5.0)
    assert newest_position(client) == pytest.approx(stood, abs=3e-3)
    judge(motion_violations(arm, stack.truth(), began_ns, time.monotonic_ns()))


def test_an_orderly_end_stops_the_arm_first(stack):
    client = stack.client
    start = newest_position(client)
    handle = client.send(recorded("scale_1_0"))
    moving(client, 0, start[0], 0.1)
    stack.loop.process.terminate()
    state, _, words = client.result(handle)
    assert state == ABORTED, words
    assert stack.loop.code() == 0
    assert ended_coasting(stack)
