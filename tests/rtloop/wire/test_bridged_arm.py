"""A whole arm behind python-can: its control process on a virtual bus, and on somebody else's adapter code."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest
from compiling import make_object
from memory_front import MemoryFront
from observer import judge, life_violations, motion_violations, truth_of
from stack import PATIENCE_S, Stack

from config.loader import load_arm
from rtloop.process import compiled
from rtloop.process.control_process import ControlProcess, StopAsked
from shm.words import Outcome
from sim.arm import SimulatedArm
from sim.python_can_host import PythonCanServer

START_RAD = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
JOINTS = len(START_RAD)
BRIDGED = ("interface", "python-can"), ("serial_baud", "cdc")

pytestmark = pytest.mark.process


def approached(stack: Stack, interface: str, **options) -> Path:
    stack.change(bus={**dict(BRIDGED), "python_can": {"interface": interface, **options}})
    return stack.arm_file


@pytest.fixture
def stack(arm_name, tmp_path) -> Iterator[Stack]:
    made = Stack(arm_name, tmp_path, start_deg=[float(np.degrees(angle)) for angle in START_RAD])
    yield made
    made.close()


@pytest.fixture
def inside(stack, unlocked, monkeypatch, tmp_path) -> Iterator[SimpleNamespace]:
    """The control process' threads and the simulated arm on one virtual bus of this very process."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    stack.change(bus={"channel": f"bus of {stack.name}"})
    arm = load_arm(approached(stack, "virtual"))
    make_object()
    before = set(threading.enumerate())
    with can.Bus(arm.bus.resolved_channel, "virtual", ignore_config=True) as bus:
        sim = SimulatedArm(arm, start_ns=time.monotonic_ns(), joint_position_rad=START_RAD)
        server = PythonCanServer(sim, bus)
        stop_asked, told, codes = StopAsked([]), [], []
        process = ControlProcess(arm, compiled.load(), told.append, stop_asked)
        ready = threading.Event()
        ends = threading.Event()
        serving = threading.Thread(target=server.serve, args=(lambda: not ends.is_set(),))
        controlling = threading.Thread(target=lambda: codes.append(process.serve(ready.set)))

        def end():
            stop_asked.yes = True
            controlling.join(PATIENCE_S)
            ends.set()
            os.write(server.wake_descriptor, b"\0")
            serving.join(PATIENCE_S)

        serving.start()
        controlling.start()
        try:
            assert ready.wait(PATIENCE_S), told
            front = MemoryFront(stack.arm_file)
            yield SimpleNamespace(arm=arm, sim=sim, front=front, end=end)
            front.close()
        finally:
            end()
            server.close()
            judge(life_violations(arm, truth_of(sim)))
    assert codes == [0], told
    assert set(threading.enumerate()) <= before


def test_an_arm_moves_on_a_virtual_bus(inside):
    began_ns = inside.sim.now_ns
    assert inside.front.outcome(inside.front.swing(3.0, 0.15, judged=True)) == Outcome.SUCCEEDED
    for counter in ("wire_errors", "error_frames", "receive_overflows"):
        assert inside.front.counter(counter) == 0
    inside.end()
    truth = truth_of(inside.sim)
    assert all(np.ptp(joint.position_rad) > 0.14 for joint in truth.values())
    judge(motion_violations(inside.arm, truth, began_ns, inside.sim.now_ns))


def test_an_arm_behind_somebody_else_s_adapter_code(stack):
    approached(stack, "slcan", sleep_after_open=0.0)
    stack.start_sim()
    began_ns = time.monotonic_ns()
    loop = stack.start_loop()
    with closing(MemoryFront(stack.arm_file)) as front:
        assert front.outcome(front.swing(3.0, 0.15, judged=True)) == Outcome.SUCCEEDED
        assert front.counter("wire_errors") == 0
    truth = stack.truth()
    assert all(np.ptp(joint.position_rad) > 0.14 for joint in truth.values())
    judge(motion_violations(load_arm(stack.arm_file), truth, began_ns, time.monotonic_ns()))
    loop.process.terminate()
    assert loop.code() == 0
