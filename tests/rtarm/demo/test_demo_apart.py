"""The demo beside an arm of the same file in the same ROS domain: neither reaches the other."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from waiting import until

pytest.importorskip("rclpy")

from ros_client import SUCCEEDED, Client, names_seen, recorded
from stack import Process

from rtarm.running.status import read_status
from shm import files

pytestmark = pytest.mark.process

PATIENCE_S = 90.0
DEMO_HERE = (
    f"from rtarm.launch import own_domain; own_domain.DOMAINS = ({os.environ['ROS_DOMAIN_ID']},); "
    "from rtarm.cli.application import app; app()"
)
"""The command line, but for the demo's choice of a domain."""


@pytest.fixture
def standing(mock_file: Path) -> Iterator[Process]:
    """An arm that nobody means to move."""
    process = Process("rtarm", "up", str(mock_file), needs_ros=True)
    process.line_with("front  ready, action /episode_arm_controller/follow_joint_trajectory")
    yield process
    process.close()


@pytest.fixture
def moveit(standing: Process) -> Iterator[Client]:
    """The client of the standing arm."""
    client = Client("episode_arm_controller")
    yield client
    client.close()


@pytest.fixture
def demo(moveit: Client, mock_file: Path) -> Iterator[subprocess.Popen[str]]:
    """The demo of the same file, started when the other arm and its client are there."""
    command = [sys.executable, "-c", DEMO_HERE, "demo", "--arm", str(mock_file)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    yield process
    process.terminate()
    process.wait(PATIENCE_S)
    process.stdout.close()


def test_the_demo_moves_its_own_arm_and_a_goal_for_the_other_that_one(
    demo: subprocess.Popen[str], moveit: Client, arm_name: str
) -> None:
    def playing() -> bool:
        arms = [arm for arm in files.running_arms() if arm.startswith(f"{arm_name}_demo_")]
        return any(read_status(arm)["mode"] == "executing" for arm in arms)

    until(playing, "a goal of the demo", PATIENCE_S, of=demo)
    before = read_status(arm_name)
    assert (before["mode"], before["last_result"]) == ("holding", None)
    node = moveit.node
    until(
        lambda: any(name.startswith(f"/{arm_name}_demo_") for name in names_seen(node)), "its node", PATIENCE_S, of=demo
    )
    assert node.get_node_names_and_namespaces().count(("episode_arm_controller", "/")) == 1
    for topic in ("joint_states", "dynamic_joint_states", "diagnostics"):
        assert node.count_publishers(f"/{topic}") == 1, topic
    goal = recorded("small")
    assert moveit.run(goal)[:2] == (SUCCEEDED, 0)
    said, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 0, said
    assert "4 of 4 goals succeeded" in said
    after = read_status(arm_name)
    assert after["last_result"]["goal_id"] == 1  # it has had no other
    where_rad = np.array([message.position for _, message in moveit.states])
    on_the_way_rad = np.array([point.positions for point in goal.trajectory.points])
    assert (where_rad >= on_the_way_rad.min(0) - 1e-3).all() and (where_rad <= on_the_way_rad.max(0) + 1e-3).all()
