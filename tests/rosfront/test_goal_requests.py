"""Goals taken as bytes beside the executor's thread: what a goal that is long in coming holds up, and what ends it."""

import contextlib
import threading
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from action_msgs.srv import CancelGoal
from control_msgs.action import FollowJointTrajectory
from front_stage import SlowJudge, goal, serving_alone
from rclpy.action.client import ClientGoalHandle
from ros_client import ABORTED, CANCELED, SUCCEEDED, Operator
from std_srvs.srv import Trigger
from waiting import until

from rosfront import action, goal_requests
from rosfront.goal_requests import GoalFunctions, Request, Unavailable
from rosfront.serving import NEVER_BEGUN
from sentences.told import outcome_sentence
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


def test_a_request_that_cannot_be_taken_is_told_and_the_next_one_is_served(arm_name, monkeypatch):
    with serving_alone(arm_name) as (_, front, client, _):
        said = []
        with monkeypatch.context() as patched:
            patched.setattr(GoalFunctions, "_serialised", _no_memory)
            patched.setattr(front._goals._server._requests, "_say", said.append)  # capfd loses what is said as it reads
            sent(client, goal())
            until(lambda: said, "a sentence")
        assert "there is no memory for it" in said[0]
        assert client.run(goal())[0] == SUCCEEDED


def _no_memory(*_):
    raise MemoryError


def test_a_goal_whose_client_cannot_be_told_is_over_and_the_next_one_is_served(arm_name, monkeypatch):
    with serving_alone(arm_name) as (loop, front, client, _):
        with monkeypatch.context() as patched:
            patched.setattr(GoalFunctions, "answer", _unreachable)
            sent(client, goal(seconds=5))
            until(lambda: front._goals._server._goal_handles, "a goal that was accepted")
            (kept,) = front._goals._server._goal_handles.values()
            until(lambda: not kept.is_active, "its end")
        accepted = FollowJointTrajectory.Impl.SendGoalService.Response(accepted=True)
        status, _, words = client.result(ClientGoalHandle(client.action, kept.goal_id, accepted))
        assert status == ABORTED and "could not be told that it was accepted (nobody there)" in words
        assert not loop.records
        assert client.run(goal())[0] == SUCCEEDED


class DeafClient:
    """The server knows where its client hears answers when `heard` is set; `missed` counts answers before that."""

    def __init__(self, monkeypatch):
        self.heard, self.missed = threading.Event(), 0
        answer = GoalFunctions.answer

        def missing(functions, *message):
            if not self.heard.is_set():
                self.missed += 1
                self.heard.wait(0.02)  # the middleware's patience
                _unreachable()
            answer(functions, *message)

        monkeypatch.setattr(GoalFunctions, "answer", missing)

    @staticmethod
    def in_rclpy(monkeypatch, times):
        """Where rclpy takes the goals: a list of the answers that were missed, of which so many are."""
        missed, take_in = [], action._TellingServer._take_in

        async def deaf(server, goal_id, message, answer):
            def missing(response):
                if len(missed) < times:
                    missed.append(response)
                    _unreachable()
                answer(response)

            await take_in(server, goal_id, message, missing)

        monkeypatch.setattr(action._TellingServer, "_take_in", deaf)
        return missed


def test_a_client_that_the_server_does_not_know_yet_is_answered_again_and_others_are_served(arm_name, monkeypatch):
    with serving_alone(arm_name) as (_, _, client, _), person_at(arm_name) as alone:
        deaf = DeafClient(monkeypatch)
        monkeypatch.setattr(action, "ANSWER_TRIES", 1_000)
        answer = sent(client, goal())
        until(lambda: deaf.missed, "a first answer")
        assert alone.get_parameters("constraints.goal_time") == [0.4]
        deaf.heard.set()
        assert result(client, answer)[0] == SUCCEEDED


