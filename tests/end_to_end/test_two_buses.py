"""An arm whose wrist is on a bus of its own, with the identifiers of the shoulder's drives: real processes."""

import contextlib
import math
import signal
import time

import numpy as np
import pytest
from arm_files import edited
from stack import PATIENT, Process, Stack
from two_buses import NAMES, write_divided

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from observer import life_violations, stands_since_ns
from ros_client import ABORTED, SUCCEEDED, Client, recorded
from waiting import until

from config.loader import load_arm
from sim.truth import load_truth

pytestmark = pytest.mark.process

SHOULDER, WRIST = NAMES
GOAL = "large"


class DividedStack(Stack):
    """Such an arm, with a simulator at each of its buses."""

    def __init__(self, name, folder, start_rad):
        super().__init__(name, folder, start_deg=[math.degrees(angle) for angle in start_rad])
        self.links = {bus: folder / f"tty_{bus}" for bus in NAMES}
        self.truth_files = {bus: folder / f"truth_{bus}.npz" for bus in NAMES}
        front = {"controller_name": f"controller_{name}"}
        write_divided("episode1", self.arm_file, name=name, limits=PATIENT, front=front)
        with edited(self.arm_file) as values:
            for bus in values["bus"]:
                bus["channel"] = str(self.links[bus["name"]])
        self.parts = dict(zip(NAMES, load_arm(self.arm_file).parts, strict=True))
        self.sims = {}

    def start_sims(self):
        start = "--start-deg=" + ",".join(str(angle) for angle in self._start_deg)
        for bus in NAMES:
            place = ("--link", str(self.links[bus]), "--truth", str(self.truth_files[bus]))
            self.sims[bus] = self._keep(Process("sim", "--arm", str(self.arm_file), "--bus", bus, *place, start))
        for sim in self.sims.values():
            sim.line_with("ready")

    def truth_of(self, bus):
        self.sims[bus].process.send_signal(signal.SIGUSR1)
        self.sims[bus].line_with("truth")
        return load_truth(self.truth_files[bus])

    def unplug_bus(self, bus):
        self.links[bus].unlink()
        self.sims[bus].process.kill()

    def _look(self):
        for bus, file in self.truth_files.items():
            if file.exists():
                self._found += life_violations(self.parts[bus], load_truth(file))
                file.unlink()


@pytest.fixture
def stack(arm_name, tmp_path):
    ends = contextlib.ExitStack()
    with ends:
        made = DividedStack(arm_name, tmp_path, recorded(GOAL).trajectory.points[0].positions)
        ends.callback(made.close)
        made.start_sims()
        made.start_loop()
        made.start_front()
        made.client = Client(f"controller_{arm_name}")
        ends.callback(made.client.close)
        yield made


def test_a_goal_moves_the_joints_of_both_buses(stack):
    goal = recorded(GOAL).trajectory
    state, code, words = stack.client.run(recorded(GOAL))
    assert (state, code) == (SUCCEEDED, 0), words
    wanted = dict(zip(goal.joint_names, goal.points[-1].positions, strict=True))
    for bus, part in stack.parts.items():
        until(lambda bus=bus: not moves(stack, bus), f"standing drives on bus {bus}")
        truth = stack.truth_of(bus)
        assert list(truth) == [joint.name for joint in part.joints]
        for joint in part.joints:
            position_rad = truth[joint.name].position_rad
            assert np.ptp(position_rad) > 0.1, joint.name
            assert position_rad[-1] == pytest.approx(wanted[joint.name], abs=joint.slack_rad)


@pytest.mark.parametrize(("gone", "left"), [(SHOULDER, WRIST), (WRIST, SHOULDER)])
def test_when_the_adapter_of_one_bus_goes_the_drives_on_the_other_come_to_rest(stack, gone, left):
    handle = stack.client.send(recorded(GOAL))
    until(lambda: moves(stack, left) and moves(stack, gone), "motion on both buses")
    stack.unplug_bus(gone)
    gone_ns = time.monotonic_ns()
    state, _, words = stack.client.result(handle)
    assert state == ABORTED, words
    report = stack.until(lambda report: report["mode"] == "fault")
    assert report["fault"]["name"] == "wire", report["fault"]

    longest_s = load_arm(stack.arm_file).longest_stop_s
    until(lambda: not moves(stack, left), f"standing drives on bus {left}", longest_s)
    truth, now_ns = stack.truth_of(left), time.monotonic_ns()
    stood_ns = stands_since_ns(truth, now_ns)
    assert gone_ns < stood_ns < gone_ns + round(longest_s * 1e9)
    assert stack.loop.process.poll() is None


def moves(stack, bus):
    truth, now_ns = stack.truth_of(bus), np.array([time.monotonic_ns()])
    return any(abs(joint.velocity_at(now_ns)[0]) > 0.0 for joint in truth.values())
