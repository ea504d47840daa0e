"""The simulator as a real process at a real terminal, and strangers who open it."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest
import serial
from two_buses import write_divided

from config.loader import load_arm
from sim.drives.families import FAMILIES
from sim.truth import load_truth, load_wire

pytestmark = pytest.mark.process

PATIENCE_S = 20.0


class Process:
    """A running `python -m sim`."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.link = folder / "tty"
        self.truth = folder / "truth.npz"
        command = [sys.executable, "-m", "sim", "--arm", "episode1", "--link", str(self.link)]
        self.process = subprocess.Popen(
            [*command, "--truth", str(self.truth), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.tty = self.line("ready ")

    def line(self, start: str) -> str:
        text = self.process.stdout.readline().rstrip("\n")
        assert text.startswith(start)
        return text.removeprefix(start)

    def tell(self, fault: str) -> str:
        self.process.stdin.write(fault + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().rstrip("\n")

    def end(self, number: int = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


@pytest.fixture
def start(tmp_path) -> Iterator:
    running = []

    def start(*options: str) -> Process:
        running.append(Process(tmp_path, *options))
        return running[-1]

    yield start
    for simulator in running:
        simulator.process.kill()
        simulator.process.wait()
        simulator.process.stdin.close()
        simulator.process.stdout.close()


def exchange(descriptor: int, request: bytes, end: bytes) -> bytes:
    """Write, and read until `end` has come."""
    os.write(descriptor, request)
    answer = b""
    deadline = time.monotonic() + PATIENCE_S
    while end not in answer:
        assert time.monotonic() < deadline, answer
        if select.select([descriptor], [], [], 0.1)[0]:
            answer += os.read(descriptor, 4096)
    return answer


def test_python_can_reads_a_position(start):
    simulator = start("--start-deg", "0,0,0,0,0,0")
    with can.Bus(interface="slcan", channel=str(simulator.link), bitrate=500_000, sleep_after_open=0) as bus:
        bus.send(can.Message(arbitration_id=0x100, data=bytes.fromhex("36 6B"), is_extended_id=True))
        answer = bus.recv(PATIENCE_S)
    assert answer is not None
    assert answer.is_extended_id
    assert answer.arbitration_id == 0x100
    assert bytes(answer.data) == bytes.fromhex("36 00 00 0C 80 00 6B")


def test_port_opened_closed_and_opened_again(start):
    simulator = start()
    for setup in (b"S6\rO\r", b""):  # the adapter knows nothing of the closing
        with serial.Serial(str(simulator.link), 1_000_000, timeout=PATIENCE_S) as port:
            port.write(setup + b"T000003002366B\r")
            assert port.read_until(b"6B\r").endswith(b"T00000300736000005C3856B\r")  # 18,444 pulses
    assert simulator.process.poll() is None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_cleanly(start, number):
    simulator = start()
    assert os.path.realpath(simulator.link) == simulator.tty
    assert simulator.end(number) == 0
    assert not os.path.lexists(simulator.link)
    assert simulator.truth.exists()


def test_truth_of_a_move_on_demand_and_at_the_end(start):
    simulator = start()
    begin_ns = time.monotonic_ns()
    port = os.open(simulator.link, os.O_RDWR | os.O_NOCTTY)
    try:
        exchange(port, b"S6\rO\rT000006008FD00006400000003\rT000006015FD0B01006B\r", b"FD026B\r")
        # from 267 to 779 pulses at 100 rpm: 96 ms
        while b"T000006007360000003E516B" not in exchange(port, b"T000006002366B\r", b"6B\r"):
            assert time.monotonic_ns() - begin_ns < PATIENCE_S * 1e9
    finally:
        os.close(port)
    simulator.process.send_signal(signal.SIGUSR1)
    assert simulator.line("truth ") == str(simulator.truth)
    first = load_truth(simulator.truth)
    assert list(first) == [f"joint{number}" for number in range(1, 7)]
    moved = first["joint6"]
    assert begin_ns < moved.times_ns[1] < moved.times_ns[2] <= moved.times_ns[-1] <= time.monotonic_ns()
    assert moved.velocity_rad_s.max() == pytest.approx(10.471976)
    middle_ns = np.array([(moved.times_ns[1] + moved.times_ns[2]) // 2])
    assert moved.velocity_at(middle_ns)[0] == pytest.approx(10.471976)
    expected = (moved.position_rad[1] + moved.position_rad[2]) / 2
    assert moved.position_at(middle_ns)[0] == pytest.approx(expected, abs=1e-6)
    heard = load_wire(simulator.truth)
    assert b"".join(data for _, data in heard).startswith(b"S6\rO\rT000006008FD00006400000003\rT000006015FD0B01006B\r")
    assert begin_ns < heard[0][0] <= heard[-1][0] < time.monotonic_ns()
    simulator.truth.unlink()
    assert simulator.end() == 0
    last = load_truth(simulator.truth)["joint6"]
    assert last.times_ns[-1] > moved.times_ns[-1]
    assert last.position_rad[-1] == moved.position_rad[-1]


def test_what_lies_before_the_window_is_forgotten(start):
    simulator = start("--truth-window-s", "0.2")

    def asked() -> None:
        simulator.process.send_signal(signal.SIGUSR1)
        simulator.line("truth ")

    port = os.open(simulator.link, os.O_RDWR | os.O_NOCTTY)
    try:
        exchange(port, b"S6\rO\rT000006008FD00006400000003\rT000006015FD0B01006B\r", b"FD026B\r")
        asked()
        assert len(load_truth(simulator.truth)["joint6"].times_ns) > 1
        assert load_wire(simulator.truth)
        deadline = time.monotonic() + PATIENCE_S
        while len(load_truth(simulator.truth)["joint6"].times_ns) > 2:
            assert time.monotonic() < deadline
            asked()
    finally:
        os.close(port)
    left = load_truth(simulator.truth)["joint6"]
    assert left.position_rad[0] == left.position_rad[1]
    assert load_wire(simulator.truth) == []


def test_faults_and_unhomed_drives_from_the_command_line(start):
    simulator = start("--unhomed", "--fault", "silent:joint=joint2,at_s=0", "--dialect", "canable")
    port = os.open(simulator.link, os.O_RDWR | os.O_NOCTTY)
    try:
        answer = exchange(port, b"S6\rO\rT000002002366B\rT0000010023A6B\r", b"6B\r")
    finally:
        os.close(port)
    assert answer == b"T0000010033A836B\r"


def test_faults_while_it_runs(start):
    simulator = start("--faults-from-stdin")
    port = os.open(simulator.link, os.O_RDWR | os.O_NOCTTY)
    try:
        exchange(port, b"S6\rO\rT000001002366B\r", b"6B\r")
        assert simulator.tell("power-loss:joint=joint1,at_s=0,off_s=0") == (
            "fault power-loss:joint=joint1,at_s=0,off_s=0"
        )
        assert b"T0000010033A836B" in exchange(port, b"T0000010023A6B\r", b"6B\r")
    finally:
        os.close(port)
    assert simulator.tell("stall:joint=elbow,at_s=0").startswith("refused arm episode1 has no joint 'elbow'")
    simulator.process.stdin.close()
    assert simulator.end() == 0


def test_a_stale_link_is_replaced_but_a_file_is_not(start, tmp_path):
    (tmp_path / "tty").symlink_to("/nonexistent")
    simulator = start()
    assert os.path.realpath(simulator.link) == simulator.tty
    assert simulator.end() == 0
    (tmp_path / "tty").write_text("precious")
    command = [sys.executable, "-m", "sim", "--arm", "episode1", "--link", str(tmp_path / "tty")]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert refused.returncode == 2
    assert refused.stderr.endswith("is not a symbolic link, so it is not replaced; choose another path.\n")
    assert (tmp_path / "tty").read_text() == "precious"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--arm", "nonesuch"], "nonesuch"),
        (["--arm", "episode1", "--fault", "explosion"], "there is no fault 'explosion'"),
        (["--arm", "episode1", "--start-deg", "1,2"], "2 joint positions were given"),
        (["--arm", "episode1", "--start-deg", "a"], "must be numbers"),
        (["--arm", "episode1", "--link", "/nonexistent/tty"], "there is no folder /nonexistent"),
        (["--arm", "episode1", "--truth", "/nonexistent/truth.npz"], "there is no folder"),
        (
            ["--arm", "episode1", "--bus", "wrist"],
            "--bus is wrist, which is no bus of arm episode1; it has one without a name: leave --bus out.",
        ),
        (["--arm", "mock"], f"has a mock drive, but only {', '.join(FAMILIES)} drives can be simulated"),
    ],
)
def test_bad_options_are_one_sentence(options, sentence, capsys):
    from sim.__main__ import main

    assert main(options) == 2
    assert sentence in capsys.readouterr().err


def test_a_process_simulates_one_bus_of_several(start, tmp_path):
    """The third angle of the wrist's joints is the whole arm's sixth, and their identifiers are the shoulder's."""
    file = write_divided("episode1", tmp_path / "arm.yaml")
    angles_deg = dict(zip((joint.name for joint in load_arm(file).joints), (10, 20, 30, 40, 50, 60), strict=True))
    given = "--start-deg=" + ",".join(str(angle) for angle in angles_deg.values())
    simulator = start("--arm", str(file), "--bus", "wrist", given)
    assert simulator.end() == 0
    truth = load_truth(simulator.truth)
    assert list(truth) == ["joint4", "joint5", "joint6"]
    for name, joint in truth.items():
        assert np.degrees(joint.position_rad[0]) == pytest.approx(angles_deg[name], abs=0.1)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            [],
            "arm episode1 has 2 buses, and one process simulates one: give --bus with one of shoulder, wrist, and "
            "start a process for each.",
        ),
        (
            ["--bus", "wrsit"],
            "--bus is wrsit, which is no bus of arm episode1 (did you mean wrist?); it has shoulder, wrist; name one "
            "of them.",
        ),
        (
            ["--bus", "wrist", "--start-deg", "1,2,3"],
            "--start-deg has 3 angles, but arm episode1 has 6 joints on all its buses; give one for each.",
        ),
    ],
)
def test_what_is_no_bus_of_several_is_one_sentence(options, sentence, tmp_path, capsys):
    from sim.__main__ import main

    assert main(["--arm", str(write_divided("episode1", tmp_path / "arm.yaml")), *options]) == 2
    assert capsys.readouterr().err == f"sim: {sentence}\n"
