"""What a wire did not take in its cycle is not sent late, but no drive is left with half a command."""

import errno
import os
import socket

import by_address
import numpy as np
import pytest
from can_records import unpacked
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from config.loader import load_arm
from rtloop.memory.link import CAN_FRAME_BYTES, TX_FRAMES
from rtloop.process import run
from rtloop.process.initial_state import new_loop
from rtloop.wire import outgoing, received
from shm import layout

INTERFACES = ("slcan", "socketcan", "python-can")
BESIDES = {"python-can": {"channel": "here", "python_can": {"interface": "virtual"}}}
CYCLE = [(0x300, 1), (0x301, 0), (0x400, 1), (0x401, 0), (0x100, 0), (0x200, 0)]
"""Identifiers of a cycle's frames, and whether the next one belongs to the same command."""
FIRST, SECOND = b"\x11", b"\x22"


class Sender:
    """A loop's transmit buffer, filled and emptied by hand."""

    def __init__(self, interface):
        self.loop = new_loop(
            load_arm("episode1", overrides={"bus": {"interface": interface, **BESIDES.get(interface, {})}}), 0, 0
        )
        self.shared = np.zeros(1, layout.StateFile.dtype)
        self.is_serial = interface == "slcan"

    def fill(self, mark, frames=CYCLE):
        by_address.begin(self.loop.ctypes.data, self.shared.ctypes.data)
        for can_id, joined in frames:
            assert by_address.put(self.loop.ctypes.data, can_id, True, 1, mark[0], joined)
            self.shared[0]["counters"]["frames_sent"] += 1

    @property
    def bus(self):
        return self.loop[0]["buses"][0]

    @property
    def buffer(self):
        outgoing = self.bus["outgoing"]
        return outgoing["bytes"][: int(outgoing["length"])].tobytes()

    def take(self, count):
        data = self.buffer[:count]
        by_address.took(self.loop.ctypes.data, self.shared.ctypes.data, count)
        return data

    def frames(self, data):
        """(identifier, mark) of every frame that arrived; fails on what is none."""
        if not self.is_serial:
            return [(word & 0x1FFFFFFF, content) for word, content in unpacked(data)]
        *lines, rest = data.split(b"\r")
        assert rest == b""
        assert all(line[:1] == b"T" and line[9:10] == b"1" and len(line) == 12 for line in lines)
        return [(int(line[1:9], 16), bytes.fromhex(line[10:].decode())) for line in lines]


def torn(frames):
    """Commands of which a drive got one packet only: in each filling the first two identifiers are packets of one."""
    found, waits_for = [], None
    for can_id, mark in frames:
        if waits_for not in (None, (can_id, mark)) or (can_id & 0xFF == 1 and waits_for is None):
            found.append((can_id, mark))
        waits_for = (can_id + 1, mark) if can_id in (0x300, 0x400) else None
    return found


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("share", [0.0, 0.05, 0.2, 0.3, 0.49, 0.6, 0.7, 0.95, 1.0])
def test_only_what_is_owed_is_sent_late(interface, share):
    sender = Sender(interface)
    sender.fill(FIRST)
    size = 1 if interface == "slcan" else CAN_FRAME_BYTES
    count = int(len(sender.buffer) * share) // size * size
    arrived = sender.take(count)
    sender.fill(SECOND)
    frames = sender.frames(arrived + sender.take(len(sender.buffer)))
    late = frames[: len(frames) - len(CYCLE)]
    assert [mark for _, mark in late] == [FIRST] * len(late)
    assert frames[len(late) :] == [(can_id, SECOND) for can_id, _ in CYCLE]
    if late:  # no command of the first cycle is left half sent
        assert CYCLE[len(late) - 1][1] == 0
    counters = sender.shared[0]["counters"]
    assert counters["frames_sent"] == len(frames)


