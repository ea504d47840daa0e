"""The node as its clients meet it: a real action client, a stand-in for the control process."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from fake_loop import FakeLoop

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from action_msgs.srv import CancelGoal
from front_stage import SlowJudge, Stage, goal, pile_up, serving_alone
from ros_client import ABORTED, CANCELED, SUCCEEDED, Client, Operator
from std_srvs.srv import Trigger
from waiting import until

from config.loader import load_arm
from rosfront import action, node
from rosfront.serving import NEVER_BEGUN
from sentences.told import outcome_sentence
from shm.words import Fault, Outcome

pytestmark = pytest.mark.process  # a real client, real threads, real time

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def whole_stage(new_arm_name):
    stage = Stage(new_arm_name())
    yield stage
    stage.close()


@pytest.fixture
def stage(whole_stage):
    """The one stage, with a sound loop and the arm at zero."""
    whole_stage.reset()
    return whole_stage


def test_a_goal_succeeds_with_feedback_on_the_way(stage):
    status, code, words = stage.client.run(goal(seconds=1.0))
    assert (status, code) == (SUCCEEDED, 0), words
    assert words.startswith("Goal reached: the largest error is 0.0000 rad")
    assert stage.loop.rows["commanded_position_rad"].tolist() == pytest.approx([0.01] * 6)
    assert 12 <= len(stage.client.feedback) <= 22
    assert all(feedback.header.frame_id == "base_link" for feedback in stage.client.feedback)
    for feedback in stage.client.feedback:
        assert list(feedback.joint_names) == [f"joint{i}" for i in range(1, 7)]
        desired, actual = np.array(feedback.desired.positions), np.array(feedback.actual.positions)
        assert (desired - actual).tolist() == list(feedback.error.positions)
        assert len(feedback.desired.velocities) == 6
    clocks = [f.desired.time_from_start.nanosec for f in stage.client.feedback]
    assert clocks == sorted(clocks)


def test_any_order_of_joints_and_a_subset(stage):
    status, _, _ = stage.client.run(goal(names=["joint5", "joint2"]))
    assert status == SUCCEEDED
    assert stage.loop.rows["commanded_position_rad"].tolist() == pytest.approx([0, 0.01, 0, 0, 0.01, 0])


def test_a_bad_goal_is_accepted_and_aborted_with_its_reason(stage):
    message = goal(names=["elbow"])
    handle = stage.client.send(message)
    assert handle.accepted
    status, code, words = stage.client.result(handle)
    assert (status, code) == (ABORTED, -2)
    assert words.startswith("'elbow' in joint_names is no joint of this arm")


def test_a_bad_goal_does_not_disturb_the_running_one(stage):
    running = stage.client.send(goal(seconds=0.5))
    bad = goal()
    bad.trajectory.points[1].positions[2] = float("nan")
    status, code, words = stage.client.run(bad)
    assert (status, code) == (ABORTED, -1) and "nan as position of joint3" in words
    assert stage.client.result(running)[0] == SUCCEEDED


def test_a_cancel_is_answered_at_once_and_stops_the_goal(stage):
    handle = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    begun = time.monotonic()
    future = handle.cancel_goal_async()
    until(future.done, "the answer to a cancel")
    assert time.monotonic() - begun < 1.0
    assert len(future.result().goals_canceling) == 1
    status, code, words = stage.client.result(handle)
    assert (status, code) == (CANCELED, 0) and words.startswith("Canceled: the arm is at rest")


def test_a_cancel_right_behind_its_goal(stage):
    stage.loop.taking = False
    handle = stage.client.send(goal(seconds=5))
    future = handle.cancel_goal_async()
    until(future.done, "the answer to a cancel")
    stage.loop.taking = True
    assert stage.client.result(handle)[0] == CANCELED


def test_a_goal_that_succeeds_while_it_is_being_canceled_has_succeeded(stage):
    def succeed(loop):
        if loop.cancel_at:
            loop.finish(Outcome.SUCCEEDED, joint=0, limit=0.01)

    stage.loop.cycle_hook = succeed
    handle = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    handle.cancel_goal_async()
    status, code, words = stage.client.result(handle)
    assert (status, code) == (SUCCEEDED, 0) and words.startswith("Goal reached")


def test_a_stop_by_a_person_is_no_cancel(stage):
    handle = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    stage.loop.cycle_hook = lambda loop: loop.active and loop.finish(Outcome.STOPPED)
    status, code, words = stage.client.result(handle)
    assert (status, code) == (ABORTED, -1) and "stopped by a person" in words


def test_a_newer_goal_replaces_the_older(stage):
    older = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    newer = stage.client.send(goal(seconds=0.3))
    status, code, words = stage.client.result(older)
    assert (status, code) == (ABORTED, -1)
    assert words.startswith("The goal was replaced by a newer goal") and "; joint1 is" in words
    assert stage.client.result(newer)[0] == SUCCEEDED


def test_a_client_that_vanishes_leaves_the_next_one_undisturbed(stage):
    passing = Client()
    passing.send(goal(seconds=0.5))
    passing.close()
    until(lambda: not stage.loop.active, "the end of the orphaned goal")
    assert stage.client.run(goal())[0] == SUCCEEDED


def test_joint_states(stage):
    stage.client.states.clear()
    heard = stage.client.sensor_data
    until(lambda: len(stage.client.states) > 60, "60 joint states")
    messages = [message for _, message in stage.client.states]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
    for message in messages:
        assert list(message.name) == [f"joint{i}" for i in range(1, 7)]
        assert message.header.frame_id == "base_link"
        assert len(message.position) == len(message.velocity) == 6
        assert np.isnan(message.effort).all()
    assert (np.diff(stamps) > 0).all()
    assert np.median(np.diff(stamps)) == pytest.approx(10_000_000, rel=0.01)
    assert abs(stamps[-1] - time.time_ns()) < 5e9
    assert stage.client.sensor_data > heard


def test_after_a_fault_joint_states_go_on_and_goals_are_refused(stage):
    handle = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    stage.loop.cycle_hook = lambda loop: loop.active and loop.fault(Fault.FOLLOWING_ERROR, 3, 0.12, 0.1)
    status, code, words = stage.client.result(handle)
    assert (status, code) == (ABORTED, -1)
    assert words.startswith("joint4 was 0.1200 rad from where it was commanded")
    stage.client.states.clear()
    assert stage.client.run(goal())[2].startswith("joint4 was 0.1200 rad from where it was commanded")
    until(lambda: len(stage.client.states) > 5, "joint states after a fault")


def test_no_goal_while_a_joint_has_no_reference(stage):
    stage.loop.unreference(1)
    until(lambda: not stage.serves(), "the loss of a reference")
    status, _, words = stage.client.run(goal())
    assert status == ABORTED and words.startswith("The drive of joint2 may have lost power")


def test_a_dead_loop_aborts_the_goal_and_a_new_one_is_found(stage):
    handle = stage.client.send(goal(seconds=5))
    until(lambda: stage.loop.active, "motion")
    stage.loop.die()
    died = time.monotonic()
    status, code, words = stage.client.result(handle)
    assert time.monotonic() - died < 0.5
    assert (status, code) == (ABORTED, -1) and "has ended and the drives stop by themselves" in words
    stage.client.states.clear()
    assert "has ended" in stage.client.run(goal())[2]
    stage.new_loop()
    until(lambda: stage.client.states, "joint states from the new loop")
    assert stage.client.states[0][0] - died > 0
    stage.loop.rows["commanded_position_rad"] = 0.0
    assert stage.client.run(goal())[0] == SUCCEEDED


def test_a_hung_loop_aborts_the_goal_and_is_served_again_when_it_wakes(stage):
    handle = stage.client.send(goal(seconds=30))
    until(lambda: stage.loop.active, "motion")
    stage.loop.pause.set()
    status, _, words = stage.client.result(handle)
    assert status == ABORTED and "has run no cycle for" in words
    assert "has run no cycle for" in stage.client.run(goal())[2]
    stage.loop.pause.clear()
    until(stage.serves, "serving again")
    until(lambda: not stage.loop.active, "the end of the hung goal")
    stage.loop.rows["commanded_position_rad"] = 0.0
    until(lambda: stage.serves() and not stage.front.serving.present().commanded[:, 0].any(), "the arm at zero")
    assert stage.client.run(goal())[0] == SUCCEEDED


def test_strict_reject(arm_name):
    with serving_alone(arm_name, strict_reject=True) as (_, _, client, _):
        assert not client.send(goal(names=["elbow"])).accepted
        until(lambda: client.send(goal()).accepted, "an accepted goal")


def person_at(arm_name):
    """An operator of the front that `serving_alone` makes."""
    return contextlib.closing(Operator(f"alone_{arm_name}"))


def test_while_a_goal_is_judged_others_are_served_and_a_cancel_ends_it(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        judge = SlowJudge(monkeypatch)
        first, second = client.send(goal(seconds=5)), client.send(goal(to_rad=0.02))
        until(judge.judging.is_set, "a goal being judged")
        assert alone.get_parameters("constraints.goal_time") == [0.4]
        future = first.cancel_goal_async()
        until(future.done, "the answer to a cancel")
        assert client.result(first) == (CANCELED, 0, NEVER_BEGUN)
        assert not judge.pass_on.is_set() and not loop.records
        judge.pass_on.set()
        assert client.result(second)[0] == SUCCEEDED
        assert loop.rows["commanded_position_rad"] == pytest.approx(0.02)


HELD = (ABORTED, -1, outcome_sentence(Outcome.REFUSED_HELD))


@pytest.mark.parametrize("resumed", [False, True])
def test_a_hold_ends_goals_that_are_being_judged(arm_name, monkeypatch, resumed):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        judge = SlowJudge(monkeypatch)
        handles = [client.send(goal(seconds=5)), client.send(goal())]
        until(judge.judging.is_set, "a goal being judged")
        answer = alone.call(Trigger, "~/hold")
        assert (answer.success, answer.message) == (True, "The arm stands and takes no goals before ~/resume.")
        if resumed:
            assert alone.call(Trigger, "~/resume").success
        judge.pass_on.set()
        outdated = (ABORTED, -1, outcome_sentence(Outcome.REFUSED_OUTDATED))
        for handle in handles:
            assert client.result(handle) == (outdated if resumed else HELD)
        assert alone.call(Trigger, "~/resume").success
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED
        assert len({goal_id for goal_id, _ in loop.records}) == 1


def test_a_hold_ends_a_goal_of_which_the_control_process_has_not_heard(arm_name):
    with serving_alone(arm_name) as (loop, front, client, _), person_at(arm_name) as alone:
        loop.taking = False
        handle = client.send(goal(seconds=5))
        until(lambda: not front.serving.idle, "a goal on its way")
        holding = alone.ask(Trigger, "~/hold")
        until(lambda: loop.command["hold_ns"][0], "a hold")
        loop.taking = True
        assert client.result(handle) == HELD
        until(holding.done, "the answer")
        assert holding.result().success and not loop.active


def test_while_a_goal_is_held_newer_ones_are_refused_and_it_goes_on(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        running = client.send(goal(seconds=1))
        until(lambda: loop.active, "motion")
        judge = SlowJudge(monkeypatch)
        newer = client.send(goal())
        until(judge.judging.is_set, "a goal being judged")
        answer = alone.call(Trigger, "~/hold")
        assert answer.success and "~/resume" in answer.message, answer.message
        judge.pass_on.set()
        assert client.result(newer) == HELD
        assert client.run(goal()) == HELD
        assert alone.call(Trigger, "~/resume").success
        assert client.result(running)[0] == SUCCEEDED


def test_a_goal_being_considered_when_the_arm_is_held_is_rejected(arm_name, monkeypatch):
    with serving_alone(arm_name, strict_reject=True) as (loop, _, client, _), person_at(arm_name) as alone:
        judge = SlowJudge(monkeypatch)
        answer = client.action.send_goal_async(goal())
        until(judge.judging.is_set, "a goal being judged")
        assert alone.call(Trigger, "~/hold").success
        assert alone.call(Trigger, "~/resume").success
        judge.pass_on.set()
        until(answer.done, "the answer to a goal")
        assert not answer.result().accepted
        assert not loop.records


def test_a_stop_ends_what_runs_and_what_comes_is_refused_before_a_resume(arm_name):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        running = client.send(goal(seconds=5))
        until(lambda: loop.active, "motion")
        answer = alone.call(Trigger, "~/stop")
        assert (answer.success, answer.message) == (True, "The arm stands and takes no goals before ~/resume.")
        assert client.result(running)[0] == ABORTED
        begun = len(loop.records)
        refused = outcome_sentence(Outcome.REFUSED_HELD)
        assert client.run(goal()) == (ABORTED, -1, refused)
        assert client.run(goal()) == (ABORTED, -1, refused)  # as a client does that tries again
        assert len(loop.records) == begun
        answer = alone.call(Trigger, "~/resume")
        assert (answer.success, answer.message) == (True, "The arm takes goals again.")
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED


def test_a_goal_that_was_there_when_a_person_stopped_the_arm_does_not_begin_after_the_resume(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        judge = SlowJudge(monkeypatch)
        handles = [client.send(goal(seconds=5)), client.send(goal())]
        until(judge.judging.is_set, "a goal being judged")
        assert alone.call(Trigger, "~/stop").success
        assert alone.call(Trigger, "~/resume").success
        judge.pass_on.set()
        for handle in handles:
            assert client.result(handle) == (ABORTED, -1, outcome_sentence(Outcome.REFUSED_OUTDATED))
        assert not loop.records
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED


def test_a_stop_ends_a_goal_that_the_front_still_keeps_back(arm_name):
    """One that is to begin later than the ring is filled ahead would begin after a resume."""
    with serving_alone(arm_name) as (loop, front, client, _), person_at(arm_name) as alone:
        later = goal()
        later.trajectory.header.stamp.sec = int(time.time()) + 60
        handle = client.send(later)
        until(lambda: not front.serving.idle, "a goal on its way")
        assert alone.call(Trigger, "~/stop").success
        assert client.result(handle) == (ABORTED, -1, outcome_sentence(Outcome.REFUSED_HELD))
        assert not loop.records


def test_at_the_end_a_goal_being_considered_is_rejected(arm_name, monkeypatch):
    with serving_alone(arm_name, strict_reject=True) as (_, front, client, thread):
        judge = SlowJudge(monkeypatch)
        answer = client.action.send_goal_async(goal())
        until(judge.judging.is_set, "a goal being judged")
        closer = threading.Thread(target=front.close, args=(5.0,))
        closer.start()
        until(answer.done, "the answer to a goal")
        assert not answer.result().accepted
        closer.join(5.0)
        assert not closer.is_alive() and not thread.is_alive() and not judge.pass_on.is_set()
        judge.pass_on.set()


def test_a_cancel_that_is_taken_with_a_considered_goal_does_not_wait_for_it(arm_name, monkeypatch):
    with serving_alone(arm_name, strict_reject=True) as (loop, front, client, _):
        running = client.send(goal(seconds=5))
        until(lambda: loop.active, "motion")
        judge = SlowJudge(monkeypatch)
        with monkeypatch.context() as patched:
            taken = pile_up(front._goals, patched)
            answer = client.action.send_goal_async(goal())
            running.cancel_goal_async()
            until(lambda: {"goal", "cancel"} in taken, "both at once")
            assert client.result(running)[0] == CANCELED
            assert not answer.done()
            judge.pass_on.set()
            until(answer.done, "the answer to a goal")
        assert answer.result().accepted
        assert client.result(answer.result())[0] == SUCCEEDED


def test_a_cancel_of_all_goals_means_the_one_that_is_taken_with_it(arm_name, monkeypatch):
    with serving_alone(arm_name) as (_, front, client, _):
        taken = pile_up(front._goals, monkeypatch)
        answer = client.action.send_goal_async(goal(seconds=5))
        everything = client.node.create_client(
            CancelGoal, f"/alone_{arm_name}/follow_joint_trajectory/_action/cancel_goal"
        )
        assert everything.wait_for_service(10.0)
        canceling = everything.call_async(CancelGoal.Request())
        until(canceling.done, "the answer to a cancel")
        assert {"goal", "cancel"} in taken and len(canceling.result().goals_canceling) == 1
        until(answer.done, "the answer to a goal")
        assert client.result(answer.result())[0] == CANCELED


def test_a_goal_that_strict_reject_considers_holds_up_no_cancel(arm_name, monkeypatch):
    with serving_alone(arm_name, strict_reject=True) as (loop, _, client, _):
        running = client.send(goal(seconds=5))
        until(lambda: loop.active, "motion")
        judge = SlowJudge(monkeypatch)
        answer = client.action.send_goal_async(goal())
        until(judge.judging.is_set, "a goal being judged")
        running.cancel_goal_async()
        assert client.result(running)[0] == CANCELED
        assert not answer.done()
        judge.pass_on.set()
        until(answer.done, "the answer to a goal")
        assert answer.result().accepted


def test_a_defect_in_judging_ends_the_goal_and_no_more(arm_name, monkeypatch):
    with serving_alone(arm_name) as (_, _, client, _):
        with monkeypatch.context() as patched:
            patched.setattr(node, "plan_goal", lambda *_: 1 / 0)
            assert client.run(goal())[0] == ABORTED
        assert client.run(goal())[0] == SUCCEEDED


def test_the_end_does_not_wait_for_a_goal_being_judged(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, front, client, thread):
        judge = SlowJudge(monkeypatch)
        handle = client.send(goal())
        until(judge.judging.is_set, "a goal being judged")
        closer = threading.Thread(target=front.close, args=(5.0,))
        closer.start()
        status, _, words = client.result(handle)
        assert status == ABORTED and words.startswith("The ROS process is shutting down and takes no goals")
        closer.join(5.0)
        assert not closer.is_alive() and not thread.is_alive() and not judge.pass_on.is_set()
        judge.pass_on.set()
        assert not loop.records


def test_at_the_end_a_client_that_asks_late_still_gets_its_result(arm_name):
    with serving_alone(arm_name) as (loop, front, client, thread):
        handle = client.send(goal(seconds=30))
        until(lambda: loop.active, "motion")
        closer = threading.Thread(target=front.close, args=(5.0,))
        closer.start()
        until(lambda: not loop.active, "the stop on the path")
        until(lambda: front.serving.idle, "the verdict")
        status, _, words = client.result(handle)
        assert status == ABORTED and words.startswith("The ROS process was stopped: the arm is at rest")
        closer.join(5.0)
        assert not thread.is_alive() and not closer.is_alive()


def test_a_goal_that_comes_at_the_end_is_told_why_it_is_not_begun(arm_name):
    with serving_alone(arm_name) as (loop, front, client, _):
        front.serving.close()
        status, _, words = client.run(goal())
        assert status == ABORTED and words.startswith("The ROS process is shutting down and takes no goals")
        assert not loop.records


def test_a_client_that_never_asks_holds_up_the_end_for_a_moment_only(arm_name, monkeypatch):
    monkeypatch.setattr(action, "RESULT_GRACE_S", 0.05)
    with serving_alone(arm_name) as (loop, front, client, thread):
        client.send(goal(seconds=30))
        until(lambda: loop.active, "motion")
        front.close(5.0)
        thread.join(5.0)
        assert not thread.is_alive() and not loop.active


def test_an_arm_that_does_not_stop_does_not_hold_up_the_end(arm_name):
    with serving_alone(arm_name) as (loop, front, client, thread):
        handle = client.send(goal(seconds=30))
        until(lambda: loop.active, "motion")
        loop.taking = False
        closer = threading.Thread(target=front.close, args=(0.1,))
        closer.start()
        status, _, words = client.result(handle)
        assert (status, words) == (ABORTED, "The ROS process was stopped before the arm had come to rest.")
        closer.join(5.0)
        assert not thread.is_alive()


# --- the process ---


@pytest.fixture
def loop(arm_file):
    """A loop for the arm of `arm_file`."""
    loop = FakeLoop(load_arm(arm_file))
    yield loop
    loop.stop()


@pytest.fixture
def start_front():
    """Starts front processes, and ends those that a failed test leaves."""
    started = []

    def start(*arguments, **environment):
        clean = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
        front = subprocess.Popen(
            [sys.executable, "-m", "rosfront", *map(str, arguments)],
            cwd=ROOT,
            env=clean | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(front)
        return front

    yield start
    for front in started:
        if front.poll() is None:
            front.kill()
        print(*front.communicate())  # what it said stands in the report of a test that failed


@pytest.fixture
def arm_file(arm_name, tmp_path):
    values = yaml.safe_load((ROOT / "config" / "arms" / "mock.yaml").read_text())
    values["name"] = arm_name
    values.setdefault("front", {})["controller_name"] = "process_controller"
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def ended(front):
    out, err = front.communicate(timeout=20)
    return front.returncode, out, err


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_the_process_ends_orderly_in_the_middle_of_a_goal(arm_file, loop, start_front, end):
    loop.start()
    front = start_front(arm_file)
    assert front.stdout.readline() == "ready /process_controller/follow_joint_trajectory\n"
    client = Client("process_controller")
    handle = client.send(goal(seconds=30))
    until(lambda: loop.active, "motion")
    second = start_front(arm_file)
    code, _, err = ended(second)
    assert code == 1 and err.startswith("Another front already serves arm")
    front.send_signal(end)
    status, _, words = client.result(handle)
    assert status == ABORTED
    assert words.startswith("The ROS process was stopped: the arm is at rest and has not left its path; joint1 is")
    assert ended(front)[0] == 0
    client.close()


def test_the_process_waits_for_a_loop_without_a_word(arm_file, start_front):
    front = start_front(arm_file)
    until(lambda: hears_sigterm(front), "a front that has looked for its loop")
    loop = FakeLoop(load_arm(arm_file))
    loop.start()
    assert front.stdout.readline().startswith("ready ")
    front.terminate()
    code, _, err = ended(front)
    assert code == 0 and len(err.splitlines()) == 1 and "Attached to the control process" in err
    loop.stop()


def hears_sigterm(front):
    """Whether the process has come as far as handling SIGTERM itself."""
    status = Path(f"/proc/{front.pid}/status").read_text()
    caught = next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def test_the_process_ends_orderly_before_it_is_ready(arm_file, start_front):
    front = start_front(arm_file)
    until(lambda: hears_sigterm(front), "a front that handles signals")
    front.terminate()
    assert ended(front) == (0, "", "")


@pytest.mark.parametrize("ends", [(signal.SIGTERM,) * 3, (signal.SIGINT, signal.SIGTERM)])
def test_signals_in_quick_succession_are_one(arm_file, loop, start_front, ends):
    loop.start()
    front = start_front(arm_file)
    assert front.stdout.readline().startswith("ready ")
    client = Client("process_controller")
    handle = client.send(goal(seconds=30))
    until(lambda: loop.active, "motion")
    result = handle.get_result_async()
    for end in ends:
        front.send_signal(end)
    until(result.done, "a result")
    front.send_signal(ends[0])  # in the very last moments
    assert result.result().status == ABORTED
    assert result.result().result.error_string.startswith("The ROS process was stopped")
    code, _, err = ended(front)
    assert code == 0 and "Traceback" not in err
    client.close()


def test_a_bad_parameter_ends_the_start_with_one_sentence(arm_file, loop, start_front):
    loop.start()
    code, out, err = ended(start_front(arm_file, "--ros-args", "-p", "constraints.goal_time:=-1.0"))
    assert (code, out) == (1, "")
    assert err == ("Parameter constraints.goal_time is -1, and allowed are 0 to 86400: give a value between them.\n")


def test_an_initial_speed_scale_is_for_a_control_process_that_has_none(arm_file, start_front):
    """The front may be there first; and who has slowed the arm down meanwhile is not overruled by a restart."""
    front = start_front(arm_file, "--ros-args", "-p", "speed_scaling.initial_scaling_factor:=0.5")
    until(lambda: hears_sigterm(front), "a front that has looked for its loop")
    loop = FakeLoop(load_arm(arm_file))
    loop.start()
    until(lambda: loop.snapshot["speed_scale_asked"] == 0.5, "the initial factor")
    front.terminate()
    assert ended(front)[0] == 0
    loop.command["speed_scale"][0] = 0.25
    until(lambda: loop.snapshot["speed_scale_asked"] == 0.25, "the slower one")
    loop.asked.clear()
    front = start_front(arm_file, "--ros-args", "-p", "speed_scaling.initial_scaling_factor:=0.5")
    assert front.stdout.readline().startswith("ready ")
    front.terminate()
    assert ended(front)[0] == 0
    assert loop.snapshot["speed_scale_asked"] == 0.25 and not loop.asked
    loop.stop()


def test_what_keeps_the_process_from_serving_is_one_sentence(arm_file, loop, start_front, tmp_path):
    code, out, err = ended(start_front("no_such_arm"))
    assert (code, out) == (1, "") and err.count("\n") == 1 and "no_such_arm" in err
    (tmp_path / "stubs").mkdir()
    (tmp_path / "stubs" / "control_msgs.py").write_text("raise ImportError('no control_msgs')")
    search = os.pathsep.join(filter(None, [str(tmp_path / "stubs"), os.environ.get("PYTHONPATH")]))
    code, out, err = ended(start_front(arm_file, PYTHONPATH=search))
    assert (code, out) == (1, "")
    assert err == (
        "ROS 2 is not usable here (no control_msgs): source a ROS 2 Jazzy installation that has "
        "control_msgs, or run `make env` for the wheels.\n"
    )


def test_without_robot_arm_interfaces_the_arm_has_everything_else(arm_name, monkeypatch, capfd):
    for name in ("robot_arm_interfaces", "robot_arm_interfaces.action"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "rosfront.full_node.node", raising=False)
    with serving_alone(arm_name) as (_, front, client, _):
        assert client.run(goal())[0] == SUCCEEDED
        assert front._full_node is None
    assert node.WITHOUT_FULL_NODE in capfd.readouterr().err


def test_motor_angles_become_a_message_only_for_whoever_listens(arm_name, monkeypatch):
    interfaces = pytest.importorskip("robot_arm_interfaces.msg")
    from rosfront.full_node import node as full_node

    with serving_alone(arm_name) as (_, front, _, _):
        built = []
        monkeypatch.setattr(full_node, "MotorAngles", lambda **fields: built.append(interfaces.MotorAngles(**fields)))
        monkeypatch.setattr(front._full_node, "_publisher", Unheard())
        before = front.pulse.published
        until(lambda: front.pulse.published > before + 30, "readings")
        assert front._full_node._last.stamp_ns > 0 and not built
        front._full_node._publisher.listeners = 1
        until(lambda: built, "a message for the one who listens")


class Unheard:
    """A publisher nobody listens to, until somebody does."""

    listeners = 0

    def get_subscription_count(self):
        return self.listeners

    def publish(self, message):
        pass
