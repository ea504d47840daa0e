"""A program of the arm's own user runs wild in its command file: the arm stops inside its limits, the loop lives on."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

import vandal
from observer import judge, motion_violations, stands_since_ns
from ros_client import ABORTED, recorded
from stack import ROOT
from waiting import until

from config.loader import load_arm
from shm import files
from shm.client import StateReader
from shm.words import Fault, Mode

pytestmark = pytest.mark.process

WILD_S = 3.0


@pytest.fixture
def stack(served_at):
    return served_at(recorded("large").trajectory.points[0].positions)


def test_garbage_all_over_the_command_file_of_a_moving_arm(stack):
    arm, client = load_arm(stack.arm_file), stack.client
    path = files.command_path(stack.name)
    reader = StateReader(files.open_state(stack.name))
    begun_ns = time.monotonic_ns()
    handle = client.send(recorded("large"))
    until(lambda: np.abs(reader.snapshot()["joints"]["commanded_velocity_rad_s"]).max() > 0.2, "motion")
    wild = subprocess.Popen(
        [sys.executable, vandal.__file__, str(path), str(WILD_S), "1"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert wild.stdout.readline() == "writing\n"
        state, _, words = client.result(handle)
        assert wild.wait(60.0) == 0
    finally:
        wild.kill()
        wild.stdout.close()
        wild.wait()
    assert state == ABORTED and words.endswith("."), words
    until(lambda: reader.snapshot()["mode"] == Mode.FAULT, "a latched fault")
    # On a busy machine the drives may be late before the garbage is met; either stops the arm.
    assert reader.snapshot()["fault"] in (Fault.COMMAND_RING, Fault.STALE_READING)

    before = int(reader.snapshot()["cycle"])
    until(lambda: int(reader.snapshot()["cycle"]) > before + 100, "a hundred cycles more")
    assert stack.loop.process.poll() is None and stack.front.process.poll() is None
    truth, now_ns = stack.truth(), time.monotonic_ns()
    judge(motion_violations(arm, truth, begun_ns, now_ns))
    if stands_since_ns(truth, now_ns) >= now_ns:
        judge(["the arm still moves a hundred cycles after it faulted"])
    reader.close()

    stack.loop.process.terminate()  # what is left of the file is of no use to anybody: the way back is a new start
    stack.loop.code()
    assert not Path(path).exists()
    stack.start_loop()
    reader = StateReader(files.open_state(stack.name))
    until(lambda: reader.snapshot()["mode"] == Mode.HOLDING, "holding again")
    assert reader.snapshot()["joints"]["referenced"][: len(arm.joints)].all()
    reader.close()
