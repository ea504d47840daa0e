"""A sample of the trials of process faults; `docs/explanation/testing.md` tells the long run."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from fault_rig import environment_of
from observer import judge
from trial_run import run_trials

from rtarm.recording.folder import folder

SAMPLE = (
    "up loop: kill -9",
    "up loop: SIGSTOP 0.1–1 s",
    "bare loop: SIGTERM",
    "up front: kill -9",
    "up front: no memory",
    "up launcher: kill -9",
    "up sim: kill -9",
    "up all: full /dev/shm",
    "up front: kill -9, a client asks again",
    "up person: rtarm stop, beside replacing",
    "up person: ~/stop, beside flood",
    "up person: rtarm stop while a process that asks is suspended, beside stream",
)


@pytest.mark.process
def test_whatever_happens_to_a_process_the_arm_stops_and_comes_back() -> None:
    chosen = [argument for kind in SAMPLE for argument in ("--only", kind)]
    code, said = run_trials("process_trials", "--trials", str(len(SAMPLE)), *chosen)
    print(said)
    judge([line.strip() for line in said.splitlines() if line.strip().startswith("VIOLATION ")])
    assert code == 0, said
    assert "Violations: 0" in said


@pytest.mark.process
def test_trials_that_do_not_exist_are_a_sentence() -> None:
    assert run_trials("process_trials", "--only", "up moon") == (
        2,
        "No trial is called 'up moon' here: see tests/process_faults.py.\n",
    )


def test_recordings_of_trials_are_none_of_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/home/somebody/.local/state")
    for name, value in environment_of(tmp_path).items():
        monkeypatch.setenv(name, value)
    assert folder().is_relative_to(tmp_path)