@pytest.mark.parametrize("interface", INTERFACES)
@settings(deadline=None, max_examples=examples(150))
@given(data=st.data())
def test_whatever_a_wire_takes_no_command_is_torn(interface, data):
    """Cycle after cycle with any part taken: frames arrive whole, and every first packet is followed by its second."""
    sender = Sender(interface)
    arrived = b""
    for number in range(data.draw(st.integers(1, 6))):
        sender.fill(bytes((number,)))
        size = 1 if interface == "slcan" else CAN_FRAME_BYTES
        arrived += sender.take(data.draw(st.integers(0, len(sender.buffer) // size)) * size)
    sender.fill(b"\xee")
    frames = sender.frames(arrived + sender.take(len(sender.buffer)))
    assert torn(frames) == []
    marks = [mark[0] for _, mark in frames]
    assert marks == sorted(marks)
    assert frames[-len(CYCLE) :] == [(can_id, b"\xee") for can_id, _ in CYCLE]
    counters = sender.shared[0]["counters"]
    assert counters["frames_sent"] == len(frames)


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_wire_that_takes_nothing_for_long_holds_back_no_more_than_a_command(interface):
    sender = Sender(interface)
    sender.fill(FIRST)
    one = len(sender.buffer) // len(CYCLE)
    sender.take(one)
    for _ in range(100):
        sender.fill(SECOND)
        assert len(sender.buffer) == (len(CYCLE) + 1) * one
        sender.take(0)
        assert sender.buffer[:one] == sender.buffer
    assert sender.shared[0]["counters"]["bytes_unsent"] == 4 * one + 100 * len(CYCLE) * one


@pytest.mark.parametrize("interface", INTERFACES)
def test_nothing_of_before_is_sent_on_another_wire(interface):
    sender = Sender(interface)
    sender.fill(FIRST)
    sender.take(len(sender.buffer) // len(CYCLE))
    assert sender.buffer
    outgoing.forget(sender.loop[0], sender.shared[0], sender.bus)
    sender.fill(SECOND)
    assert {mark for _, mark in sender.frames(sender.buffer)} == {SECOND}


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_full_buffer_takes_no_more_frames(interface):
    sender = Sender(interface)
    count = 0
    while outgoing.put(sender.bus, 0, 0x100, True, 8, -1, 0):
        count += 1
    assert count == int(sender.bus["outgoing"]["frames"]) <= TX_FRAMES
    assert not outgoing.has_room(sender.bus, 1)


# --- batches, over a socket that keeps the borders of messages as a raw CAN socket does ---------------------


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    theirs.setblocking(False)
    yield ours, theirs
    ours.close()
    theirs.close()


def messages(theirs):
    found = []
    while True:
        try:
            data = theirs.recv(1 << 16)
        except BlockingIOError:
            return found
        if not data:
            return found
        found.append(data)


def test_a_cycles_frames_leave_one_message_each(pair):
    sender = Sender("socketcan")
    sender.fill(FIRST)
    run.send_bytes(sender.loop[0], sender.shared[0], sender.bus, pair[0].fileno())
    found = messages(pair[1])
    assert [len(message) for message in found] == [CAN_FRAME_BYTES] * len(CYCLE)
    assert sender.frames(b"".join(found)) == [(can_id, FIRST) for can_id, _ in CYCLE]
    assert sender.buffer == b""
    assert sender.shared[0]["counters"]["bytes_sent"] == len(CYCLE) * CAN_FRAME_BYTES


def test_a_full_queue_tears_no_command(pair):
    """Cycles into a socket that nobody reads, until it is full; then all is read and the next cycle is whole."""
    pair[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    sender = Sender("socketcan")
    for number in range(50):
        sender.fill(bytes((number,)))
        run.send_bytes(sender.loop[0], sender.shared[0], sender.bus, pair[0].fileno())
    assert received.closed(sender.loop[0]["buses"][0]) == 0
    counters = sender.shared[0]["counters"]
    assert counters["bytes_unsent"] > 0
    found = messages(pair[1])
    sender.fill(b"\xee")
    held_back = len(sender.buffer) - len(CYCLE) * CAN_FRAME_BYTES
    assert held_back in (0, CAN_FRAME_BYTES)
    run.send_bytes(sender.loop[0], sender.shared[0], sender.bus, pair[0].fileno())
    found += messages(pair[1])
    frames = sender.frames(b"".join(found))
    assert counters["frames_sent"] == len(frames)
    assert torn(frames) == []


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_wire_that_refuses_is_closed_and_nothing_is_kept(interface):
    sender = Sender(interface)
    sender.fill(FIRST)
    descriptor = os.open("/dev/null", os.O_RDONLY)
    run.send_bytes(sender.loop[0], sender.shared[0], sender.bus, descriptor)
    os.close(descriptor)
    expected = errno.ENOTSOCK if interface == "socketcan" else errno.EBADF
    assert received.closed(sender.loop[0]["buses"][0]) == expected + 1
    assert sender.buffer == b""


def test_frames_are_read_in_batches(pair):
    sender = Sender("socketcan")
    records = [bytes((number,)) * CAN_FRAME_BYTES for number in range(20)]
    for data in records:
        pair[1].send(data)
    count = run.read_some(sender.bus, pair[0].fileno())
    assert count == len(records) * CAN_FRAME_BYTES
    assert sender.bus["reader"]["bytes"][:count].tobytes() == b"".join(records)
    assert run.read_some(sender.bus, pair[0].fileno()) == -1
