"""The whole arm on real SocketCAN: drives simulated on vcan0, the control process, goals, errors, a link gone down."""

import json
import socket
import subprocess
import time
from pathlib import Path

import can
import numpy as np
import pytest
from can_records import error_record, record
from observer import WireFrame, command_violations, motion_after, motion_frames, motion_violations
from stack import Stack, run_rtarm
from vcan_arm import JOINTS, RATE_HZ, RunningArm, start_on_vcan

from rtloop.wire import can_words
from shm.words import Answer, BusState, Fault, Mode, Outcome, Request

NAME = "onvcan"
SO_RCVBUFFORCE = 33
HOUR_NS = 3600 * 10**9
GOALS = Path(__file__).parents[1] / "data" / "moveit"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    running = RunningArm(Stack(NAME, tmp_path_factory.mktemp("vcan")), start_on_vcan)
    yield running
    running.close()


@pytest.fixture
def peer():
    """python-can: somebody else's client of the same bus."""
    with can.Bus("vcan0", interface="socketcan") as bus:
        bus.socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)  # it is read after the fact
        yield bus


@pytest.fixture
def controller():
    """A raw socket that says what a controller's driver would."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as opened:
        opened.bind(("vcan0",))
        yield opened


def frames_at(peer):
    """All frames from the host that the peer has heard so far."""
    found = []
    while (message := peer.recv(0.0)) is not None:
        if message.is_error_frame:
            continue
        assert message.is_extended_id
        found.append(WireFrame(time.monotonic_ns(), message.arbitration_id, bytes(message.data)))
    return found


def test_a_goal_is_driven_to_its_end_and_a_stranger_understands_every_frame(arm, peer):
    start_ns = time.monotonic_ns()
    goal = arm.swing()
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    frames = frames_at(peer)
    commands = [frame for frame in frames if frame.data[:1] == b"\xfd"]
    assert len(commands) > 2 * JOINTS * 0.9 * 4 * RATE_HZ
    assert command_violations(arm.config, commands) == []
    readings = [frame for frame in frames if len(frame.data) == 7 and frame.data[:1] == b"\x36"]
    assert len(readings) > JOINTS * 0.9 * 4 * RATE_HZ
    assert motion_violations(arm.config, arm.stack.truth(), start_ns, time.monotonic_ns()) == []
    assert arm.counter("wire_errors") == arm.counter("error_frames") == arm.counter("bytes_unsent") == 0


def test_strangers_frames_are_not_taken_for_the_drives(arm, controller):
    before = arm.counter("frames_received"), arm.now()["joints"]["measured_position_rad"][:JOINTS].copy()
    reading = bytes((0x36, 0, 0x7F, 0, 0, 0, 0x6B))
    for frame in (record(0x900, reading), record(0x100, reading, flags=0), record(0x100, reading, flags=0xC0000000)):
        controller.send(frame)
    cycle = int(arm.now()["cycle"])
    now = arm.until(lambda now: now["cycle"] > cycle + 3)
    assert now["mode"] == Mode.HOLDING
    assert np.allclose(now["joints"]["measured_position_rad"][:JOINTS], before[1], atol=1e-6)


def test_an_error_passive_bus_is_counted_and_shown(arm, controller):
    controller.send(error_record(can_words.CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20"))
    arm.until(lambda now: arm.counter("bus_state") == BusState.PASSIVE)
    assert (arm.counter("unacknowledged"), arm.counter("error_frames")) == (1, 1)
    assert json.loads(run_rtarm("status", NAME, "--json").stdout)["bus"]["state"] == "passive"
    assert arm.now()["mode"] == Mode.HOLDING
    controller.send(error_record(can_words.CONTROLLER, b"\0\x40"))
    arm.until(lambda now: arm.counter("bus_state") == BusState.ACTIVE)


def test_bus_off_is_a_fault_with_a_way_back(arm, controller, peer):
    goal = arm.swing()
    arm.under_way(goal)
    controller.send(error_record(can_words.BUS_OFF))
    now = arm.until(lambda now: now["mode"] == Mode.FAULT)
    assert (now["fault"], now["fault_value"]) == (Fault.BUS_OFF, float(can_words.BUS_OFF))
    assert arm.outcome(goal) == Outcome.FAULT
    controller.send(error_record(can_words.RESTARTED))
    arm.until(lambda now: arm.counter("bus_state") == BusState.ACTIVE)
    frames_at(peer)
    cycle = int(arm.now()["cycle"])
    arm.until(lambda now: now["cycle"] > cycle + 2 * RATE_HZ)
    assert not any(motion_frames(frames_at(peer), drive, 0) for drive in range(1, JOINTS + 1))
    arm.clear()
    assert arm.outcome(arm.swing(2.0, 0.02)) == Outcome.SUCCEEDED


# --- the system's clock -------------------------------------------------------------------------------


@pytest.mark.parametrize("step_ns", [HOUR_NS, 500_000_000, -HOUR_NS, -500_000_000])
def test_a_step_of_the_systems_clock_moves_stamps_and_nothing_else(arm, step_ns):
    """Each cycle advances the trajectory by exactly one period, and every stamp after the step is the clock's."""
    start_ns = time.monotonic_ns()
    goal = arm.swing()
    arm.under_way(goal)
    seen = [arm.now()]
    cycle = 0
    stepped_cycle = 0
    while seen[-1]["goal_id"] == goal and seen[-1]["goal_phase"] == seen[0]["goal_phase"]:
        cycle += 1
        if stepped_cycle == 0 and seen[-1]["trajectory_clock_ns"] > 2e9:
            time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() + step_ns)
            stepped_cycle = int(arm.now()["cycle"]) + 1
        now = arm.now()
        if now["cycle"] != seen[-1]["cycle"]:
            seen.append(now)
    offset_ns = time.time_ns() - time.monotonic_ns()
    assert arm.outcome(goal) == Outcome.SUCCEEDED
    period_ns = arm.config.control.period_ns
    seen.pop()
    assert stepped_cycle
    assert len(seen) > RATE_HZ
    phases = [float(now["trajectory_clock_ns"]) - int(now["cycle"]) * period_ns for now in seen]
    assert np.ptp(phases) < 1000
    after = [now for now in seen if now["cycle"] > stepped_cycle]
    assert max(abs(int(now["epoch_ns"]) - int(now["monotonic_ns"]) - offset_ns) for now in after) < 5_000_000
    assert motion_violations(arm.config, arm.stack.truth(), start_ns, time.monotonic_ns()) == []


