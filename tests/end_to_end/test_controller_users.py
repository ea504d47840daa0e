"""What users do to a controller, with real processes: Servo's stream, several clients, goal after goal, big goals."""

import math
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from stack import run_rtarm

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from observer import judge, motion_violations
from ros_client import ABORTED, SUCCEEDED, Client
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from waiting import until

from config.loader import load_arm
from shm.client import StateReader
from shm.files import open_state
from shm.words import Fault, Mode

pytestmark = pytest.mark.process

NAMES = [f"joint{i}" for i in range(1, 7)]
START_RAD = [0.3, 0.2, -0.1, 1.0, 0.5, 2.0]


@pytest.fixture
def stack(served_at):
    stack = served_at(START_RAD)
    stack.reader = StateReader(open_state(stack.name))
    yield stack
    stack.reader.close()


def point(time_s, positions, velocities=()):
    whole = math.floor(time_s)
    stamp = Duration(sec=whole, nanosec=round((time_s - whole) * 1e9))
    return JointTrajectoryPoint(positions=list(positions), velocities=list(velocities), time_from_start=stamp)


def goal_to(positions, seconds):
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    goal.trajectory.points = [point(seconds, positions)]
    return goal


class ServoSender:
    """MoveIt Servo's output at 100 Hz: entries 0.1 s ahead, the last 0.2 s of them, the newest withheld."""

    PERIOD_S, LATENCY_S = 0.01, 0.1

    def __init__(self, stack, way):
        self.publisher = stack.client.node.create_publisher(
            JointTrajectory, f"/controller_{stack.name}/joint_trajectory", 10
        )
        until(lambda: self.publisher.get_subscription_count() > 0, "the controller's subscription")
        self.way, self.sent = way, 0

    def run(self, seconds, ended=lambda: False):
        begun, due, entries = time.time(), time.monotonic(), []
        while (now := time.time()) - begun < seconds and not ended():
            entries.append((now + self.LATENCY_S, *self.way(now - begun)))
            entries = [entry for entry in entries if entry[0] >= now - self.LATENCY_S]
            if len(entries) > 2:
                self.publisher.publish(self.message(entries[:-1]))
                self.sent += 1
            due += self.PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))

    @staticmethod
    def message(entries):
        first = entries[0][0]
        message = JointTrajectory(joint_names=NAMES)
        message.header.stamp = Time(sec=int(first), nanosec=int((first % 1.0) * 1e9))
        message.points = [point(at - first, position, velocity) for at, position, velocity in entries]
        return message


def wave(t):
    """A gentle one that begins at rest: positions and velocities after so many seconds."""
    size, omega = 0.08, 2.0
    x = min(t, 1.0)
    fade, rise = x * x * (3 - 2 * x), 6 * x * (1 - x)
    shape, speed = 1 - math.cos(omega * t), omega * math.sin(omega * t)
    position = [angle - size * fade * shape for angle in START_RAD]
    return position, [-size * (fade * speed + rise * shape)] * 6


def test_servo_streams_and_the_arm_stops_when_it_ends(stack):
    """Two seconds of Servo at full tilt of a gentle wave, cut off in motion."""
    began_ns = time.monotonic_ns()
    sender = ServoSender(stack, wave)
    sender.run(2.2)
    moved = stack.reader.snapshot()
    assert int(moved["mode"]) == Mode.EXECUTING
    until(lambda: int(stack.reader.snapshot()["mode"]) == Mode.HOLDING, "a stop", 3.0)
    end = stack.reader.snapshot()
    assert int(end["fault"]) == Fault.NONE and sender.sent > 180
    position = end["joints"]["measured_position_rad"][:6] - START_RAD
    assert (position < -0.05).all()  # it followed, and never went back when it stopped
    judge(motion_violations(load_arm(stack.arm_file), stack.truth(), began_ns, time.monotonic_ns()))


def test_a_person_stops_a_streamed_arm_which_stays_while_servo_goes_on(stack):
    """Each message used to replace what the stop had ended, until the stream itself was over."""

    def asked(command):
        done = run_rtarm(command, stack.name)
        assert done.returncode == 0, done.stderr
        return done.stdout

    began_ns = time.monotonic_ns()
    sender = ServoSender(stack, wave)
    ended = threading.Event()
    sending = threading.Thread(target=sender.run, args=(math.inf, ended.is_set))
    sending.start()
    try:
        until(lambda: np.any(stack.reader.snapshot()["joints"]["commanded_velocity_rad_s"]), "motion")
        said = asked("stop")
        stood = stack.reader.snapshot()
        sent = sender.sent
        until(lambda: sender.sent > sent + 50, "messages after the stop")
        after = stack.reader.snapshot()
    finally:
        ended.set()
        sending.join()
    assert said.endswith("It takes no goals before `rtarm resume`.\n")
    assert (int(stood["mode"]), int(stood["held"])) == (Mode.HOLDING, 1)
    assert (stood["joints"]["commanded_position_rad"] == after["joints"]["commanded_position_rad"]).all()
    assert asked("resume") == f"Arm {stack.name} takes goals again.\n"
    judge(motion_violations(load_arm(stack.arm_file), stack.truth(), began_ns, time.monotonic_ns()))


