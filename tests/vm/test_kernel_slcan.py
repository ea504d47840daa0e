"""The kernel's own SLCAN driver, as `slcand` attaches it, between a simulated serial adapter and a raw CAN socket."""

import fcntl
import os
import select
import struct
import subprocess
import termios
import time
import tty as std_tty

import pytest
from can_records import record
from served_arm import serving

from config.drives.zdt import zdt_identifiers
from config.loader import load_arm
from rtloop.wire import tty
from rtloop.wire.can_link import can_interfaces
from rtloop.wire.can_socket import open_socketcan
from rtloop.wire.refusal import WireRefused
from sim.arm import SimulatedArm
from sim.pty import PtyServer

PATIENCE_S = 30.0
BITRATE = 500_000
HEARD = [used for address in range(1, 7) for used in zdt_identifiers(address)]
POSITION = bytes.fromhex("36 00 00 0C 80 00 6B")
"""Of joint1 at 0: half a turn from its stop, by 25."""


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True)


@pytest.fixture(params=["lawicel", "canable", "canable2"])
def terminal(request):
    bus = {"channel": "simulated", "serial_baud": "cdc"}
    arm = SimulatedArm(
        load_arm("episode1", overrides={"bus": bus}), start_ns=time.monotonic_ns(), dialect=request.param
    )
    with serving(PtyServer(arm)) as server:
        yield server.tty_path


@pytest.fixture
def attached(terminal):
    """The CAN interface that the kernel makes of the terminal."""
    before = set(can_interfaces())
    fd = os.open(terminal, os.O_RDWR | os.O_NOCTTY)
    std_tty.setraw(fd)
    fcntl.ioctl(fd, termios.TIOCSETD, struct.pack("i", tty.N_SLCAN))
    (name,) = set(can_interfaces()) - before
    ip("link", "set", name, "txqueuelen", "128", "type", "can", "bitrate", str(BITRATE))
    ip("link", "set", name, "up")
    yield name
    ip("link", "set", name, "down")
    fcntl.ioctl(fd, termios.TIOCSETD, struct.pack("i", 0))
    os.close(fd)


def test_a_drive_answers_through_the_kernels_driver(attached):
    fd, complaints = open_socketcan(attached, BITRATE, HEARD, 19, 6)
    assert complaints == []
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not select.select([fd], [], [], 1.0)[0]:
            assert time.monotonic() < deadline
            os.write(fd, record(0x100, b"\x36\x6b"))
        assert os.read(fd, 16) == record(0x100, POSITION)
    finally:
        os.close(fd)


def test_the_port_is_left_to_the_kernel(attached, terminal):
    with pytest.raises(WireRefused, match="is attached to the kernel's own SLCAN driver: end slcand"):
        tty.open_slcan(terminal, "cdc", BITRATE)
    ip("link", "show", attached)
