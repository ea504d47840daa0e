"""`rtarm jog` at a terminal, beside a simulated arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from at_terminal import CTRL_C, Terminal, rtarm_at_terminal
from stack import Stack, run_rtarm
from waiting import until

import rtarm

RIGHT, LEFT = "\x1b[C", "\x1b[D"

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def stack(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with closing(Stack(new_arm_name(), tmp_path_factory.mktemp("jog"))) as stack:
        stack.start_sim()
        stack.start_loop()
        stack.start_front()
        yield stack


@pytest.fixture
def arm(stack: Stack) -> Iterator[rtarm.Arm]:
    """It stands where everything is 0."""
    with rtarm.connect(stack.name) as connected:
        connected.move(dict.fromkeys(connected.joints, 0.0), speed=1.0)
        yield connected


@pytest.fixture
def at(stack: Stack, arm: rtarm.Arm) -> Iterator[Terminal]:
    with closing(rtarm_at_terminal("jog", "--arm", stack.name)) as at:
        at.read_until("step 1°")
        yield at


def degrees(arm: rtarm.Arm) -> list[float]:
    found: list[float] = np.degrees(arm.state().commanded_rad).tolist()
    return found


def test_a_key_is_a_step(at: Terminal, arm: rtarm.Arm) -> None:
    for keys, then in [
        (RIGHT, "joint1 1.00° step 1°"),
        (".", "joint1 1.00° step 2°"),
        ("-", "joint1 -1.00° step 2°"),
        ("6", "joint6 0.00° step 2°"),
        ("\t", "joint1 -1.00° step 2°"),
        ("6", "joint6 0.00° step 2°"),
        (",", "step 1°"),
        (",", "step 0.5°"),
        (LEFT, "joint6 -0.50° step 0.5°"),
    ]:
        at.press(keys)
        at.read_until(then)
    at.press("q")
    assert at.code() == 0
    assert degrees(arm) == pytest.approx([-1.0, 0.0, 0.0, 0.0, 0.0, -0.5], abs=0.02)


def test_a_key_that_is_held_down_moves_no_further_than_the_steps_that_were_seen(at: Terminal, arm: rtarm.Arm) -> None:
    at.press(RIGHT * 20)
    at.read_until("joint1 1.00°")
    at.press("q")
    assert at.code() == 0
    assert degrees(arm)[0] == pytest.approx(1.0, abs=0.02)


def test_beyond_a_limit_nothing_moves_and_the_keys_go_on(at: Terminal, arm: rtarm.Arm) -> None:
    joint, upper = arm.joints[0], arm.limits.upper_rad[0]
    arm.move({joint: upper - 0.001}, speed=1.0)
    at.press("+")
    at.read_until("joint1 would have to go to")
    at.read_until("step 1°")
    at.press("-")
    at.read_until("step 1°")
    at.press("q")
    assert at.code() == 0
    assert degrees(arm)[0] == pytest.approx(np.degrees(upper - 0.001) - 1.0, abs=0.02)


def test_ctrl_c_stops_a_step_on_its_way(at: Terminal, arm: rtarm.Arm) -> None:
    for larger in ("step 2°", "step 5°"):
        at.press(".")
        at.read_until(larger)
    at.press(RIGHT)
    until(lambda: arm.state().moves, "the arm on its way")
    at.press(CTRL_C)
    at.read_until("Ended by SIGINT")
    assert at.code() == 4
    assert not arm.state().moves and 0.0 < degrees(arm)[0] < 4.9


def test_without_a_terminal_it_says_what_to_use_instead(stack: Stack) -> None:
    refused = run_rtarm("jog", "--arm", stack.name)
    assert refused.returncode == 1 and "use `rtarm move JOINT=DEGREES --relative`" in refused.stderr
