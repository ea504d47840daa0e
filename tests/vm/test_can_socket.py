"""The raw CAN socket as the kernel really has it: what passes, what does not, what is refused with which sentence."""

import contextlib
import errno
import fcntl
import os
import pty
import socket
import struct
import subprocess
import termios
import threading

import pytest
from can_records import ERROR, EXTENDED, REMOTE, error_record, record

from config.drives.zdt import zdt_identifiers
from rtloop.wire import can_words
from rtloop.wire.can_link import bitrate_in, can_interfaces, link_of
from rtloop.wire.can_socket import dropped_frames, frames_held_back, holds_back, open_socketcan
from rtloop.wire.refusal import WireRefused

DRIVES = [1, 2, 3, 4, 5, 6]
HEARD = [used for address in DRIVES for used in zdt_identifiers(address)]
FRAMES_PER_CYCLE = 19
READING = bytes((0x36, 0, 0, 0, 0x40, 0, 0x6B))
BITRATE = 500_000
N_SLCAN = 17
BURST = 100 // 16 + 1


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True)


@pytest.fixture
def ours():
    fd, complaints = open_socketcan("vcan0", BITRATE, HEARD, FRAMES_PER_CYCLE, len(HEARD))
    assert complaints == []
    yield fd
    os.close(fd)


@pytest.fixture
def other():
    """Another node of the bus, without filters."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as opened:
        opened.bind(("vcan0",))
        opened.setblocking(False)
        yield opened


def waiting(read):
    """All frames that wait; vcan delivers before a write returns."""
    found = []
    while True:
        try:
            found.append(read())
        except BlockingIOError:
            return found


def heard(fd):
    return waiting(lambda: os.read(fd, 16))


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("packet", [0, 1, 4, 255])
def test_replies_of_the_arms_drives_pass(ours, other, drive, packet):
    frame = record(drive << 8 | packet, READING)
    other.send(frame)
    assert heard(ours) == [frame]


@pytest.mark.parametrize(
    "frame",
    [
        record(0x700, READING),  # a drive of another arm
        record(0x000, READING),  # to everybody
        record(0x1_0100, READING),
        record(0x1FFF_FF00, READING),
        record(0x100, READING, flags=0),  # a standard identifier
        record(0x100, READING, flags=EXTENDED | REMOTE),
        record(0x100, READING, flags=REMOTE),
    ],
)
def test_nothing_else_passes(ours, other, frame):
    other.send(frame)
    assert heard(ours) == []


@pytest.mark.parametrize("bit", range(12))
def test_errors_pass_that_are_decoded(ours, other, bit):
    frame = error_record(1 << bit, b"\1\2\3\4\5\6\7\x08")
    other.send(frame)
    assert heard(ours) == ([frame] if can_words.WATCHED & 1 << bit else [])


def test_what_is_sent_is_on_the_bus_and_does_not_come_back(ours, other):
    frame = record(0x101, b"\xfd\1\2\3\4")
    os.write(ours, frame)
    assert waiting(lambda: other.recv(16)) == [frame]
    assert heard(ours) == []


def test_frames_that_nobody_reads_are_lost_and_counted(ours, other):
    for _ in range(20_000):
        other.send(record(0x100, READING))
    lost = dropped_frames(ours)
    assert 0 < lost < 20_000 - 2 * FRAMES_PER_CYCLE
    assert len(heard(ours)) == 20_000 - lost


# --- what leaves late, and what does not leave ------------------------------------------------------


@pytest.fixture
def slow_bus():
    """vcan0 as a bus that carries a frame in 16 s, with a queue of so many frames."""

    def make(frames):
        queue = ["root", "tbf", "rate", "8bit", "burst", "100b", "limit", f"{frames * 16}b"]
        subprocess.run(["tc", "qdisc", "replace", "dev", "vcan0", *queue], check=True)

    yield make
    subprocess.run(["tc", "qdisc", "del", "dev", "vcan0", "root"], check=True)


def test_the_system_holds_back_little(ours, slow_bus):
    """What it holds is as old as the bus is behind: a few cycles' frames and the stop commands, and no more."""
    assert not holds_back(ours)
    slow_bus(10_000)
    taken = 0
    with pytest.raises(BlockingIOError):
        while True:
            os.write(ours, record(0x100, b"\x36\x6b"))
            taken += 1
    assert FRAMES_PER_CYCLE < taken <= frames_held_back(FRAMES_PER_CYCLE, len(DRIVES)) + BURST
    assert holds_back(ours)


