"""A whole arm behind python-can: its control process on a virtual bus, and on somebody else's adapter code."""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest
from compiling import make_object
from observer import judge, life_violations, motion_violations, truth_of
from stack import PATIENCE_S, Stack

from config.loader import arm_hash, load_arm
from rtloop import compiled
from rtloop.process import ControlProcess, StopAsked
from shm.client import CommandWriter, StateReader
from shm.errors import RingFull
from shm.files import open_state, own_command
from shm.words import Mode, Outcome
from sim.arm import SimulatedArm
from sim.python_can_host import PythonCanServer

START_RAD = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
JOINTS = len(START_RAD)
BRIDGED = ("interface", "python-can"), ("serial_baud", "cdc")

pytestmark = pytest.mark.process


class Front:
    """Stands for the ROS process: sends goals and looks on."""

    def __init__(self, arm_file):
        arm = load_arm(arm_file)
        self.reader = StateReader(open_state(arm.name))
        self.writer = CommandWriter(own_command(arm.name, arm_hash(arm)))

    def until(self, wanted):
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            self.writer.beat()
            if wanted(now := self.reader.snapshot()):
                return now
            time.sleep(0.002)
        raise AssertionError(f"it never came: {self.reader.snapshot()}")

    def swing(self, duration_s=3.0, angle_rad=0.15):
        """Swing all joints out and back; the outcome."""
        home = self.until(lambda now: now["mode"] == Mode.HOLDING)["joints"]["commanded_position_rad"][:JOINTS].copy()
        goal = self.writer.announced_goal + 1
        consumed = self.reader.setpoints_consumed
        self.writer.announce(goal)
        self.writer.begin(
            goal,
            start_ns=0,
            joint_mask=(1 << JOINTS) - 1,
            goal_time_s=1.0,
            entry=0,
            tolerances=np.tile([0.1, 0.0, 0.0], (JOINTS, 1)),
            consumed=consumed(),
        )
        w = 2 * np.pi / duration_s
        for time_s in np.linspace(0.0, duration_s, 31):
            knot = np.zeros((JOINTS, 3))
            knot[:, 0] = home + angle_rad * (1 - np.cos(w * time_s)) / 2
            knot[:, 1] = angle_rad * w * np.sin(w * time_s) / 2 if 0 < time_s < duration_s else 0.0
            knot[:, 2] = angle_rad * w * w * np.cos(w * time_s) / 2
            with contextlib.suppress(RingFull):  # it holds many times as many
                self.writer.knot(goal, round(time_s * 1e9), 5, knot, consumed())
        self.writer.end(goal, np.tile([0.01, 0.05, 0.0], (JOINTS, 1)), consumed())
        slot = goal % len(self.reader.snapshot()["results"])
        now = self.until(lambda now: now["results"][slot]["goal_id"] == goal)
        return Outcome(int(now["results"][slot]["outcome"]))

    def counter(self, name):
        return int(self.reader.memory.record["counters"][name])

    def close(self):
        self.reader.close()
        self.writer.close()


def bridged(stack: Stack, interface: str, **options) -> Path:
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
    arm = load_arm(bridged(stack, "virtual"))
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
            front = Front(stack.arm_file)
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
    assert inside.front.swing() == Outcome.SUCCEEDED
    for counter in ("wire_errors", "error_frames", "receive_overflows"):
        assert inside.front.counter(counter) == 0
    inside.end()
    truth = truth_of(inside.sim)
    assert all(np.ptp(joint.position_rad) > 0.14 for joint in truth.values())
    judge(motion_violations(inside.arm, truth, began_ns, inside.sim.now_ns))


def test_an_arm_behind_somebody_else_s_adapter_code(stack):
    bridged(stack, "slcan", sleep_after_open=0.0)
    stack.start_sim()
    began_ns = time.monotonic_ns()
    loop = stack.start_loop()
    front = Front(stack.arm_file)
    try:
        assert front.swing() == Outcome.SUCCEEDED
        assert front.counter("wire_errors") == 0
    finally:
        front.close()
    truth = stack.truth()
    assert all(np.ptp(joint.position_rad) > 0.14 for joint in truth.values())
    judge(motion_violations(load_arm(stack.arm_file), truth, began_ns, time.monotonic_ns()))
    loop.process.terminate()
    assert loop.code() == 0
