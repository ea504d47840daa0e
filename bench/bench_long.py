"""What does not grow: goal after goal, one goal of very many points, and a million waypoints through the ring."""

import math
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from control_msgs.action import FollowJointTrajectory
from live import NAMES, NS, LiveStack, Usage, commanded_rad, goal_to, in_words, live, percentiles, point
from rclpy.qos import QoSProfile
from ros_client import CANCELED, SUCCEEDED, until
from sensor_msgs.msg import JointState

from config.loader import arm_hash, load_arm
from shm.client import CommandWriter
from shm.errors import RingFull
from shm.files import own_command
from shm.words import Entry, Mode, Outcome

GOALS, WARM_GOALS = 1000, 200
GOAL_S = 0.05
POINTS, SPACING_S = 100_000, 0.001
WAYPOINTS, WAYPOINT_NS = 1_000_000, 100_000
FIRST, FIRST_WAYPOINT_NS = 4096, 250_000
"""The first ones are wider apart: a goal is entered once 2048 of them are there, and begins with 0.3 s of them."""


def move(stack: LiveStack, home: np.ndarray, count: int) -> None:
    """Goals to and fro, each with its result before the next."""
    for turn in range(count):
        target = home - (0.0 if turn % 2 else 0.0005)
        status, _, words = stack.client.run(goal_to(target, GOAL_S))
        assert status == SUCCEEDED, words


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(400)
def test_a_thousand_goals_in_a_row(benchmark, report, tmp_path):
    def measure():
        with live(tmp_path) as stack:
            home, used = commanded_rad(stack), []
            for count in (0, WARM_GOALS, GOALS - WARM_GOALS):
                move(stack, home, count)
                used.append([Usage(process) for process in (stack.front, stack.loop)])
            return used

    used = benchmark.pedantic(measure, rounds=1)
    for who, before, warm, after in zip(("front", "control process"), *used, strict=True):
        figures = {
            what: [getattr(usage, what) for usage in (before, warm, after)]
            for what in ("resident_kb", "threads", "files")
        }
        benchmark.extra_info[who] = figures
        memory, *counts = (" → ".join(map(str, values)) for values in figures.values())
        report(
            f"{who}, 0 → {WARM_GOALS} → {GOALS} goals",
            f"{memory} kB resident; threads {counts[0]}; files {counts[1]}",
        )


def long_goal(home: np.ndarray, points: int):
    """A gentle wave of so many points."""
    t = np.arange(points) * SPACING_S
    omega = 2 * math.pi / (t[-1] / 10)
    shape, speed = 0.02 * (1 - np.cos(omega * t)), 0.02 * omega * np.sin(omega * t)
    speed[-1] = 0.0
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    goal.trajectory.points = [
        point(at, (home - way).tolist(), [-v] * 6) for at, way, v in zip(t, shape, speed.tolist(), strict=True)
    ]
    return goal


