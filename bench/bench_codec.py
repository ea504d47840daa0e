"""Encoding and decoding the frames of one cycle: our codec against python-can's Message and slcan bus.

One cycle of six joints: out go six position commands of two frames, six position requests and one status
request; in come six positions and one status. Both sides start from the same numbers, write the same bytes
(asserted) and end with the same numbers. python-can's serial port is a buffer in memory written in C, so that
no driver and no cable is measured; what remains is its own work: Message, formatting, parsing.
"""

import io
import struct

import can
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus

from compilation.jit import jit
from config.loader import load_arm
from rtloop.drives import zdt
from rtloop.process.initial_state import new_loop
from rtloop.wire import slcan

CYCLES = 1000
RPM = np.array([57, 43, 120, 3, 200, 99])
ACC = np.array([155, 200, 160, 180, 190, 222])
PULSES = np.array([-40_000, 12_345, 3, 129_536, -7, 1_000_000])
COUNTS = np.array([65_536, -65_536, 0, 1_234_567, -3, 40])
REPLIES = b"".join(
    b"T%08X736%02X%08X6B\r" % ((joint + 1) << 8, counts < 0, abs(counts))
    for joint, counts in enumerate(COUNTS.tolist())
) + b"T0000010033A036B\r"  # fmt: skip


@jit
def our_cycles(loop, rpm, acc, pulses, replies, counts, cycles):
    """Encode and decode the frames of a cycle, `cycles` times; the status flags decoded last.

    The targets differ from cycle to cycle, the last cycle's are `pulses`.
    """
    status = 0
    for left in range(cycles - 1, -1, -1):
        loop.buses[0].outgoing.length = 0
        for joint in range(len(rpm)):
            first, second = zdt.pack_target(rpm[joint], acc[joint], pulses[joint] - left)
            slcan.encode_frame(loop.buses[0], (joint + 1) << 8, True, 8, first)
            slcan.encode_frame(loop.buses[0], ((joint + 1) << 8) | 1, True, 5, second)
        for joint in range(len(rpm)):
            slcan.encode_frame(loop.buses[0], (joint + 1) << 8, True, 2, zdt.READ_POSITION)
        slcan.encode_frame(loop.buses[0], 0x100, True, 2, zdt.READ_STATUS)
        for byte in replies:
            if slcan.collect(loop.buses[0], byte):
                _, frame_id, _, length, data = slcan.decode_line(loop.buses[0])
                kind, value = zdt.decode(frame_id & 255, length, data)
                if kind == zdt.POSITION:
                    counts[(frame_id >> 8) - 1] = value
                elif kind == zdt.STATUS:
                    status = value
                loop.buses[0].parser.line_length = 0
    return status


class MemoryPort(io.BytesIO):
    """A serial port whose other end is memory."""

    write_timeout = None
    in_waiting = 0


@pytest.fixture
def bus(monkeypatch):
    monkeypatch.setattr("can.interfaces.slcan.serial.serial_for_url", lambda *_, **__: MemoryPort())
    with slcanBus("memory", sleep_after_open=0) as opened:
        yield opened


def their_cycle(bus, counts):
    """The same cycle with python-can; bytes sent, status flags."""
    out = bus.serialPortOrig = MemoryPort()
    for joint in range(6):
        address = (joint + 1) << 8
        pulses = int(PULSES[joint])
        body = struct.pack(">BBHBI", 0xFD, pulses < 0, RPM[joint], ACC[joint], abs(pulses)) + b"\x01\x00\x6b"
        bus.send(can.Message(arbitration_id=address, data=body[:8], is_extended_id=True))
        bus.send(can.Message(arbitration_id=address | 1, data=b"\xfd" + body[8:], is_extended_id=True))
    for joint in range(6):
        bus.send(can.Message(arbitration_id=(joint + 1) << 8, data=b"\x36\x6b", is_extended_id=True))
    bus.send(can.Message(arbitration_id=0x100, data=b"\x3a\x6b", is_extended_id=True))
    status = 0
    bus.serialPortOrig = MemoryPort(REPLIES)
    bus.serialPortOrig.in_waiting = len(REPLIES)
    for _ in range(7):
        message = bus.recv(0)
        data = message.data
        if data[0] == 0x36:
            sign, value = struct.unpack_from(">BI", data, 1)
            counts[(message.arbitration_id >> 8) - 1] = -value if sign else value
        else:
            status = data[1]
    return out.getvalue(), status


def test_our_codec(benchmark, figures):
    loop = new_loop(load_arm("episode1"), 0, 0)
    replies, counts = np.frombuffer(REPLIES, np.uint8), np.zeros(6, np.int64)
    status = benchmark(our_cycles, loop[0], RPM, ACC, PULSES, replies, counts, CYCLES)
    assert counts.tolist() == COUNTS.tolist() and status & 3 == 3
    sent = loop[0]["buses"][0]["outgoing"]["bytes"][: int(loop[0]["buses"][0]["outgoing"]["length"])].tobytes()
    figures["ours"] = {"seconds": benchmark.stats.stats.median / CYCLES, "bytes": sent}


def test_python_can(benchmark, bus, figures, report):
    counts = np.zeros(6, np.int64)
    sent, status = benchmark(their_cycle, bus, counts)
    assert counts.tolist() == COUNTS.tolist() and status & 3 == 3
    ours, theirs = figures["ours"], benchmark.stats.stats.median
    assert sent == ours["bytes"]
    ratio = theirs / ours["seconds"]
    benchmark.extra_info["times_as_long_as_ours"] = ratio
    report(
        "codec of one cycle, 19 frames out and 7 in (aim ≥ 20 ×)",
        f"{ours['seconds'] * 1e6:.2f} µs, python-can {can.__version__} {theirs * 1e6:.0f} µs: {ratio:.0f} ×",
    )
