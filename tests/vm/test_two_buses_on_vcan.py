"""An arm of two buses on real SocketCAN: a drive of the same address on each of two interfaces, one control process."""

import json
import socket
import subprocess
import time

import can
import numpy as np
import pytest
from arm_files import edited
from memory_front import MemoryFront
from stack import Process, Stack, run_rtarm
from vcan_arm import RATE_HZ, slowed

from shm.words import Answer, Fault, Mode, Outcome, Request
from sim.truth import load_truth

NAME = "twovcan"
PATIENCE_S = 120.0
SO_RCVBUFFORCE = 33
CHANNELS = {"shoulder": "vcan0", "wrist": "vcan2"}


class Arm(MemoryFront):
    """A running arm with one joint on each bus, whose front is this process."""

    def __init__(self, folder):
        self.stack = Stack(NAME, folder)
        self.truths = {bus: folder / f"truth_{bus}.npz" for bus in CHANNELS}
        with edited(self.stack.arm_file) as values:
            slowed(values, joints=2)
            shared = {"interface": "socketcan", "bitrate": 500_000}
            values["bus"] = [{**shared, "name": bus, "channel": channel} for bus, channel in CHANNELS.items()]
            for joint, bus in zip(values["joints"], CHANNELS, strict=True):
                joint["bus"] = bus
                joint["drive"]["address"] = 1
        try:
            for bus, channel in CHANNELS.items():
                place = ("--bus", bus, "--can", channel, "--truth", str(self.truths[bus]))
                sim = self.stack._keep(Process("sim", "--arm", str(self.stack.arm_file), *place))
                sim.line_with("ready")
            self.loop = self.stack.start_loop()
        except BaseException:
            self.stack.close()
            raise
        super().__init__(self.stack.arm_file, PATIENCE_S)

    def close(self):
        super().close()
        self.stack.close()

    def counted(self, word):
        """A counter of each bus."""
        return [int(row[word]) for row in self.reader.memory.record["buses"][: len(CHANNELS)]]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    running = Arm(tmp_path_factory.mktemp("two"))
    yield running
    running.close()


@pytest.fixture
def strangers():
    """Somebody else's clients of both buses."""
    with can.Bus("vcan0", interface="socketcan") as first, can.Bus("vcan2", interface="socketcan") as second:
        for bus in (first, second):
            bus.socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)  # they are read after the fact
        yield first, second


def heard(stranger):
    found = []
    while (message := stranger.recv(0.0)) is not None:
        if not message.is_error_frame:
            found.append((message.arbitration_id, bytes(message.data)))
    return found


def test_a_goal_moves_a_joint_on_each_bus_and_each_bus_carries_its_own_frames(arm, strangers):
    before = arm.counted("frames_sent")
    assert arm.outcome(arm.swing()) == Outcome.SUCCEEDED
    for frames in map(heard, strangers):
        assert {can_id >> 8 for can_id, _ in frames} == {1}
        assert len([data for _, data in frames if data[:1] == b"\xfd"]) > 2 * 0.9 * 4 * RATE_HZ
    assert all(after - count > 4 * RATE_HZ for after, count in zip(arm.counted("frames_sent"), before, strict=True))
    assert arm.counted("wire_errors") == arm.counted("bytes_unsent") == [0, 0]
    report = json.loads(run_rtarm("status", NAME, "--json").stdout)
    assert [bus["name"] for bus in report["buses"]] == list(CHANNELS)


def test_when_one_link_goes_down_the_other_bus_is_led_to_rest_and_a_clear_brings_both_back(arm):
    goal = arm.swing(8.0, 0.2)
    arm.until(lambda now: now["goal_id"] == goal and now["trajectory_clock_ns"] > 1e9)
    subprocess.run(["ip", "link", "set", "vcan2", "down"], check=True)
    now = arm.until(lambda now: now["mode"] == Mode.FAULT)
    assert (now["fault"], now["fault_limit"]) == (Fault.LINK_DOWN, 1.0)
    assert arm.outcome(goal) == Outcome.FAULT
    assert "wrist" in json.loads(run_rtarm("status", NAME, "--json").stdout)["fault"]["sentence"]
    sent, quiet = arm.counted("frames_sent")
    arm.until(lambda now: not np.any(now["joints"]["commanded_velocity_rad_s"][:2]))
    assert arm.answer(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    assert arm.counted("frames_sent")[0] > sent and arm.counted("frames_sent")[1] == quiet
    subprocess.run(["ip", "link", "set", "vcan2", "up"], check=True)
    arm.loop.line_with("The adapter is back")
    since_ns = time.monotonic_ns()
    arm.until(lambda now: now["joints"]["measured_ns"][:2].min() > since_ns)
    assert arm.answer(Request.CLEAR_FAULT) == Answer.DONE
    arm.until(lambda now: now["mode"] == Mode.HOLDING)


def test_the_control_process_ends_in_order_and_the_drives_have_moved(arm):
    arm.loop.process.terminate()
    assert arm.loop.code() == 0
    arm.stack.close()
    for truth in map(load_truth, arm.truths.values()):
        (joint,) = truth.values()
        assert np.ptp(joint.position_rad) > 0.05
