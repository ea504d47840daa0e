"""The simulated arm on a bus of python-can: which bus, what passes in either direction, and the end."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from served_arm import serving

from config.loader import load_arm
from sim.arm import SimulatedArm
from sim.bus import Frame
from sim.python_can_host import PythonCanServer, frame_of, message_of, opened

PATIENCE_S = 10.0
BUS = {"interface": "python-can", "channel": "here", "usb_index": None, "python_can": {"interface": "virtual"}}
READ_POSITION = can.Message(arbitration_id=0x300, data=b"\x36\x6b")


def arm_on(**bus):
    return load_arm("episode1", overrides={"bus": {**BUS, **bus}})


@pytest.fixture
def host() -> Iterator[can.BusABC]:
    """A node beside the simulated drives."""
    channel = f"test-{time.monotonic_ns()}"
    before = set(threading.enumerate())
    with (
        can.Bus(channel, "virtual", ignore_config=True) as ours,
        opened(f"interface=virtual,channel={channel}", 500_000) as theirs,
        serving(PythonCanServer(SimulatedArm(arm_on(), start_ns=time.monotonic_ns()), theirs)) as server,
    ):
        server.heard = []
        ours.server = server
        yield ours
    assert set(threading.enumerate()) <= before


def test_a_drive_answers_what_it_is_asked(host):
    for _ in range(3):
        host.send(READ_POSITION)
        answer = host.recv(PATIENCE_S)
        assert (answer.arbitration_id, answer.is_extended_id, answer.data[:1]) == (0x300, True, b"\x36")
    assert len(host.server.heard) == 3
    assert host.server.dropped_frames == 0


def test_what_no_drive_hears_disturbs_nobody(host):
    host.send(can.Message(arbitration_id=0x300, data=bytes(32), is_fd=True))
    host.send(can.Message(is_error_frame=True))
    host.send(can.Message(arbitration_id=0x300, is_remote_frame=True, dlc=8))
    host.send(READ_POSITION)
    assert host.recv(PATIENCE_S).data[0] == 0x36
    assert len(host.server.heard) == 2


def test_answers_that_the_bus_does_not_take_are_counted(host, monkeypatch):
    def full(*_arguments):
        raise can.CanOperationError("full")

    monkeypatch.setattr(host.server._bus, "send", full)
    host.send(READ_POSITION)
    deadline = time.monotonic() + PATIENCE_S
    while host.server.dropped_frames == 0:
        assert time.monotonic() < deadline


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x12ABCDEF, b"\x01\x02"),
        Frame(0x7FF, bytes(8), extended=False),
        Frame(0x123, bytes(8), extended=False, remote=True),
        Frame(0, b""),
    ],
)
def test_frames_are_the_same_on_both_sides(frame):
    assert frame_of(message_of(frame)) == frame


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("pcan", "must be KEY=VALUE with commas between"),
        ("channel=x", "must name an interface"),
        ("interface=virtuel,channel=x", "python-can cannot open interface=virtuel,channel=x"),
        ("interface=pcan,channel=PCAN_USBBUS2", "python-can cannot open"),
    ],
)
def test_a_bus_that_there_is_not_is_refused(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        opened(text, 500_000)


def ends_with(arguments: list[str]) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "sim", *arguments],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    return done.returncode, done.stderr


def test_where_the_simulated_drives_live_must_suit_the_arm():
    on_python_can = ["--set=bus.interface=python-can", "--set=bus.channel=x", "--set=bus.python_can.interface=pcan"]
    code, said = ends_with(["--arm", "episode1", *on_python_can])
    assert code == 2
    assert "name the simulated drives' end of its bus, as in --python-can interface=pcan" in said
    code, said = ends_with(["--arm", "episode1", "--python-can", "interface=virtual,channel=x"])
    assert code == 2
    assert "--python-can is for an arm with interface python-can alone" in said
