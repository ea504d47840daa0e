"""A sample of the trials that kill ROS processes; the long run is `make ros-trials` (docs/explanation/testing.md)."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from observer import judge
from trial_run import run_trials

SEED = "378"
"""A node that starts beside a full /dev/shm (as root), the front, a node that runs."""


@pytest.mark.process
def test_whichever_ros_process_is_killed_the_others_go_on() -> None:
    code, said = run_trials("ros_trials", "--trials", "3", "--seed", SEED)
    print(said)
    judge([line.strip() for line in said.splitlines() if line.strip().startswith("VIOLATION ")])
    assert code == 0, said
    assert "Violations: 0" in said
