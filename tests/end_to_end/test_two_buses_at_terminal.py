"""`rtarm calibrate` and `rtarm commission` of a joint whose drive shares its identifier with one on another bus."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from at_terminal import CTRL_C, rtarm_at_terminal
from divided_stack import DividedStack
from two_buses import NAMES

from config.loader import load_arm
from rtloop.kept import commissioned
from shm.files import DIRECTORY

pytestmark = pytest.mark.process

SHOULDER, WRIST = NAMES
JOINT, TWIN = "joint6", "joint3"
"""Whose drives have one address."""


@pytest.fixture
def stack(arm_name: str, tmp_path: Path) -> Iterator[DividedStack]:
    made = DividedStack(arm_name, tmp_path, [0.0] * 6)
    drives = {joint.name: joint.drive for part in made.parts.values() for joint in part.joints}
    assert drives[JOINT].number == drives[TWIN].number
    with closing(made):
        made.start_sims()
        yield made


def befall(stack: DividedStack, fault: str) -> None:
    stack.sims[WRIST].say(fault)
    stack.sims[WRIST].line_with(f"fault {fault}")


def only_this_joint_has_moved(stack: DividedStack) -> bool:
    moved = [name for bus in NAMES for name, told in stack.truth_of(bus).items() if np.ptp(told.position_rad) > 0.0]
    return moved == [JOINT]


def test_calibrate_turns_the_joint_on_its_own_bus(stack: DividedStack) -> None:
    before = stack.arm_file.read_bytes()
    with closing(rtarm_at_terminal("calibrate", str(stack.arm_file), "--joint", JOINT)) as at:
        at.reply("Turn it?", "y")
        at.reply(f"Which way did {JOINT} go?", "n")
        at.reply("Was that the opposite way?", "y")
        at.read_until("direction: -1; the file says 1.")
        at.press(CTRL_C)
        assert at.code() == 1
    assert only_this_joint_has_moved(stack)
    assert stack.arm_file.read_bytes() == before
    assert not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))


def test_commission_tests_the_drive_on_its_own_bus(stack: DividedStack, tmp_path: Path) -> None:
    folder, arm = tmp_path / "report", load_arm(stack.arm_file)
    with closing(rtarm_at_terminal("commission", str(stack.arm_file), JOINT, "-o", str(folder))) as at:
        at.reply("Ask it?", "y")
        at.read_until("answers: as documented.")
        at.reply("Ask it?", "n")
        at.reply("Try it?", "y")
        at.read_until("fast targets: as documented.")
        at.reply("Try it?", "y")
        at.read_until("reports: as documented.")
        at.reply("Turn it?", "y")
        at.read_until("silence: as documented.")
        at.reply("Turn it?", "o")
        at.read_until("retarget: as documented.")
        befall(stack, f"stall:joint={JOINT},at_s=0")
        at.reply("Is it clamped", "y")
        at.read_until("stall: as documented.")
        at.reply("Watch it while you switch it off and on?", "y")
        at.read_until(f"Switch the power of {JOINT}'s drive off now")
        befall(stack, f"power-loss:joint={JOINT},at_s=0,off_s=3")
        at.read_until("volatile settings: as documented.")
        assert at.code() == 0
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert len(report["findings"]) == 8
    kept = commissioned.load(arm)
    assert [joint for joint in kept if kept[joint].heals] == [5]
    assert only_this_joint_has_moved(stack)
    assert math.degrees(np.max(np.abs(stack.truth_of(WRIST)[JOINT].position_rad))) <= 15.1
    assert not list(DIRECTORY.glob(f"rtarm.{stack.name}.*"))
