"""A result is kept for those who ask late, and then given up."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from front_stage import goal, serving_alone
from ros_client import SUCCEEDED
from waiting import until

from rosfront import action

pytestmark = pytest.mark.process  # a real client, real threads, real time


def test_a_result_that_is_kept_no_longer_is_forgotten_and_goals_are_served_on(arm_name, monkeypatch):
    monkeypatch.setattr(action, "RESULT_KEPT_S", 1)
    with serving_alone(arm_name) as (_, front, client, thread):
        assert client.run(goal())[0] == SUCCEEDED
        until(lambda: not front._goals._server._goal_handles, "the end of what is kept of it")
        assert not front._goals._server._result_futures
        assert client.run(goal(to_rad=0.02))[0] == SUCCEEDED
        assert thread.is_alive()