def test_several_clients_at_once_each_get_one_answer(stack):
    """Four clients, five goals each, all at once: one result a goal, and the arm ends where the last one said."""
    results, problems = [], []

    clients = [Client(f"controller_{stack.name}") for _ in range(4)]
    for client in clients:
        until(lambda c=client: c.states, "a joint state")

    def work(number):
        client = clients[number]
        try:
            for turn in range(5):
                target = [angle - 0.01 * (number + 1) - 0.005 * turn for angle in START_RAD]
                handle = client.send(goal_to(target, 0.5))
                results.append((*client.result(handle), target))
        except BaseException as problem:
            problems.append(problem)
        finally:
            client.close()

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not problems
    assert len(results) == 20
    for status, code, words, _ in results:
        assert (status, code) in {(SUCCEEDED, 0), (ABORTED, -1)}, words
        assert words
    assert results[-1][0] == SUCCEEDED
    last = stack.reader.snapshot()["joints"]["measured_position_rad"][:6]
    assert np.abs(last - results[-1][3]).max() < 0.01


def call(stack, name):
    """A Trigger service of the controller: its answer."""
    service = stack.client.node.create_client(Trigger, f"/controller_{stack.name}/{name}")
    assert service.wait_for_service(10.0)
    future = service.call_async(Trigger.Request())
    until(future.done, f"the answer of {name}", 40.0)
    stack.client.node.destroy_client(service)
    return future.result()


def measure(pid):
    """Resident kB, threads and open files of a process."""
    status = Path(f"/proc/{pid}/status").read_text()
    words = dict(line.split(":", 1) for line in status.splitlines())
    return int(words["VmRSS"].split()[0]), int(words["Threads"]), len(os.listdir(f"/proc/{pid}/fd"))


def test_goal_after_goal_leaves_nothing_behind(stack):
    """Memory, threads and open files of both processes after many goals (bench/ does a thousand)."""
    here = list(START_RAD)

    def move(count):
        for turn in range(count):
            here[0] = START_RAD[0] - (0.002 if turn % 2 else 0.0)
            status, _, words = stack.client.run(goal_to(here, 0.1))
            assert status == SUCCEEDED, words

    move(40)
    before = [measure(process.process.pid) for process in (stack.loop, stack.front)]
    move(120)
    after = [measure(process.process.pid) for process in (stack.loop, stack.front)]
    for (kb_before, *counts_before), (kb_after, *counts_after) in zip(before, after, strict=True):
        assert counts_after == counts_before
        assert kb_after - kb_before < 6_000


def test_hold_and_resume_over_ros_keep_the_goal(stack):
    client = stack.client
    handle = client.send(goal_to([angle - 0.2 for angle in START_RAD], 3.0))
    until(lambda: stack.reader.snapshot()["joints"]["commanded_velocity_rad_s"][0] < -0.05, "motion")
    for name in ("hold", "resume"):
        answer = call(stack, name)
        assert answer.success, answer.message
        if name == "hold":
            rows = stack.reader.snapshot()["joints"][:6]
            assert not rows["commanded_velocity_rad_s"].any()
    status, code, words = client.result(handle)
    assert (status, code) == (SUCCEEDED, 0), words


def test_limp_drives_over_ros_and_back(stack):
    """free → disable → enable with real drives' bytes: not a count of motion, and a goal afterwards."""
    before = stack.reader.snapshot()["joints"]["measured_position_rad"][:6].copy()
    for name, mode in (("free", Mode.FREE), ("disable", Mode.DISABLED)):
        answer = call(stack, name)
        assert answer.success and "limp" in answer.message
        assert int(stack.reader.snapshot()["mode"]) == mode
    status, code, words = stack.client.run(goal_to(START_RAD, 1.0))
    assert (status, code) == (ABORTED, -1) and "disabled" in words
    states = len(stack.client.states)
    until(lambda: len(stack.client.states) > states + 20, "joint states of limp drives")
    answer = call(stack, "enable")
    assert answer.success, answer.message
    after = stack.reader.snapshot()["joints"]["measured_position_rad"][:6]
    assert np.abs(after - before).max() < 1e-3
    status, code, words = stack.client.run(goal_to([angle - 0.05 for angle in START_RAD], 1.0))
    assert (status, code) == (SUCCEEDED, 0), words
    assert call(stack, "hold").success
    assert call(stack, "resume").success
    assert call(stack, "clear_fault").success


def test_a_goal_of_a_hundred_thousand_points(stack):
    """Accepted, checked and begun while the interpreter is never held for long; then canceled."""
    client = stack.client
    count, spacing_s = 100_000, 0.001
    t = np.arange(count) * spacing_s
    omega = 2 * math.pi / (t[-1] / 10)
    shape, speed = 0.02 * (1 - np.cos(omega * t)), 0.02 * omega * np.sin(omega * t)
    speed[-1] = 0.0
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = NAMES
    base = np.array(START_RAD)
    goal.trajectory.points = [point(t[i], (base - shape[i]).tolist(), [-float(speed[i])] * 6) for i in range(count)]
    handle = client.send(goal)
    until(lambda: int(stack.reader.snapshot()["mode"]) == Mode.EXECUTING, "execution", 30.0)
    until(lambda: float(stack.reader.snapshot()["trajectory_clock_ns"]) > 2e9, "two seconds of it", 10.0)
    again = client.send(goal)  # another one while this one moves: it must not lose the heartbeat
    until(lambda: int(stack.reader.snapshot()["goal_id"]) != 1, "the newer goal", 30.0)
    assert client.result(handle)[0] == ABORTED
    future = again.cancel_goal_async()
    until(future.done, "the answer to a cancel", 5.0)
    assert int(stack.reader.snapshot()["fault"]) == Fault.NONE
    client.result(again)
