"""Goals taken as bytes beside the executor's thread: what a goal that is long in coming holds up, and what ends it."""

import contextlib
import threading

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from action_msgs.srv import CancelGoal
from front_stage import goal, serving_alone
from ros_client import ABORTED, CANCELED, SUCCEEDED, Operator
from std_srvs.srv import Trigger
from waiting import until

from rosfront import action, goal_requests
from rosfront.goal_requests import GoalFunctions, Unavailable
from rosfront.serving import NEVER_BEGUN
from shm.sentences import outcome_sentence
from shm.words import Outcome

pytestmark = pytest.mark.process  # a real client, real threads, real time


class SlowMiddleware:
    """Requests are handed over when they are let pass; `taking` is set while one is not."""

    def __init__(self, monkeypatch):
        self.taking, self.pass_on = threading.Event(), threading.Event()
        take = GoalFunctions.take

        def slow(functions, server):
            found = take(functions, server)
            if found is not None:
                self.taking.set()
                assert self.pass_on.wait(20.0)
            return found

        monkeypatch.setattr(GoalFunctions, "take", slow)


def person_at(arm_name):
    return contextlib.closing(Operator(f"alone_{arm_name}"))


def sent(client, message):
    """The future of the answer to a goal."""
    return client.action.send_goal_async(message)


def result(client, answer):
    until(answer.done, "the answer to a goal")
    assert answer.result().accepted
    return client.result(answer.result())


def test_while_a_goal_is_being_taken_others_are_served(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        running = client.send(goal(seconds=5))
        until(lambda: loop.active, "motion")
        middleware = SlowMiddleware(monkeypatch)
        answers = [sent(client, goal()), sent(client, goal(to_rad=0.02))]
        until(middleware.taking.is_set, "a goal being taken")
        assert alone.get_parameters("constraints.goal_time") == [0.4]
        canceling = running.cancel_goal_async()
        until(canceling.done, "the answer to a cancel")
        assert client.result(running)[0] == CANCELED
        assert not any(answer.done() for answer in answers)
        middleware.pass_on.set()
        result(client, answers[0])  # that may be replaced before it has begun
        assert result(client, answers[1])[0] == SUCCEEDED
        assert loop.rows["commanded_position_rad"] == pytest.approx(0.02)


@pytest.mark.parametrize("service", ["~/stop", "~/hold"])
def test_a_goal_that_was_being_taken_when_a_person_stopped_the_arm_does_not_begin(arm_name, monkeypatch, service):
    """Nor one that waited in the middleware behind it."""
    with serving_alone(arm_name) as (loop, _, client, _), person_at(arm_name) as alone:
        middleware = SlowMiddleware(monkeypatch)
        answers = [sent(client, goal(seconds=5)), sent(client, goal(seconds=5))]
        until(middleware.taking.is_set, "a goal being taken")
        assert alone.call(Trigger, service).success
        assert alone.call(Trigger, "~/resume").success
        middleware.pass_on.set()
        for answer in answers:
            assert result(client, answer) == (ABORTED, -1, outcome_sentence(Outcome.REFUSED_OUTDATED))
        assert not loop.records
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED


@pytest.mark.parametrize("strict_reject", [False, True])
def test_a_cancel_of_all_goals_means_those_that_are_being_taken(arm_name, monkeypatch, strict_reject):
    with serving_alone(arm_name, strict_reject=strict_reject) as (loop, _, client, _):
        everything = client.node.create_client(
            CancelGoal, f"/alone_{arm_name}/follow_joint_trajectory/_action/cancel_goal"
        )
        assert everything.wait_for_service(10.0)
        middleware = SlowMiddleware(monkeypatch)
        answers = [sent(client, goal(seconds=5)), sent(client, goal(seconds=5))]
        until(middleware.taking.is_set, "a goal being taken")
        canceling = everything.call_async(CancelGoal.Request())
        until(canceling.done, "the answer to a cancel")
        middleware.pass_on.set()
        for answer in answers:
            assert result(client, answer) == (CANCELED, 0, NEVER_BEGUN)
        assert not loop.records
        assert client.run(goal())[0] == SUCCEEDED


def test_a_cancel_of_another_goal_does_not_mean_those_that_are_being_taken(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, _, client, _):
        running = client.send(goal(seconds=5))
        until(lambda: loop.active, "motion")
        middleware = SlowMiddleware(monkeypatch)
        answer = sent(client, goal())
        until(middleware.taking.is_set, "a goal being taken")
        running.cancel_goal_async()
        assert client.result(running)[0] == CANCELED
        middleware.pass_on.set()
        assert result(client, answer)[0] == SUCCEEDED


def test_the_end_answers_a_goal_that_is_being_taken(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, front, client, thread):
        middleware = SlowMiddleware(monkeypatch)
        answer = sent(client, goal())
        until(middleware.taking.is_set, "a goal being taken")
        closer = threading.Thread(target=front.close, args=(5.0,))
        closer.start()
        middleware.pass_on.set()
        status, _, words = result(client, answer)
        assert status == ABORTED and words.startswith("The ROS process is shutting down and takes no goals")
        closer.join(10.0)
        assert not closer.is_alive() and not thread.is_alive() and not loop.records


def test_a_request_that_cannot_be_taken_is_told_and_the_next_one_is_served(arm_name, monkeypatch, capfd):
    with serving_alone(arm_name) as (_, _, client, _):
        with monkeypatch.context() as patched:
            patched.setattr(GoalFunctions, "_serialised", _no_memory)
            sent(client, goal())
            until(lambda: "there is no memory for it" in capfd.readouterr().err, "a sentence")
        assert client.run(goal())[0] == SUCCEEDED


def _no_memory(*_):
    raise MemoryError


def test_a_goal_that_has_ended_keeps_no_bytes(arm_name):
    with serving_alone(arm_name) as (_, front, client, _):
        handle = client.send(goal())
        assert client.result(handle)[0] == SUCCEEDED
        (kept,) = front._goals._server._goal_handles.values()
        until(lambda: kept.request is None, "a goal without its request")


def test_without_the_functions_goals_are_taken_by_rclpy(arm_name, monkeypatch, capfd):
    def missing(_):
        raise Unavailable("no such function")

    monkeypatch.setattr(action.GoalFunctions, "__init__", missing)
    with serving_alone(arm_name) as (_, front, client, _):
        assert "does not let goals be taken as bytes (no such function)" in capfd.readouterr().err
        assert client.run(goal())[0] == SUCCEEDED
        handle = client.send(goal(names=["elbow"]))
        assert client.result(handle)[:2] == (ABORTED, -2)
        assert not isinstance(front._goals._server, action._UnlockedServer)


@pytest.mark.parametrize("lacking", ["rcl_action_take_goal_request", "rmw_serialize"])
def test_a_library_without_a_function_is_said_to_lack_it(monkeypatch, lacking):
    real = goal_requests.ctypes.CDLL

    class Lacking(real):
        def __getitem__(self, name):
            if name == lacking:
                raise AttributeError(f"undefined symbol: {name}")
            return super().__getitem__(name)

    monkeypatch.setattr(goal_requests.ctypes, "CDLL", Lacking)
    with pytest.raises(Unavailable, match=lacking):
        GoalFunctions()


def test_bytes_of_another_form_are_noticed_before_a_goal_comes(monkeypatch):
    monkeypatch.setattr(GoalFunctions, "_serialised", lambda *_: np.zeros(200, np.uint8))
    with pytest.raises(Unavailable, match="another form"):
        GoalFunctions()
