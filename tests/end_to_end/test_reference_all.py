"""All joints at once where they read, with real processes: what `rtarm up` names, and what a person says yes to."""

import math
import signal
from contextlib import closing

import pytest
from at_terminal import rtarm_at_terminal
from fault_rig import wait
from stack import PATIENCE_S, Process

from config.loader import load_arm
from rtarm.running.status import read_status
from rtloop.kept import reference_store
from shm.words import Mode, Unreferenced

pytestmark = pytest.mark.process

START_DEG = [10.0, -20.0, 15.0, 30.0, -25.0, 40.0]
WITHIN_DEG = 0.1


def rtarm(stack, *words):
    process = stack._keep(Process("rtarm", *words))
    code = process.code()
    return code, process.text


def unreferenced(stack):
    return [joint["name"] for joint in read_status(stack.name)["joints"] if not joint["referenced"]]


def test_of_drives_that_were_silent_those_that_count_on_are_taken_where_they_are_shown(stack_at):
    """Two were silent when no mark was kept that could prove their power; the third loses it now."""
    stack = stack_at(START_DEG)
    for joint in (1, 2):
        reference_store.keep_lost_reference(load_arm(stack.arm_file), joint, Unreferenced.SILENT)
    stack.start_loop()
    assert unreferenced(stack) == ["joint2", "joint3"]
    stack.sim.say("power-loss:joint=joint5,at_s=0,off_s=4")
    wait(lambda: len(unreferenced(stack)) == 3, "the loss of the third reference", PATIENCE_S)
    stack.until(lambda report: all(joint["age_ms"] < 100.0 for joint in report["joints"]))
    assert rtarm(stack, "clear-fault", stack.name)[0] == 0
    assert unreferenced(stack) == ["joint2", "joint3", "joint5"]
    with closing(rtarm_at_terminal("reference", "--all", "--arm", stack.name)) as at:
        at.reply("do they stand there (joint2, joint3)? [y/N, q ends]", "n")
        assert at.code() == 1
    assert unreferenced(stack) == ["joint2", "joint3", "joint5"]
    with closing(rtarm_at_terminal("reference", "--all", "--arm", stack.name)) as at:
        at.read_until("joint2 -20.00 The drive of joint2 was silent for too long")
        at.read_until("joint3 15.00 The drive of joint3 was silent for too long")
        at.read_until("joint5 - The drive of joint5 may have lost power")
        at.reply("do they stand there (joint2, joint3)? [y/N, q ends]", "y")
        at.read_until("Taken: joint2 -20.00°, joint3 15.00°.")
        at.read_until("The count of joint5 is no angle: `rtarm home joint5`, or `rtarm reference joint5=DEGREES`")
        assert at.code() == 1
    assert unreferenced(stack) == ["joint5"]
    assert rtarm(stack, "reference", "joint5=-25", "--arm", stack.name)[0] == 0
    report = read_status(stack.name)
    assert (unreferenced(stack), report["mode"]) == ([], Mode.HOLDING.name.lower())
    shown_deg = [math.degrees(joint["position_rad"]) for joint in report["joints"]]
    true_deg = [math.degrees(joint.position_rad[-1]) for joint in stack.truth().values()]
    assert shown_deg == pytest.approx(START_DEG, abs=WITHIN_DEG)
    assert true_deg == pytest.approx(START_DEG, abs=WITHIN_DEG)


def test_up_names_the_next_command_when_it_begins_and_when_it_ends_without_references(stack_at):
    pytest.importorskip("rclpy")
    pytest.importorskip("control_msgs")
    stack = stack_at(START_DEG, "--unhomed")
    up = stack._keep(Process("rtarm", "up", str(stack.arm_file), needs_ros=True))
    up.line_with("running; Ctrl-C")
    six = "joint1, joint2, joint3, joint4, joint5, joint6 have no reference"
    ways = "`rtarm home joint1 joint2 joint3 joint4 joint5 joint6`, or `rtarm reference joint1=DEGREES joint2=DEGREES"
    assert ways in up.line_with(f"{six}, so no goal is taken: ")
    code, said = rtarm(stack, "reference", "--all", "--yes", "--arm", stack.name)
    assert (code, len(unreferenced(stack))) == (1, 6)
    assert ways in said
    up.process.send_signal(signal.SIGINT)
    assert ways in up.line_with(f"{six} at the end: start again with `rtarm up {stack.arm_file}`, then ")
    assert up.code() == 0
    assert up.lines[-1].endswith("ended in order")
