"""`rtarm.connect` and `rtarm move`: what a program and a person at a shell move a running arm with."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stack import ROOT, Stack, run_rtarm
from typer.testing import Result
from waiting import until
from written_arm import WrittenArm

import rtarm
from rtarm.client import moves
from rtarm.client.sender import Outcome
from rtarm.console.errors import ExitCode, foreseen
from shm.words import Mode

PATIENCE_S = 30.0


@pytest.fixture
def standing(arm: WrittenArm) -> WrittenArm:
    """An arm that holds, with limits, at 0.1 and -0.2 rad; its file is not that of a known arm, so it has none."""
    rows = arm.state["limits"]["joints"][:2]
    rows["max_velocity_rad_s"], rows["max_acceleration_rad_s2"] = 1.0, 2.0
    rows["lower_rad"], rows["upper_rad"] = -1.0, 1.5
    arm.rows["commanded_position_rad"] = 0.1, -0.2
    arm.publish()
    return arm


@pytest.fixture
def python_arm(standing: WrittenArm, arm_file: Path) -> Iterator[rtarm.Arm]:
    with rtarm.connect(str(arm_file)) as connected:
        yield connected


def test_an_angle_beyond_its_limits_is_refused_with_joint_value_and_limit(python_arm: rtarm.Arm) -> None:
    joint = python_arm.joints[1]
    for call in (
        lambda: python_arm.move({joint: 1.6}),
        lambda: python_arm.move({joint: 1.8}, relative=True),
        lambda: python_arm.follow([1.0, 2.0], [[0.0, 0.0], [0.0, 1.6]]),
    ):
        with pytest.raises(rtarm.Refusal, match=r"1\.6000 rad .* but may only be -1\.0000 to 1\.5000 rad") as refused:
            call()
        assert (refused.value.joint, refused.value.value, refused.value.limit) == (joint, pytest.approx(1.6), 1.5)


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda arm: arm.move({"nose": 0.1}), "has no joint 'nose'; its joints are"),
        (lambda arm: arm.move({"elbwo": 0.1}), r"has no joint 'elbwo' \(did you mean elbow\?\); its joints are"),
        (lambda arm: arm.move({arm.joints[0]: math.nan}), "is no number"),
        (lambda arm: arm.move({arm.joints[0]: 0.2}, speed=0.0), "speed is 0, but must be above 0"),
        (lambda arm: arm.move({arm.joints[0]: 0.2}, speed=1.5), "speed is 1.5, but must be"),
        (lambda arm: arm.follow([1.0, 2.0], [[0.0, 0.0]]), "one row for each time"),
        (lambda arm: arm.follow(1.0, [[0.0, 0.0]]), "one row for each time"),
        (lambda arm: arm.follow([1.0], [[0.0, 0.0]], [0.0, 0.0]), "The velocities have the shape"),
        (lambda arm: arm.follow([math.inf], [[0.0, 0.0]]), "A time is no number"),
        (lambda arm: arm.stream(0.0).__enter__(), "rate is 0 Hz, but must be"),
    ],
)
def test_what_means_nothing_is_refused_before_ros_is_started(
    python_arm: rtarm.Arm, ask: Callable[[rtarm.Arm], object], sentence: str
) -> None:
    with pytest.raises(rtarm.Refusal, match=sentence):
        ask(python_arm)
    assert python_arm._senders.present is None


def test_a_refusal_of_a_joint_names_it(python_arm: rtarm.Arm) -> None:
    with pytest.raises(rtarm.Refusal) as refused:
        python_arm.move({"elbwo": 0.1})
    assert refused.value.joint == "elbwo"


def test_an_arm_a_rounding_beyond_a_limit_is_at_it(standing: WrittenArm, python_arm: rtarm.Arm) -> None:
    standing.rows["commanded_position_rad"] = 0.1, 1.5 + 2.3e-16
    standing.publish()
    assert "stands there already" in python_arm.move({python_arm.joints[0]: 0.1})


def test_a_control_process_that_died_amid_a_write_is_not_waited_for(
    standing: WrittenArm, python_arm: rtarm.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    standing.state["snapshot_sequence"][0] += 1
    monkeypatch.setattr("shm.files.is_held", lambda _: False)
    with pytest.raises(rtarm.NotRunning):
        python_arm.state()
    standing.state["snapshot_sequence"][0] += 1


def test_an_arm_that_is_there_already_is_not_sent_there(python_arm: rtarm.Arm) -> None:
    assert "stands there already" in python_arm.move({python_arm.joints[0]: 0.1})
    assert python_arm._senders.present is None


@pytest.mark.parametrize("held", [True, False])
def test_an_arm_that_does_not_just_hold_is_not_moved(standing: WrittenArm, python_arm: rtarm.Arm, held: bool) -> None:
    standing.snapshot["held"], standing.snapshot["mode"] = held, Mode.HOLDING if held else Mode.EXECUTING
    standing.publish()
    with pytest.raises(rtarm.Refusal):
        python_arm.move({python_arm.joints[0]: 0.2})


class Told:
    """A sender whose goal ended, or that is gone itself."""

    alive = False

    def __init__(self, outcome: Outcome | None) -> None:
        self.outcome = outcome

    def send(self, goal: dict[str, Any]) -> int:
        return 1

    def cancel(self) -> None: ...

    def ended(self, number: int, patience_s: float = 0.0) -> Outcome | None:
        if self.outcome is None:
            raise rtarm.Refusal("The process that sends goals has ended.")
        return self.outcome


@pytest.mark.parametrize("outcome", [Outcome(False, -6, "The control process is gone."), None], ids=["front", "sender"])
def test_a_motion_that_ends_with_the_control_process_says_so_whoever_noticed_first(
    python_arm: rtarm.Arm, monkeypatch: pytest.MonkeyPatch, outcome: Outcome | None
) -> None:
    connection = python_arm._connection
    with pytest.raises(rtarm.GoalFailed):
        moves.run(connection, Told(outcome), {})  # type: ignore[arg-type]
    monkeypatch.setattr("shm.files.is_held", lambda _: False)
    with pytest.raises(rtarm.NotRunning, match="has died") as ended:
        moves.run(connection, Told(outcome), {})  # type: ignore[arg-type]
    told = foreseen(ended.value)
    assert told is not None and told[1] == ExitCode.LOOP_DIED


def test_a_motion_that_an_orderly_end_cut_short_did_not_succeed(
    python_arm: rtarm.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However soon it is noticed: by the front's word, or before it."""
    monkeypatch.setattr("shm.files.is_held", lambda _: False)
    monkeypatch.setattr("shm.files.was_removed", lambda _: True)
    with pytest.raises(rtarm.GoalFailed, match="has ended in order, so the arm stands"):
        moves.run(python_arm._connection, Told(Outcome(False, -6, "The control process is gone.")), {})  # type: ignore[arg-type]


