"""An arm of two buses on real SocketCAN: a drive of the same address on each of two interfaces, one control process."""

import json
import socket
import subprocess
import time

import can
import numpy as np
import pytest
from arm_files import edited
from stack import Process, Stack, run_rtarm
from vcan_arm import RATE_HZ, RunningArm, slowed

from shm.words import Answer, Fault, Mode, Outcome, Request
from sim.truth import load_truth

NAME = "twovcan"
SO_RCVBUFFORCE = 33
CHANNELS = {"shoulder": "vcan0", "wrist": "vcan2"}


TRUTH = "truth_{bus}.npz"


def start_both(stack):
    """Rewrite a stack's arm file for one joint on each of two interfaces, and start its simulated drives there."""
    with edited(stack.arm_file) as values:
        slowed(values, joints=2)
        shared = {"interface": "socketcan", "bitrate": 500_000}
        values["bus"] = [{**shared, "name": bus, "channel": channel} for bus, channel in CHANNELS.items()]
        for joint, bus in zip(values["joints"], CHANNELS, strict=True):
            joint["bus"] = bus
            joint["drive"]["address"] = 1
    for bus, channel in CHANNELS.items():
        place = ("--bus", bus, "--can", channel, "--truth", str(stack.folder / TRUTH.format(bus=bus)))
        stack._keep(Process("sim", "--arm", str(stack.arm_file), *place)).line_with("ready")


def counted(arm, word):
    """A counter of each bus."""
    return [int(row[word]) for row in arm.reader.memory.record["buses"][: len(CHANNELS)]]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    running = RunningArm(Stack(NAME, tmp_path_factory.mktemp("two")), start_both)
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
    before = counted(arm, "frames_sent")
    assert arm.outcome(arm.swing()) == Outcome.SUCCEEDED
    for frames in map(heard, strangers):
        assert {can_id >> 8 for can_id, _ in frames} == {1}
        assert len([data for _, data in frames if data[:1] == b"\xfd"]) > 2 * 0.9 * 4 * RATE_HZ
    assert all(after - count > 4 * RATE_HZ for after, count in zip(counted(arm, "frames_sent"), before, strict=True))
    assert counted(arm, "wire_errors") == counted(arm, "bytes_unsent") == [0, 0]
    report = json.loads(run_rtarm("status", NAME, "--json").stdout)
    assert [bus["name"] for bus in report["buses"]] == list(CHANNELS)


def test_when_one_link_goes_down_the_other_bus_is_led_to_rest_and_a_clear_brings_both_back(arm):
    goal = arm.swing(8.0, 0.2)
    arm.under_way(goal)
    subprocess.run(["ip", "link", "set", "vcan2", "down"], check=True)
    now = arm.until(lambda now: now["mode"] == Mode.FAULT)
    assert (now["fault"], now["fault_limit"]) == (Fault.LINK_DOWN, 1.0)
    assert arm.outcome(goal) == Outcome.FAULT
    assert "wrist" in json.loads(run_rtarm("status", NAME, "--json").stdout)["fault"]["sentence"]
    sent, quiet = counted(arm, "frames_sent")
    arm.until(lambda now: not np.any(now["joints"]["commanded_velocity_rad_s"][:2]))
    assert arm.answer(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    assert counted(arm, "frames_sent")[0] > sent and counted(arm, "frames_sent")[1] == quiet
    subprocess.run(["ip", "link", "set", "vcan2", "up"], check=True)
    arm.loop.line_with("The adapter is back")
    since_ns = time.monotonic_ns()
    arm.until(lambda now: now["joints"]["measured_ns"][:2].min() > since_ns)
    arm.clear()


def test_the_control_process_ends_in_order_and_the_drives_have_moved(arm):
    arm.loop.process.terminate()
    assert arm.loop.code() == 0
    arm.stack.close()
    for bus in CHANNELS:
        (joint,) = load_truth(arm.stack.folder / TRUTH.format(bus=bus)).values()
        assert np.ptp(joint.position_rad) > 0.05
