"""What the real processes of an arm end with: whatever a test said, the judge's word on the arm's true motion."""

import contextlib
import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from observer import Violation
from stack import PATIENCE_S, Stack

from config.loader import load_arm
from shm.files import DIRECTORY

pytestmark = pytest.mark.process

UPPER_DEG = 140.0
"""Of joint1."""


@pytest.fixture
def stack(arm_name: str, tmp_path: Path) -> Iterator[Stack]:
    """Drives of which joint1 stands 1° below its upper limit."""
    made = Stack(arm_name, tmp_path, start_deg=[UPPER_DEG - 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    made.start_sim()
    yield made
    with contextlib.suppress(Violation):
        made.close()


def lead_out(stack: Stack) -> None:
    """What no control process does: joint1 to 1° beyond its limit, until it is there."""
    joint = stack.simulated.joints[0]
    pulses = round((math.radians(UPPER_DEG + 1.0) + joint.zero_rad) * joint.command_pulses_per_rad) * joint.direction
    way = b"\xfd" + bytes([pulses < 0]) + (100).to_bytes(2, "big") + b"\0" + abs(pulses).to_bytes(4, "big")
    halves = (way[:8], b"\xfd" + way[8:] + b"\1\0\x6b")
    frames = [b"T%08X%d%s\r" % (256 + n, len(half), half.hex().upper().encode()) for n, half in enumerate(halves)]
    port = os.open(stack.link, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(port, b"".join([b"S6\r", b"O\r", *frames]))
        deadline = time.monotonic() + PATIENCE_S
        while math.degrees(stack.truth()["joint1"].position_rad[-1]) < UPPER_DEG + 0.9:
            assert time.monotonic() < deadline, stack.truth()["joint1"]
    finally:
        os.close(port)


def test_an_arm_that_left_its_limits_is_told_once_all_has_ended_and_is_swept(stack: Stack) -> None:
    left = DIRECTORY / f"rtarm.{stack.name}.state"
    left.touch()
    lead_out(stack)
    with pytest.raises(Violation, match=r"^joint1: 14[01]\.\d+° is outside -180° to 140°$"):
        stack.close()
    assert stack.sim.process.returncode == 0
    assert not left.exists()


def test_an_arm_that_left_its_limits_is_told_though_another_one_came_in_its_place(stack: Stack) -> None:
    lead_out(stack)
    stack.sim.close()
    stack.start_sim()
    with pytest.raises(Violation, match="joint1: 14"):
        stack.close()


def test_limits_are_those_that_the_simulated_arm_began_with(stack: Stack) -> None:
    text = stack.arm_file.read_text(encoding="utf-8")
    stack.arm_file.write_text(text.replace(f"upper_deg: {UPPER_DEG:g}\n", "upper_deg: 150\n"), encoding="utf-8")
    assert load_arm(stack.arm_file).joints[0].upper_deg == 150.0
    lead_out(stack)
    with pytest.raises(Violation, match="joint1: 14"):
        stack.close()


def test_what_was_seen_of_a_killed_arm_is_told(stack: Stack) -> None:
    lead_out(stack)
    stack.unplug()
    with pytest.raises(Violation, match="joint1: 14"):
        stack.close()


def test_a_killed_arm_that_nobody_asked_has_nothing_to_tell(stack: Stack) -> None:
    stack.sim.process.send_signal(signal.SIGSTOP)
    stack.unplug()
    stack.close()