@pytest.mark.parametrize(("reached", "tries"), [(True, 1_000), (False, 20)])
def test_a_goal_that_is_canceled_before_its_client_is_told_of_it_does_not_begin(arm_name, monkeypatch, reached, tries):
    with serving_alone(arm_name) as (loop, front, client, _):
        with monkeypatch.context() as patched:
            deaf = DeafClient(patched)
            patched.setattr(action, "ANSWER_TRIES", tries)
            answer = sent(client, goal(seconds=5))
            until(lambda: deaf.missed, "a first answer")
            (kept,) = front._goals._server._goal_handles.values()
            accepted = FollowJointTrajectory.Impl.SendGoalService.Response(accepted=True)
            known = ClientGoalHandle(client.action, kept.goal_id, accepted)
            canceling = known.cancel_goal_async()
            until(canceling.done, "the answer to a cancel")
            if reached:
                deaf.heard.set()
                assert result(client, answer) == (CANCELED, 0, NEVER_BEGUN)
            else:
                status, _, words = client.result(known)
                assert status == ABORTED and "could not be told that it was accepted (nobody there)" in words
        assert not loop.records
        assert client.run(goal())[0] == SUCCEEDED


def test_a_question_for_an_unknown_goal_that_cannot_be_answered_ends_nothing(arm_name, monkeypatch, capfd):
    with serving_alone(arm_name) as (_, front, client, thread):
        handle = SimpleNamespace(send_result_response=_unreachable)
        with monkeypatch.context() as patched:
            patched.setattr(front._goals._server, "_handle", handle)
            request = FollowJointTrajectory.Impl.GetResultService.Request()
            asked = front._goals._server._execute_get_result_request((None, request))
            with pytest.raises(StopIteration):
                asked.send(None)
        assert "was not answered: nobody there" in capfd.readouterr().err
        assert thread.is_alive() and client.run(goal())[0] == SUCCEEDED


def _unreachable(*_):
    raise RuntimeError("nobody there")


def test_of_two_goals_with_one_id_that_are_considered_at_once_one_is_taken(arm_name, monkeypatch, capfd):
    with serving_alone(arm_name, strict_reject=True) as (loop, front, client, thread):
        judge = SlowJudge(monkeypatch)
        twin = Request(goal=goal())
        twin.goal_id.uuid = np.full(16, 7, np.uint8)
        for _ in range(2):
            client.action._client_handle.send_goal_request(twin)
        until(lambda: len(front._action_goals._considered) == 2, "two goals being considered")
        judge.pass_on.set()
        until(lambda: front._goals.counts.goals_succeeded == 1, "the end of one")
        assert "another with its id was accepted meanwhile" in capfd.readouterr().err
        assert thread.is_alive() and len({number for number, _ in loop.records}) == 1
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED


def test_a_flood_of_goals_does_not_keep_the_front_from_ending(arm_name):
    with serving_alone(arm_name) as (loop, front, client, thread):
        flooded = threading.Event()

        def flood():
            message = Request(goal=goal(seconds=5))
            while not flooded.is_set():
                message.goal_id.uuid = np.random.default_rng().integers(256, size=16, dtype=np.uint8)
                client.action._client_handle.send_goal_request(message)

        sender = threading.Thread(target=flood)
        sender.start()
        until(lambda: loop.active, "motion")
        closer = threading.Thread(target=front.close, args=(1.0,))
        closer.start()
        closer.join(10.0)
        still_there = closer.is_alive() or thread.is_alive()
        flooded.set()
        for each in (sender, closer):
            each.join(10.0)
        assert not still_there


def test_goals_of_other_actions_do_not_keep_the_front_from_ending(arm_name):
    """Their servers are not stopped, and a client that sends without a pause keeps one busy; here one always is."""
    with serving_alone(arm_name) as (_, front, _, thread):
        idle, front._goals._idle = front._goals._idle, lambda: False
        closer = threading.Thread(target=front.close, args=(0.5,))
        closer.start()
        closer.join(10.0)
        still_there = closer.is_alive() or thread.is_alive()
        front._goals._idle = idle
        assert not still_there


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
        missed = DeafClient.in_rclpy(monkeypatch, 3)
        assert client.run(goal())[0] == SUCCEEDED and len(missed) == 3
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
