"""A sample of the trials of process faults; `docs/testing.md` tells the long run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

ROOT = Path(__file__).parents[1]
SAMPLE = (
    "up loop: kill -9",
    "up loop: SIGSTOP 0.1–1 s",
    "bare loop: SIGTERM",
    "up front: kill -9",
    "up front: no memory",
    "up launcher: kill -9",
    "up sim: kill -9",
    "up all: full /dev/shm",
)


@pytest.mark.process
@pytest.mark.timeout(300)
def test_whatever_happens_to_a_process_the_arm_stops_and_comes_back() -> None:
    chosen = [argument for kind in SAMPLE for argument in ("--only", kind)]
    command = [sys.executable, "-m", "process_trials", "--trials", str(len(SAMPLE)), *chosen]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    print(result.stdout)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Violations: 0" in result.stdout