# --- the link ---------------------------------------------------------------------------------------------


def test_a_link_that_goes_down_is_a_fault_and_its_return_is_noticed(arm, peer):
    """Last, since joints whose drives were away for long stay unreferenced."""
    goal = arm.swing()
    arm.under_way(goal)
    subprocess.run(["ip", "link", "set", "vcan0", "down"], check=True)
    now = arm.until(lambda now: now["mode"] == Mode.FAULT)
    assert now["fault"] == Fault.LINK_DOWN
    assert arm.outcome(goal) == Outcome.FAULT
    arm.loop.line_with("vcan0 is down: set it up with")
    assert arm.answer(Request.CLEAR_FAULT) == Answer.REFUSED_WIRE
    arm.until(lambda now: not np.any(now["joints"]["commanded_velocity_rad_s"][:JOINTS]))
    subprocess.run(["ip", "link", "set", "vcan0", "up"], check=True)
    arm.loop.line_with("The adapter is back")
    since_ns = time.monotonic_ns()
    measured_ns = int(arm.now()["joints"]["measured_ns"][:JOINTS].max())
    arm.until(lambda now: now["joints"]["measured_ns"][:JOINTS].min() > max(measured_ns, since_ns))
    assert arm.now()["mode"] == Mode.FAULT
    assert motion_after(arm.stack.truth(), since_ns, time.monotonic_ns()) == []
    arm.clear()
    assert motion_after(arm.stack.truth(), since_ns, time.monotonic_ns()) == []


def test_the_control_process_ends_in_order(arm):
    arm.loop.process.terminate()
    assert arm.loop.code() == 0
