"""Each example, and each block of docs/guides/python.md, beside a simulated arm of a name of its own."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from pages import sections
from stack import ROOT, Stack
from waiting import until

import rtarm

pytestmark = pytest.mark.process

EXAMPLES = ROOT / "examples"
PATIENCE_S = 120.0
EVENT = struct.Struct("IhBB")


@pytest.fixture(scope="module")
def stack(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A hand leads it whenever it is limp."""
    with closing(Stack(new_arm_name(), tmp_path_factory.mktemp("examples"))) as stack:
        stack.start_sim("--hand", "wave")
        stack.start_loop()
        stack.start_front()
        yield stack


@pytest.fixture
def arm(stack: Stack) -> Iterator[rtarm.Arm]:
    """It stands where everything is 0."""
    with rtarm.connect(stack.name) as connected:
        connected.move(dict.fromkeys(connected.joints, 0.0), speed=1.0)
        yield connected


def run(program: str, *arguments: str, typed: str = "") -> str:
    """What an example says, which ends well."""
    ended = subprocess.run(
        [sys.executable, str(EXAMPLES / program), *arguments],
        input=typed, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_two_poses(stack: Stack, arm: rtarm.Arm) -> None:
    said = run("two_poses.py", stack.name, typed="\n\n\n\n\n")
    assert said.count("are limp") == 2 and said.count("round 3: ") == 2
    assert not arm.state().held


def test_record_and_plot(stack: Stack, arm: rtarm.Arm, tmp_path: Path) -> None:
    said = run("record_and_plot.py", stack.name, str(tmp_path))
    assert said.count("Goal reached") == 2
    rows = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    assert rows[:, 2].max() == pytest.approx(0.2, abs=0.01) and rows[-1, 2] == pytest.approx(0.0, abs=0.01)
    assert (tmp_path / "motion.png").read_bytes().startswith(b"\x89PNG")


def test_observe_act(stack: Stack, arm: rtarm.Arm) -> None:
    run("observe_act.py", stack.name)
    after = arm.state()
    assert after.commanded_rad == pytest.approx(np.zeros(6), abs=0.02) and after.fault == ""


def test_gamepad(stack: Stack, arm: rtarm.Arm, tmp_path: Path) -> None:
    device = tmp_path / "js0"
    os.mkfifo(device)
    hand = os.open(device, os.O_RDWR)  # so that neither end is ever without the other

    def happens(value: int, kind: int, number: int) -> None:
        os.write(hand, EVENT.pack(0, value, kind, number))

    process = subprocess.Popen(
        [sys.executable, str(EXAMPLES / "gamepad.py"), stack.name, str(device)], stdout=subprocess.PIPE, text=True
    )
    try:
        happens(32767, 2, 0)  # a stick alone moves nothing
        assert process.stdout is not None and "use the sticks" in process.stdout.readline()
        until(lambda: not unread(hand), "the stick's event read", PATIENCE_S)
        for state in islice(arm.states(), 60):
            assert state.commanded_rad == pytest.approx(np.zeros(6), abs=1e-3)
        happens(1, 1, 4)
        until(lambda: arm.state().position_rad[0] > 0.05, "the arm on its way", PATIENCE_S)
        happens(0, 1, 4)  # the button is let go: the arm stops by itself
        until(lambda: not arm.state().moves, "the arm at rest", PATIENCE_S)
        assert arm.state().position_rad[1:] == pytest.approx(np.zeros(5), abs=0.01)
        assert arm.state().fault == ""
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    finally:
        process.kill()
        process.wait()
        os.close(hand)
        assert process.stdout is not None
        process.stdout.close()


def unread(pipe: int) -> int:
    """How many bytes of a pipe nobody has read yet."""
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


def test_first_steps(stack: Stack, arm: rtarm.Arm) -> None:
    notebook = json.loads((EXAMPLES / "first_steps.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    play(cells, stack)
    assert arm.state().position_rad == pytest.approx(np.zeros(6), abs=0.01)


@pytest.mark.parametrize("page", ["guides/python.md", "guides/python.zh.md"])
def test_every_block_of_the_page(stack: Stack, arm: rtarm.Arm, page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    blocks = [block for part in sections(text) for block in part.blocks if block.info == "python"]
    assert len(blocks) > 4
    play(["\n".join(block.lines) for block in blocks], stack)


def play(programs: list[str], stack: Stack) -> None:
    """Run programs one after the other, in one namespace, with the stack's arm for the one that they name or not."""
    names: dict[str, object] = {"__name__": "example"}
    for program in programs:
        exec(re.sub(r'rtarm\.connect\((?:"my_arm")?\)', f"rtarm.connect({stack.name!r})", program), names)