@pytest.mark.benchmark(group="live")
def test_a_goal_of_a_hundred_thousand_points(benchmark, report, tmp_path):
    def measure():
        with live(tmp_path) as stack:
            client, heard = stack.client, []
            client.node.create_subscription(
                JointState,
                "joint_states",
                lambda data, info: heard.append(info["received_timestamp"]),
                QoSProfile(depth=2000),
                raw=True,
            )
            goal = long_goal(commanded_rad(stack), POINTS)
            until(lambda: heard, "a joint state")
            before, first = Usage(stack.front), len(heard)
            answers: list[int] = []
            sent_ns = time.monotonic_ns()
            future = client.action.send_goal_async(goal)
            future.add_done_callback(lambda _: answers.append(time.monotonic_ns()))
            until(lambda: stack.reader.snapshot()["mode"] == Mode.EXECUTING, "motion", 60.0)
            snapshot = stack.reader.snapshot()
            moving_ns = snapshot["monotonic_ns"] - int(snapshot["trajectory_clock_ns"])
            until(lambda: stack.reader.snapshot()["trajectory_clock_ns"] > 3 * NS, "three seconds of it", 10.0)
            gaps_ms = np.diff(heard[first:]) / 1e6
            during = Usage(stack.front)
            handle = future.result()
            result = handle.get_result_async()
            handle.cancel_goal_async()
            until(result.done, "the result")
            assert result.result().status == CANCELED
            return before, during, (answers[0] - sent_ns) / NS, (moving_ns - sent_ns) / NS, gaps_ms

    before, during, accepted_s, moving_s, gaps_ms = benchmark.pedantic(measure, rounds=1)
    gaps = percentiles(gaps_ms, 50, 99)
    busy_s = during.processor_s - before.processor_s
    benchmark.extra_info.update(
        accepted_s=accepted_s,
        moving_s=moving_s,
        front_processor_s=busy_s,
        resident_before_kb=before.resident_kb,
        peak_kb=during.peak_kb,
        resident_kb=during.resident_kb,
        joint_states_interval_ms=gaps,
    )
    report(f"goal of {POINTS:,} points: sent → accepted, → moving", f"{accepted_s:.2f} s, {moving_s:.2f} s")
    report("  front: processor time until 3 s into it", f"{busy_s:.2f} s")
    report(
        "  front: resident before, peak, 3 s into it",
        f"{before.resident_kb}, {during.peak_kb}, {during.resident_kb} kB",
    )
    report("  front: /joint_states arrivals meanwhile", f"{in_words(gaps)} ms")


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(240)
def test_a_million_waypoints_through_the_ring(benchmark, report, tmp_path):
    def measure():
        with live(tmp_path, mock_hz=120.0, front=False) as stack:
            writer = CommandWriter(own_command(stack.name, arm_hash(load_arm(stack.arm_file))))
            try:
                before = Usage(stack.loop)
                seconds = stream_waypoints(stack, writer)
                return before, Usage(stack.loop), seconds, stack.reader.memory.record["counters"].copy()
            finally:
                writer.close()

    before, after, seconds, counters = benchmark.pedantic(measure, rounds=1)
    assert counters["knots_taken"] == WAYPOINTS
    share = 100 * (after.processor_s - before.processor_s) / seconds
    benchmark.extra_info.update(
        seconds=seconds,
        resident_before_kb=before.resident_kb,
        resident_after_kb=after.resident_kb,
        core_percent=share,
        overruns=int(counters["overruns"]),
    )
    report(
        f"{WAYPOINTS:,} waypoints through the ring, {seconds:.0f} s: control process",
        f"{before.resident_kb} → {after.resident_kb} kB resident; {share:.1f} % of a core; "
        f"threads {before.threads} → {after.threads}; files {before.files} → {after.files}",
    )


def stream_waypoints(stack: LiveStack, writer: CommandWriter) -> float:
    """One goal of WAYPOINTS points, written as fast as the control process takes them; seconds until success."""
    home = commanded_rad(stack)
    joints = np.zeros((6, 3))
    times_ns = np.cumsum([0] + [FIRST_WAYPOINT_NS] * FIRST + [WAYPOINT_NS] * (WAYPOINTS - FIRST - 1))
    times_s = times_ns / NS
    omega = 2 * math.pi * max(1, round(times_s[-1] / 6.0)) / times_s[-1]  # ends at rest
    off = np.zeros((6, 3))
    goal, begun = 1, time.monotonic()
    consumed = stack.reader.setpoints_consumed
    writer.beat()
    writer.announce(goal)
    writer.begin(
        goal,
        start_ns=0,
        joint_mask=63,
        goal_time_s=0.0,
        entry=Entry(0),
        epoch=stack.reader.snapshot()["epoch"],
        tolerances=off,
        consumed=consumed(),
    )

    def patiently(write) -> None:
        while True:
            writer.beat()
            try:
                return write()
            except RingFull:
                time.sleep(0.004)

    for number, (at_ns, at_s) in enumerate(zip(times_ns.tolist(), times_s.tolist(), strict=True)):
        phase = omega * at_s
        joints[:, 0] = home + 0.05 * (1 - math.cos(phase))
        joints[:, 1] = 0.05 * omega * math.sin(phase) if number < WAYPOINTS - 1 else 0.0
        patiently(lambda at_ns=at_ns: writer.waypoint(goal, at_ns, 3, joints, consumed()))
    patiently(lambda: writer.end(goal, off, consumed()))
    while True:
        writer.beat()
        result = stack.reader.snapshot().find("results", "goal_id", goal)
        if result is not None:
            assert result["outcome"] == Outcome.SUCCEEDED, result
            return time.monotonic() - begun
        time.sleep(0.02)