def test_no_arm_of_that_name(arm_name: str) -> None:
    with pytest.raises(rtarm.NotRunning, match=arm_name), rtarm.connect(arm_name):
        pass


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("elbow",), "'elbow' gives no joint an angle: write JOINT=DEGREES, such as elbow=15."),
        (("20",), "'20' gives no joint an angle: write JOINT=DEGREES, such as shoulder=15."),
        (("elbow=much",), "'much', which is no number"),
        (("elbow=0.3rad",), "'0.3rad', which is no number: write degrees without a unit, such as elbow=-12.5."),
        (("elbow=20", "elbow=30"), "elbow is named twice: give it one angle."),
        (("nose=1",), "has no joint 'nose'"),
    ],
)
def test_move_refuses_what_is_no_target(
    standing: WrittenArm, arm_file: Path, rtarm: Callable[..., Result], words: tuple[str, ...], sentence: str
) -> None:
    result = rtarm("move", *words, "--arm", str(arm_file), "--json")
    assert result.exit_code == 1 and sentence in " ".join(json.loads(result.stdout)["problems"])


# --- beside real processes


@pytest.fixture(scope="module")
def stack(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A simulated arm of a name and a file of its own, whose true motion is judged at the end."""
    with closing(Stack(new_arm_name(), tmp_path_factory.mktemp("python"))) as stack:
        stack.start_sim()
        stack.start_loop()
        stack.start_front()
        yield stack


@pytest.fixture
def moving(stack: Stack) -> Iterator[rtarm.Arm]:
    """By its name alone: where its file is, shared memory knows."""
    with rtarm.connect(stack.name) as connected:
        if connected.state().held:
            connected.resume()
        yield connected


def in_background(call: Callable[[], Any]) -> tuple[threading.Thread, list[Any]]:
    """Run a call in a thread; what it returns or raises is put in the list."""
    ends: list[Any] = []

    def run() -> None:
        try:
            ends.append(call())
        except Exception as error:
            ends.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, ends


@pytest.mark.process
def test_joints_go_where_they_are_told(moving: rtarm.Arm) -> None:
    before = moving.state().position_rad
    assert "Goal reached" in moving.move({"joint1": before[0] + 0.1}, speed=0.5)
    assert "Goal reached" in moving.move({"joint1": -0.04, "joint6": 0.05}, relative=True)
    after = moving.state()
    assert after.position_rad - before == pytest.approx([0.06, 0.0, 0.0, 0.0, 0.0, 0.05], abs=2e-3)
    assert not after.moves and not after.held and after.fault == ""
    assert np.abs(time.monotonic() - after.measured_s).max() < PATIENCE_S


@pytest.mark.process
def test_a_trajectory_is_followed(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad
    times = np.linspace(0.0, 2.0, 21)
    way = here + 0.05 * (1.0 - np.cos(np.pi * times))[:, None]  # there and back, from rest to rest
    assert "Goal reached" in moving.follow(times, way)
    assert moving.state().commanded_rad == pytest.approx(here, abs=1e-3)
    with pytest.raises(rtarm.GoalFailed, match="start"):
        moving.follow(times, way + 0.5)  # which begins elsewhere


@pytest.mark.process
def test_a_stop_ends_a_motion(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad[0]
    thread, ends = in_background(lambda: moving.move({"joint1": here + 0.5}, speed=0.2))
    until(lambda: moving.state().moves, "the arm on its way", PATIENCE_S)
    assert "stopped on its path" in moving.stop()
    assert not moving.state().moves and moving.state().held
    thread.join(PATIENCE_S)
    assert isinstance(ends[0], rtarm.GoalFailed)
    with pytest.raises(rtarm.Refusal, match="A person has stopped"):
        moving.move({"joint1": here})
    moving.resume()
    assert "Goal reached" in moving.move({"joint1": here})


@pytest.mark.process
@pytest.mark.parametrize("streams", [False, True])
def test_a_stop_reaches_the_arm_where_the_process_that_speaks_ros_hangs(moving: rtarm.Arm, streams: bool) -> None:
    here = moving.state().commanded_rad
    assert "Goal reached" in moving.move({"joint1": here[0] + 0.05})
    sender = moving._senders.present
    assert sender is not None
    os.kill(sender.pid, signal.SIGSTOP)
    try:
        if streams:  # far more than a pipe holds
            with moving.stream(rate_hz=50.0) as stream:
                for _ in range(1000):
                    stream.send({"joint1": here[0] + 0.05})
        stopped, ends = in_background(moving.stop)
        stopped.join(PATIENCE_S)
        assert "Arm" in ends[0] and moving.state().held
    finally:
        os.kill(sender.pid, signal.SIGCONT)
    moving.resume()
    until(lambda: not moving.state().moves, "the arm at rest", PATIENCE_S)


@pytest.mark.process
def test_a_motion_that_was_asked_for_before_a_stop_never_begins(stack: Stack) -> None:
    """Also where the arm was told to take goals again before ROS, which takes a second to start, was there."""
    with rtarm.connect(stack.name) as fresh:
        here = fresh.state().commanded_rad[0]
        thread, ends = in_background(lambda: fresh.move({"joint1": here + 0.3}, speed=0.5))
        until(fresh._one_at_a_time.locked, "ROS on its way", PATIENCE_S)
        fresh.stop()
        fresh.resume()
        thread.join(PATIENCE_S)
        assert isinstance(ends[0], rtarm.Refusal) and "stopped before the motion could begin" in str(ends[0])
        assert fresh.state().commanded_rad[0] == pytest.approx(here, abs=1e-3)


@pytest.mark.process
def test_two_threads_do_not_move_it_at_once(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad[0]
    thread, ends = in_background(lambda: moving.move({"joint1": here - 0.1}, speed=0.3))
    until(moving._one_at_a_time.locked, "the first on its way", PATIENCE_S)
    with pytest.raises(rtarm.Refusal):
        moving.move({"joint6": 0.1}, relative=True)
    thread.join(PATIENCE_S)
    assert "Goal reached" in ends[0]


@pytest.mark.process
def test_a_held_motion_goes_on_to_its_end(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad[0]
    thread, ends = in_background(lambda: moving.move({"joint1": here - 0.3}, speed=0.3))
    until(lambda: moving.state().moves, "the arm on its way", PATIENCE_S)
    moving.hold()
    held = moving.state()
    assert held.held and held.commanded_rad[0] > here - 0.3
    moving.resume()
    thread.join(PATIENCE_S)
    assert "Goal reached" in ends[0]
    assert moving.state().commanded_rad[0] == pytest.approx(here - 0.3, abs=1e-3)


@pytest.mark.process
def test_a_loop_of_fifty_hertz_leads_the_arm_and_sees_it(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad[5]
    seen = []
    with moving.stream(rate_hz=50.0) as stream:
        begun_s = time.monotonic()
        for step in range(100):
            stream.send({"joint6": here + 0.1 * math.sin(math.pi * step / 100) ** 2})
            seen.append(moving.state().position_rad[5])
            time.sleep(max(0.0, begun_s + (step + 1) / 50.0 - time.monotonic()))
        with pytest.raises(rtarm.Refusal, match="joint6 would have to go to") as refused:
            stream.send({"joint6": 100.0})
        assert refused.value.joint == "joint6"
        stream.send({"joint6": here}, np.zeros(6))
    assert max(seen) == pytest.approx(here + 0.1, abs=0.02)
    assert not moving.state().moves
    assert moving.state().commanded_rad[5] == pytest.approx(here, abs=0.01)
    assert moving.state().fault == ""


@pytest.mark.process
def test_a_stream_that_paused_moves_only_what_it_names(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad
    with rtarm.connect(moving.name) as other, moving.stream(rate_hz=50.0) as stream:
        stream.send({"joint1": here[0]})
        until(lambda: not moving.state().moves, "the arm at rest", PATIENCE_S)
        with pytest.raises(rtarm.Refusal, match="already"):
            moving.move({"joint6": here[5] + 0.05})
        other.move({"joint6": 0.08}, relative=True)
        stream.send({"joint1": here[0]}, np.zeros(6))
        for state in islice(moving.states(), 60):
            assert state.commanded_rad[5] == pytest.approx(here[5] + 0.08, abs=1e-3)
        until(lambda: not moving.state().moves, "the arm at rest", PATIENCE_S)


@pytest.mark.process
def test_a_motion_whose_sender_dies_is_ended_and_told_to_have_failed(moving: rtarm.Arm) -> None:
    here = moving.state().commanded_rad[0]
    thread, ends = in_background(lambda: moving.move({"joint1": here + 0.6}, speed=0.1))
    until(lambda: moving.state().moves, "the arm on its way", PATIENCE_S)
    sender = moving._senders.present
    assert sender is not None
    os.kill(sender.pid, signal.SIGKILL)
    thread.join(PATIENCE_S)
    assert isinstance(ends[0], rtarm.GoalFailed)
    until(lambda: not moving.state().moves, "the arm at rest", PATIENCE_S)
    assert moving.state().commanded_rad[0] < here + 0.5


@pytest.mark.process
def test_states_come_with_the_cycles(moving: rtarm.Arm) -> None:
    states = moving.states()
    times_s = [next(states).time_s for _ in range(30)]
    periods = np.diff(times_s) * 120.0
    assert (np.round(periods) >= 1).all() and periods == pytest.approx(np.round(periods), abs=0.05)


@pytest.mark.process
def test_a_program_that_dies_amid_a_motion_leaves_no_motion(stack: Stack, moving: rtarm.Arm) -> None:
    motion = "arm.move({'joint1': 0.5}, speed=0.1, relative=True)"
    program = f"import rtarm\nwith rtarm.connect({stack.name!r}) as arm: {motion}"
    process = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT)
    try:
        until(lambda: moving.state().moves, "the arm on its way", PATIENCE_S)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    until(lambda: not moving.state().moves, "the arm at rest", PATIENCE_S)
    assert not moving.state().held  # nobody has stopped it: its goal was cancelled
    assert moving.state().fault == ""


@pytest.mark.process
def test_the_shell_moves_it_too(stack: Stack, moving: rtarm.Arm) -> None:
    moved = run_rtarm("move", "joint1=5", "joint6=-3", "--speed", "0.5", "--arm", stack.name)
    assert (moved.returncode, "Goal reached" in moved.stdout) == (0, True), moved.stderr
    assert np.degrees(moving.state().position_rad[[0, 5]]) == pytest.approx([5.0, -3.0], abs=0.1)
    refused = run_rtarm("move", "joint1=500", "--arm", str(stack.arm_file), "--json")
    assert refused.returncode == 1 and "joint1 would have to go to" in json.loads(refused.stdout)["problems"][0]
    assert np.degrees(moving.state().position_rad[0]) == pytest.approx(5.0, abs=0.1)
