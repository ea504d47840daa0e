"""Demo mode: `rtarm up` with mock drives is what the tutorial's demo publishes, by the program that drives the arm."""

from __future__ import annotations

import math
import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from ros_client import SUCCEEDED, Client, recorded
from stack import Process
from waiting import until

pytestmark = pytest.mark.process


def test_the_demo_publishes_at_100_hz_and_plays_a_goal(mock_file: Path) -> None:
    with closing(Process("rtarm", "up", str(mock_file), needs_ros=True)) as up:
        up.line_with("rtarm  running")
        assert "at 100 Hz without a bus (mock drives)" in up.text
        with closing(Client()) as client:
            until(lambda: len(client.states) > 200, "two seconds of joint states")
            states = [state for _, state in client.states]
            stamps = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in states]
            # The median, since a shared machine may suspend the whole process for a while.
            assert np.median(np.diff(stamps)) == pytest.approx(0.01, rel=0.05)
            assert {state.header.frame_id for state in states} == {"base_link"}
            for state in states:
                assert list(state.name) == [f"joint{n}" for n in range(1, 7)]
                assert (list(state.position), list(state.velocity)) == ([0.0] * 6, [0.0] * 6)
                assert len(state.effort) == 6 and all(map(math.isnan, state.effort))

            goal = recorded("small")
            client.states.clear()
            status, code, words = client.run(goal)
            assert (status, code) == (SUCCEEDED, 0), words
            assert any(any(state.velocity) for _, state in client.states)
            client.states.clear()
            until(lambda: client.states and not any(client.states[-1][1].velocity), "rest")
            last = list(goal.trajectory.points[-1].positions)
            assert list(client.states[-1][1].position) == pytest.approx(last, abs=1e-3)
        up.process.send_signal(signal.SIGINT)
        assert up.code() == 0
