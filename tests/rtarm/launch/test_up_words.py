"""What `rtarm up` says of joints without a reference, beside memory files that a test has written."""

from __future__ import annotations

import asyncio
import io
import os
import signal

import pytest
from rich.console import Console
from written_arm import WrittenArm

from config.loader import load_arm
from rtarm.console.errors import ExitCode
from rtarm.console.interrupt import STOP_SIGNALS
from rtarm.console.reporter import Reporter
from rtarm.launch import up as up_module
from rtarm.launch.plan import Plan
from shm.words import Unreferenced


class Launched:
    """In place of a launcher: an arm that runs until a signal, which comes at once."""

    def __init__(self, plan: Plan, _: Reporter) -> None:
        self.page = None

    async def start(self) -> None: ...

    async def watch(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.Event().wait()

    async def stop(self) -> None: ...

    def say_stopping(self, why: str) -> None: ...

    def stop_at_once(self) -> None: ...

    def check_orderly_end(self) -> None: ...


def said_by_up(monkeypatch: pytest.MonkeyPatch, name: str, init_mode: int) -> list[str]:
    config = load_arm("mock", overrides={"name": name, "control": {"init_mode": init_mode}})
    plan = Plan(arm=config, arm_argument=name, overrides={}, simulated=False, again="rtarm up ./arm.yaml")
    monkeypatch.setattr(up_module, "Launcher", Launched)
    shown = io.StringIO()
    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    try:
        assert up_module.up(plan, Reporter(Console(file=shown, width=400))) == ExitCode.DONE
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return [line.removeprefix("rtarm").strip() for line in shown.getvalue().splitlines()]


def test_an_arm_that_lacks_nothing_gets_no_word_more(arm: WrittenArm, monkeypatch: pytest.MonkeyPatch) -> None:
    begins, ends = said_by_up(monkeypatch, arm.name, 1)
    assert begins.startswith("running; Ctrl-C") and ends == "ended in order"


@pytest.mark.parametrize("init_mode", [0, 1])
def test_the_next_command_is_named_unless_the_arm_is_homed_now(
    arm: WrittenArm, monkeypatch: pytest.MonkeyPatch, init_mode: int
) -> None:
    arm.rows["referenced"] = 0
    arm.rows["unreferenced_reason"] = Unreferenced.SILENT, Unreferenced.POWER_LOST
    arm.publish()
    lines = said_by_up(monkeypatch, arm.name, init_mode)
    next_ones = (
        "`rtarm reference --all` if the arm stands where `rtarm status` says, or `rtarm reference elbow=DEGREES` if "
        "you can tell the angle"
    )
    begins = [f"shoulder, elbow have no reference, so no goal is taken: {next_ones}"]
    assert lines[1:-2] == (begins if init_mode else [])
    assert lines[-2] == (
        f"shoulder, elbow have no reference at the end: start again with `rtarm up ./arm.yaml`, then {next_ones}"
    )
    assert lines[-1] == "ended in order"


def test_an_arm_that_is_gone_ends_without_a_word_of_its_joints(monkeypatch: pytest.MonkeyPatch, arm_name: str) -> None:
    assert len(said_by_up(monkeypatch, arm_name, 1)) == 2
