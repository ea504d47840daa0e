"""The front with the real control process behind it, on mock drives."""

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from shm.files import command_path, state_path

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration
from ros_client import ABORTED, CANCELED, SUCCEEDED, Client, recorded
from trajectory_msgs.msg import JointTrajectoryPoint
from waiting import until

BIG_GOAL_S = 120.0
CPU = max(os.sched_getaffinity(0))
ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.process


@pytest.fixture
def processes(arm_name, tmp_path):
    """Loop and front of an arm with mock drives, ready; the cycle has a processor of its own if there is one."""
    values = yaml.safe_load((ROOT / "config" / "arms" / "mock.yaml").read_text())
    values["name"] = arm_name
    values.setdefault("front", {})["controller_name"] = f"controller_{arm_name}"
    values["realtime"] = {"cpu": CPU}
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(values))
    started = []
    for module in ("rtloop", "rosfront"):
        process = subprocess.Popen(
            [sys.executable, "-m", module, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline().startswith("ready")
    client = Client(f"controller_{arm_name}")
    yield client, *started
    client.close()
    for process in reversed(started):
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=20)
    for left in (state_path(arm_name), command_path(arm_name)):  # of a killed loop
        left.unlink(missing_ok=True)


def positions(client):
    client.states.clear()
    until(lambda: client.states, "a joint state")
    return list(client.states[-1][1].position)


def test_recorded_goals_cancel_replacement_and_a_killed_loop(processes):
    client, loop, _ = processes
    small, back = recorded("small"), recorded("single_joint")
    status, code, words = client.run(small)
    assert (status, code) == (SUCCEEDED, 0), words
    assert positions(client) == pytest.approx(list(small.trajectory.points[-1].positions), abs=0.001)
    status, _, words = client.run(back)
    assert status == SUCCEEDED, words

    large = recorded("large")
    handle = client.send(large)
    begun = time.monotonic()
    until(lambda: abs(positions(client)[0] - large.trajectory.points[0].positions[0]) > 0.1, "motion")
    handle.cancel_goal_async()
    status, code, words = client.result(handle)
    assert (status, code) == (CANCELED, 0) and words.startswith("Canceled: the arm is at rest")
    assert time.monotonic() - begun < 3.0
    resting = positions(client)

    away = recorded("small")
    away.trajectory.points = [
        JointTrajectoryPoint(positions=[p + 0.2 for p in resting], time_from_start=Duration(sec=3)),
    ]
    home = recorded("small")
    home.trajectory.points = [JointTrajectoryPoint(positions=resting, time_from_start=Duration(sec=3))]
    older = client.send(away)
    until(lambda: abs(positions(client)[0] - resting[0]) > 0.05, "motion")
    newer = client.send(home)
    status, code, words = client.result(older)
    assert (status, code) == (ABORTED, -1) and words.startswith("The goal was replaced by a newer goal")
    status, _, words = client.result(newer)
    assert status == SUCCEEDED, words
    assert positions(client) == pytest.approx(resting, abs=0.001)

    running = client.send(away)
    until(lambda: abs(positions(client)[0] - resting[0]) > 0.05, "motion")
    loop.kill()
    killed = time.monotonic()
    status, _, words = client.result(running)
    assert status == ABORTED and "has ended and the drives stop by themselves" in words
    assert time.monotonic() - killed < 0.5


def test_a_refused_newer_goal_does_not_end_a_long_running_one(processes):
    """The running goal's later waypoints go on coming while the control process looks at the newer one."""
    client, _, _ = processes
    long_goal = recorded("near_limits_high")
    running = client.send(long_goal)
    until(lambda: abs(positions(client)[0]) > 0.1, "motion")
    far = recorded("near_limits_high")  # it begins where the arm is not any more
    until(lambda: abs(positions(client)[3]) > 0.2, "motion")
    status, code, words = client.run(far)
    assert (status, code) == (ABORTED, -1) and "first point" in words
    status, _, words = client.result(running)
    assert status == SUCCEEDED, words
    assert positions(client) == pytest.approx(list(long_goal.trajectory.points[-1].positions), abs=0.001)


@pytest.mark.parametrize("even", [True, False], ids=["alike", "different fields"])
def test_goals_of_very_many_points_leave_the_running_one_alone(processes, even):
    """One as long as is allowed, and a longer one, which used to end the running one."""
    client, _, _ = processes
    resting = positions(client)
    slow = recorded("small")
    slow.trajectory.points = [
        JointTrajectoryPoint(
            positions=[resting[0] + turned, *resting[1:]],
            velocities=[speed, *[0.0] * (len(resting) - 1)],
            time_from_start=Duration(sec=second),
        )
        for second, turned, speed in ((2, 0.005, 0.005), (198, 0.985, 0.005), (200, 0.99, 0.0))
    ]
    running = client.send(slow)
    until(lambda: abs(positions(client)[0] - resting[0]) > 0.001, "motion")
    row = [0.0] * len(resting)
    point = JointTrajectoryPoint(positions=row, velocities=row)
    other = point if even else JointTrajectoryPoint(positions=row)
    for count, words in ((200_000, "has time_from_start"), (500_000, "has 500000 points and at most 200000 are")):
        big = recorded("small")
        big.trajectory.points = [point, other] * (count // 2 - 1) + [point, JointTrajectoryPoint(positions=row)]
        big.trajectory.points[-1].time_from_start.sec = 1
        answer = client.action.send_goal_async(big)
        until(answer.done, "the answer to a big goal", BIG_GOAL_S)
        status, code, sentence = client.result(answer.result())
        assert (status, code) == (ABORTED, -1) and words in sentence, sentence
    still = positions(client)[0]
    until(lambda: positions(client)[0] > still + 0.001, "motion of the running goal")
    until(running.cancel_goal_async().done, "the answer to a cancel")
    assert client.result(running)[0] == CANCELED


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor for all")
def test_only_the_cycle_runs_on_its_processor(processes):
    """A timer of the front that is armed there would interrupt the cycle about when it wakes up."""
    _, loop, front = processes

    def there(process):
        found = {}
        for tid in map(int, os.listdir(f"/proc/{process.pid}/task")):
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                found[tid] = os.sched_getaffinity(tid)
        return {tid: processors for tid, processors in found.items() if CPU in processors}

    assert not there(front)
    assert list(there(loop).values()) == [{CPU}], "a mock arm has no reader"
    assert loop.pid not in there(loop)
