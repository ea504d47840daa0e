"""What goals of very many points do to the ROS process that is given them while another goal moves the arm.

In turns with a ROS process that takes them as rclpy does. A mock arm at 120 Hz; the front, a prober
(`big_goal_prober`) and the sender, which is this process, are processes of their own. The goal is judged to its last
point, which is beyond a limit, or has too many points.
"""

import gc
import json
import math
import time
from array import array

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from control_msgs.action import FollowJointTrajectory
from live import NAMES, NS, Quiet, commanded_rad, goal_to, live
from ros_client import until
from slices import spread
from stack import Process
from trajectory_msgs.msg import JointTrajectoryPoint

from shm.recording import now_at, read_on
from shm.words import Mode

POINTS = (1_000, 50_000, 100_000, 200_000, 500_000)
TURNS = 3
SPACING_S = 0.001
ENDED_S = 120.0
FRONTS = {"as bytes": "rosfront", "by rclpy": "bench.locked_front"}


def big_goal(count):
    """A slow motion through so many points, the last one beyond a limit."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    rate, size = 0.2, 0.1
    for index in range(count):
        time_ns = round((1.0 + index * SPACING_S) * NS)
        phase = rate * index * SPACING_S
        message = JointTrajectoryPoint(
            positions=array("d", [size * math.sin(phase)] * 6),
            velocities=array("d", [size * rate * math.cos(phase)] * 6),
            accelerations=array("d", [-size * rate * rate * math.sin(phase)] * 6),
        )
        message.time_from_start.sec, message.time_from_start.nanosec = divmod(time_ns, NS)
        goal.trajectory.points.append(message)
    last = goal.trajectory.points[-1]
    last.positions[1] = 10.0
    last.velocities = array("d", [0.0] * 6)  # what ends in motion is refused before its limits are looked at
    return goal


def window(prober):
    """What the prober has found since it was asked last."""
    prober.say("")
    return json.loads(prober.line_with("{"))


def figures_of(stack, client, prober, goal):
    """What one goal does while another one runs."""
    running = client.send(goal_to(commanded_rad(stack) + 0.2, 120.0))
    until(lambda: stack.reader.snapshot()["mode"] == Mode.EXECUTING, "motion")
    window(prober)
    since = now_at(stack.reader.memory)
    sent_s, answered_s = time.monotonic(), []
    future = client.action.send_goal_async(goal)
    future.add_done_callback(lambda _: answered_s.append(time.monotonic()))
    handed_s = time.monotonic()
    until(lambda: answered_s, "the answer", ENDED_S)
    result = future.result().get_result_async()
    until(result.done, "the result", ENDED_S)
    ended_s = time.monotonic()
    figures = window(prober)
    records = read_on(stack.reader.memory, since)[0].records
    figures["age of the heartbeat (ms)"] = float((records["monotonic_ns"] - records["heartbeat_ns"]).max()) / 1e6
    figures["handed to ROS (s)"] = handed_s - sent_s
    figures["handed to ROS → accepted (s)"] = answered_s[0] - handed_s
    figures["accepted → refused (s)"] = ended_s - answered_s[0]
    end = running.get_result_async()
    figures["goals that it ended"] = float(stack.reader.snapshot()["mode"] != Mode.EXECUTING)
    running.cancel_goal_async()
    until(end.done, "the end")
    until(lambda: stack.reader.snapshot()["mode"] == Mode.HOLDING, "rest")
    return figures


def turn(folder, module, goals):
    """The figures of each goal with a front of a kind."""
    with live(folder, mock_hz=120.0, front=False) as stack:
        front = stack._keep(Process(module, str(stack.arm_file), needs_ros=True))
        front.line_with("ready")
        controller = f"controller_{stack.name}"
        client, prober = Quiet(controller), Process("bench.big_goal_prober", controller, needs_ros=True)
        try:
            prober.line_with("ready")
            return {count: figures_of(stack, client, prober, goal) for count, goal in goals.items()}
        finally:
            prober.close()
            client.close()


@pytest.mark.benchmark(group="live")
@pytest.mark.timeout(3000)
def test_big_goals(benchmark, report, tmp_path):
    goals = {count: big_goal(count) for count in POINTS}
    gc.freeze()  # looking through millions of objects would keep this process from hearing an answer

    def measure():
        found = {name: [] for name in FRONTS}
        for number in range(TURNS):
            for name, module in FRONTS.items():
                folder = tmp_path / f"{number}-{module}"
                folder.mkdir()
                found[name].append(turn(folder, module, goals))
        return found

    try:
        found = benchmark.pedantic(measure, rounds=1)
    finally:
        gc.unfreeze()
    benchmark.extra_info["turns"] = found
    for count in POINTS:
        report(f"goals of {count:,} points, median (lowest to highest)", f"{TURNS} turns; {' and '.join(FRONTS)}")
        for figure in found["as bytes"][0][count]:
            both = (spread([each[count][figure] for each in turns]) for turns in found.values())
            report(f"  {figure}", " and ".join(both))
