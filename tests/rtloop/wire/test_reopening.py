"""An adapter that is unplugged and plugged in again, with real processes: the simulated arm goes and comes back.

What the cycle does meanwhile is tested in virtual time (`test_socketcan_arm.py`, both wires), SocketCAN itself in the
virtual machine (`tests/vm`).
"""

import secrets
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_front import MemoryFront
from observer import judge
from stack import Stack

from config.serial_adapters import SERIAL_ADAPTERS
from shm.words import Answer, Event, Fault, Mode, Request


def bus_of(interface: str) -> dict[str, Any]:
    """Section `bus` of an arm behind the simulated adapter of this kind; python-can speaks SLCAN to it."""
    if interface == "python-can":
        return {
            "interface": interface,
            "serial_baud": "cdc",
            "python_can": {"interface": "slcan", "sleep_after_open": 0.0},
        }
    adapter = SERIAL_ADAPTERS[interface]
    bitrate = 500_000 if 500_000 in adapter.bitrates else 1_000_000
    return {"interface": interface, "bitrate": bitrate, "serial_baud": adapter.serial_baud}


@pytest.fixture
def interface() -> str:
    return "slcan"


@pytest.fixture
def stack(tmp_path: Path, interface: str) -> Iterator[Stack]:
    running = Stack(f"t{secrets.token_hex(4)}", tmp_path, start_deg=[0, 0, 70, 0, 0, 0])
    running.change(bus=bus_of(interface))
    running.start_sim()
    yield running
    running.close()


def events(arm: MemoryFront) -> list[int]:
    """Kinds of all events that have been told."""
    record = arm.reader.memory.record
    return [int(kind) for kind in record["events"]["kind"][: int(record["events_written"][0])]]


@pytest.mark.process
@pytest.mark.parametrize("interface", [*SERIAL_ADAPTERS, "python-can"])
def test_an_adapter_that_is_plugged_in_again_is_noticed_and_waits_for_a_clear(stack: Stack) -> None:
    loop = stack.start_loop()
    with closing(MemoryFront(stack.arm_file)) as arm:
        for round_number in (1, 2):
            stack.unplug()
            now = arm.until(lambda now: now["mode"] == Mode.FAULT)
            assert now["fault"] == Fault.WIRE
            assert arm.answer(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
            loop.line_with(f"{stack.link}")  # which sentence says so depends on what is left of the terminal
            stack.start_sim()
            loop.line_with("The adapter is back")
            arm.until(lambda now, wanted=round_number: events(arm).count(Event.WIRE) == wanted)
            back_ns = time.monotonic_ns()
            now = arm.until(lambda now, since_ns=back_ns: bool(np.all(now["joints"]["measured_ns"][:6] > since_ns)))
            assert now["mode"] == Mode.FAULT
            assert arm.answer(Request.CLEAR_FAULT) == Answer.DONE
            now = arm.until(lambda now: now["mode"] == Mode.HOLDING)
            assert now["motion_started"] == 0
            assert not np.any(now["joints"]["referenced"][:6])  # a clear references nobody: they were away too long
            judge([f"{name} moved" for name, joint in stack.truth().items() if np.ptp(joint.position_rad) > 0.0])
    loop.process.terminate()
    assert loop.code() == 0
    assert not any("Traceback" in line for line in loop.lines)


@pytest.mark.process
def test_an_orderly_end_without_an_adapter(stack: Stack) -> None:
    loop = stack.start_loop()
    with closing(MemoryFront(stack.arm_file)) as arm:
        stack.unplug()
        arm.until(lambda now: now["mode"] == Mode.FAULT)
    loop.process.terminate()
    assert loop.code() == 0