def test_a_short_queue_refuses_with_enobufs(ours, slow_bus):
    slow_bus(5)
    with pytest.raises(OSError) as refused:
        for _ in range(FRAMES_PER_CYCLE):
            os.write(ours, record(0x100, b"\x36\x6b"))
    assert refused.value.errno == errno.ENOBUFS


# --- what is refused, and what is said ---------------------------------------------------------------


def test_what_the_system_says_of_an_interface():
    assert "vcan0" in can_interfaces()
    found = link_of("vcan0")
    assert found is not None
    assert (found.is_up, found.bitrate) == (True, None)
    assert link_of("lo") is None
    assert link_of("can9") is None


@pytest.mark.parametrize(("name", "said"), [("can9", "There is no CAN interface can9"), ("lo", "no CAN interface lo")])
def test_no_such_interface(name, said):
    with pytest.raises(WireRefused, match=said):
        open_socketcan(name, BITRATE, HEARD, FRAMES_PER_CYCLE, len(HEARD))


def test_an_interface_that_is_down():
    ip("link", "add", "dev", "vcan1", "type", "vcan")
    try:
        with pytest.raises(WireRefused, match=r"vcan1 is down: .*txqueuelen 128.*bitrate 500000 restart-ms 100"):
            open_socketcan("vcan1", BITRATE, HEARD, FRAMES_PER_CYCLE, len(HEARD))
        ip("link", "set", "vcan1", "txqueuelen", "10", "up")
        fd, complaints = open_socketcan("vcan1", BITRATE, HEARD, FRAMES_PER_CYCLE, len(HEARD))
        os.close(fd)
        assert len(complaints) == 1
        assert "holds back 10 frames and a cycle sends 19" in complaints[0]
    finally:
        ip("link", "del", "vcan1")


@pytest.fixture
def serial_interface():
    """A CAN interface with a bit rate: the kernel's own SLCAN line discipline on a pseudo-terminal."""
    before = set(can_interfaces())
    master, slave = pty.openpty()
    listener = threading.Thread(target=drain, args=(master,))
    listener.start()
    fcntl.ioctl(slave, termios.TIOCSETD, struct.pack("i", N_SLCAN))
    (name,) = set(can_interfaces()) - before
    ip("link", "set", name, "type", "can", "bitrate", "250000")
    ip("link", "set", name, "up")
    yield name
    ip("link", "set", name, "down")
    os.close(slave)  # the last user of the line discipline: the interface goes, and the adapter's side hears the end
    listener.join()
    os.close(master)


def drain(master):
    """An adapter that takes whatever it is told."""
    with contextlib.suppress(OSError):
        while os.read(master, 4096):
            pass


def test_another_bit_rate_is_refused(serial_interface):
    found = link_of(serial_interface)
    assert found is not None
    assert found.bitrate == 250_000
    said = rf"{serial_interface} runs at 250000 bit/s, and the arm's bus.bitrate is 500000"
    with pytest.raises(WireRefused, match=said):
        open_socketcan(serial_interface, BITRATE, HEARD, FRAMES_PER_CYCLE, len(HEARD))
    fd, _ = open_socketcan(serial_interface, 250_000, HEARD, FRAMES_PER_CYCLE, len(HEARD))
    os.close(fd)


def test_an_answer_without_bit_rate_is_none():
    assert bitrate_in(b"") is None
    assert ERROR == 0x20000000
