"""What a goal's end does, in its order: who asked for the result has it before anything is logged, and it expires."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from front_stage import goal, serving_alone
from rclpy.exceptions import InvalidHandle
from ros_client import ABORTED, CANCELED, SUCCEEDED
from waiting import until

from rosfront import action

pytestmark = pytest.mark.process  # a real client, real threads, real time


def in_order(front, monkeypatch):
    """What happens from now on at the end of goals: that a result is sent, and that something is logged."""
    happened, server, log = [], front._goals._server, front._goals._log
    sent = server._on_sent
    monkeypatch.setattr(server, "_on_sent", lambda goal: (sent(goal), happened.append("sent")))
    for severity in ("info", "warning"):
        monkeypatch.setattr(log, severity, lambda said, severity=severity: happened.append((severity, said)))
    return happened


def reached(loop, client):
    return client.send(goal())


def canceled(loop, client):
    handle = client.send(goal(seconds=5))
    until(lambda: loop.active, "motion")
    handle.cancel_goal_async()
    return handle


def aborted(loop, client):
    handle = client.send(goal(seconds=5))
    until(lambda: loop.active, "motion")
    loop.die()
    return handle


@pytest.mark.parametrize(
    "end, status, logged", [(reached, SUCCEEDED, "info"), (canceled, CANCELED, "info"), (aborted, ABORTED, "warning")]
)
def test_a_result_is_sent_before_anything_is_logged_of_it(arm_name, monkeypatch, end, status, logged):
    with serving_alone(arm_name) as (loop, front, client, _):
        happened = in_order(front, monkeypatch)
        handle = end(loop, client)
        found, _, words = client.result(handle)
        assert found == status, words
        until(lambda: len(happened) == 2, "a line in the log")
        sent, (severity, said) = happened
        assert (sent, severity) == ("sent", logged) and said.endswith(words)
        assert not front._goals._to_log


def test_a_result_that_is_kept_no_longer_is_forgotten_and_goals_are_served_on(arm_name, monkeypatch):
    monkeypatch.setattr(action, "RESULT_KEPT_S", 1)
    with serving_alone(arm_name) as (_, front, client, thread):
        assert client.run(goal())[0] == SUCCEEDED
        until(lambda: not front._goals._server._goal_handles, "the end of what is kept of it")
        assert not front._goals._server._result_futures
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED
        assert thread.is_alive()


def test_a_result_that_cannot_be_sent_for_a_defect_is_not_passed_over():
    """rclpy's own futures would only warn of what their callbacks raise."""
    told, result = [], action._Result()
    result.add_done_callback(lambda future: told.append(future.result()))
    result.add_done_callback(lambda future: (_ for _ in ()).throw(InvalidHandle("a defect")))
    with pytest.raises(InvalidHandle, match="a defect"):
        result.set_result("done")
    assert told == ["done"]
