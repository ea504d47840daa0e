"""SLCAN lines in both directions: golden ones, hostile ones, and python-can as an independent opinion."""

import io

import by_address
import can
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus
from codec_rig import data_of, word
from hypothesis import given, settings
from hypothesis import strategies as st
from wires import SLCAN_GOLDEN

from config.loader import load_arm
from rtloop.memory.link import LINE_BYTES, RX_BYTES, SLCAN_LONGEST_LINE, TX_BYTES
from rtloop.process.initial_state import new_loop
from rtloop.wire import slcan
from shm import layout

relaxed = settings(deadline=None)  # the first call loads the compiled cycle

GOLDEN = [(line, (frame.can_id, int(frame.extended), frame.data)) for line, frame in SLCAN_GOLDEN if not frame.remote]
frames = st.one_of(
    st.tuples(st.integers(0, 0x7FF), st.just(0), st.binary(max_size=8)),
    st.tuples(st.integers(0, 0x1FFFFFFF), st.just(1), st.binary(max_size=8)),
)


@pytest.fixture(scope="module")
def arm():
    return load_arm("episode1")


@pytest.fixture
def loop(arm):
    return new_loop(arm, 0, 0)


@pytest.fixture
def shared():
    return np.zeros(1, layout.StateFile.dtype)


def encoded(loop, frame):
    """The line of a frame, by the compiled function."""
    frame_id, extended, data = frame
    loop[0]["buses"][0]["outgoing"]["length"] = 0
    assert slcan.encode_frame(loop[0]["buses"][0], frame_id, bool(extended), len(data), word(data))
    return loop[0]["buses"][0]["outgoing"]["bytes"][: int(loop[0]["buses"][0]["outgoing"]["length"])].tobytes()


def decoded(loop, line):
    """What a line (without its CR) means."""
    loop[0]["buses"][0]["parser"]["line_length"] = len(line)
    loop[0]["buses"][0]["parser"]["line"][: len(line)] = np.frombuffer(line, np.uint8)
    kind, frame_id, extended, length, data = (int(value) for value in slcan.decode_line(loop[0]["buses"][0]))
    return kind, (frame_id, extended, data_of(data, length))


def taken(loop, shared, data):
    """Feed bytes through the receive ring as the wire does; the frames counted, and the errors."""
    before = shared[0]["counters"].copy()
    for at in range(0, len(data), RX_BYTES // 2):
        part = np.frombuffer(data[at : at + RX_BYTES // 2], np.uint8)
        by_address.push(loop.ctypes.data, 1_000, part, len(part))
        by_address.take(loop.ctypes.data, shared.ctypes.data)
    now = shared[0]["counters"]
    return tuple(int(now[name] - before[name]) for name in ("frames_received", "wire_errors"))


# --- one line -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("line", "frame"), GOLDEN)
def test_golden_lines_both_ways(loop, line, frame):
    assert encoded(loop, frame) == line
    assert decoded(loop, line[:-1]) == (slcan.LINE_FRAME, frame)


@pytest.mark.parametrize("stamp", [b"0000", b"EA5F", b"00000001"])
def test_a_time_stamp_after_the_data_is_ignored(loop, stamp):
    assert decoded(loop, b"t4563112233" + stamp) == (slcan.LINE_FRAME, (0x456, 0, b"\x11\x22\x33"))


def test_small_hex_digits_are_understood(loop):
    assert decoded(loop, b"T12abcdef2aa55") == (slcan.LINE_FRAME, (0x12ABCDEF, 1, b"\xaa\x55"))


@pytest.mark.parametrize(
    "line",
    [
        b"T",
        b"t456",
        b"T1234567",
        b"T123456782AA5",  # half a byte short
        b"t4569112233",  # nine bytes do not exist
        b"t456A112233",
        b"t45G3112233",
        b"t456311 233",
        b"T2000000000",  # 30 bits of id
        b"TFFFFFFFF0",
        b"t8000",  # 12 bits of id
        b"t-561AA",
        b"T\xb2\xb2\xb2\xb2\xb2\xb2\xb2\xb20",
    ],
)
def test_garbled_frames_are_wrong_and_not_guessed(loop, line):
    assert decoded(loop, line)[0] == slcan.LINE_WRONG


@pytest.mark.parametrize("line", [b"", b"z", b"Z", b"V1013", b"NA123", b"F00", b"r4560", b"R000001000", b"\0"])
def test_answers_of_adapters_are_dropped_without_complaint(loop, line):
    assert decoded(loop, line)[0] == slcan.LINE_OTHER


@relaxed
@given(frames)
def test_every_frame_comes_back(frame):
    loop = new_loop(load_arm("episode1"), 0, 0)
    assert decoded(loop, encoded(loop, frame)[:-1]) == (slcan.LINE_FRAME, frame)


@relaxed
@given(st.binary(max_size=LINE_BYTES))
def test_any_line_is_a_frame_or_refused(line):
    loop = new_loop(load_arm("episode1"), 0, 0)
    kind, (frame_id, extended, _) = decoded(loop, line)
    assert kind in (slcan.LINE_OTHER, slcan.LINE_FRAME, slcan.LINE_WRONG)
    assert 0 <= frame_id <= (0x1FFFFFFF if extended else 0x7FF)


def test_a_full_transmit_buffer_takes_no_half_lines(loop):
    memory = loop[0]
    memory["buses"][0]["outgoing"]["length"] = TX_BYTES - SLCAN_LONGEST_LINE + 1
    before = loop[0]["buses"][0]["outgoing"]["bytes"].copy()
    assert not slcan.encode_frame(loop[0]["buses"][0], 0x100, True, 2, 0x6B36)
    assert memory["buses"][0]["outgoing"]["length"] == TX_BYTES - SLCAN_LONGEST_LINE + 1
    assert np.array_equal(loop[0]["buses"][0]["outgoing"]["bytes"], before)


# --- python-can's opinion -----------------------------------------------------------------------------


class MemoryPort(io.BytesIO):
    """A serial port whose other end is a bytes object."""

    write_timeout = None
    in_waiting = 64

    def reset_input_buffer(self):
        pass


@pytest.fixture
def other(monkeypatch):
    """python-can's slcan bus over a port in memory."""
    monkeypatch.setattr("can.interfaces.slcan.serial.serial_for_url", lambda *_, **__: MemoryPort())
    with slcanBus("memory", sleep_after_open=0, bitrate=500_000) as bus:
        yield bus
        bus.serialPortOrig.close = lambda: None


def test_python_can_writes_the_same_lines(loop, other):
    random = np.random.default_rng(5)
    for _ in range(300):
        extended = bool(random.integers(2))
        frame_id = int(random.integers(0, 1 << (29 if extended else 11)))
        data = random.bytes(int(random.integers(9)))
        other.serialPortOrig = MemoryPort()
        other.send(can.Message(arbitration_id=frame_id, is_extended_id=extended, data=data))
        assert encoded(loop, (frame_id, int(extended), data)) == other.serialPortOrig.getvalue()


def test_python_can_reads_our_lines_as_we_do(loop, other):
    random = np.random.default_rng(6)
    sent = []
    for _ in range(300):
        extended = int(random.integers(2))
        frame_id = int(random.integers(0, 1 << (29 if extended else 11)))
        sent.append((frame_id, extended, random.bytes(int(random.integers(9)))))
    lines = [encoded(loop, frame) for frame in sent]
    other.serialPortOrig = MemoryPort(b"".join(lines))
    for line, frame in zip(lines, sent, strict=True):
        message = other.recv(0.0)
        theirs = (message.arbitration_id, int(message.is_extended_id), bytes(message.data))
        assert theirs == frame == decoded(loop, line[:-1])[1]


# --- a stream of bytes --------------------------------------------------------------------------------

POSITION = b"T00000100736000001000" + b"06B\r"


@relaxed
@given(st.binary(max_size=2000))
def test_no_bytes_whatever_hinder_the_next_frame(noise):
    loop, shared = new_loop(load_arm("episode1"), 0, 0), np.zeros(1, layout.StateFile.dtype)
    taken(loop, shared, noise + b"\r")
    assert taken(loop, shared, POSITION) == (1, 0)
    assert 0 <= loop[0]["buses"][0]["parser"]["line_length"] <= LINE_BYTES


def test_too_many_small_chunks_are_dropped_and_counted(loop, shared):
    one = np.frombuffer(b"\r", np.uint8)
    for _ in range(3000):
        by_address.push(loop.ctypes.data, 1, one, 1)
    by_address.take(loop.ctypes.data, shared.ctypes.data)
    counters = shared[0]["counters"]
    assert counters["receive_overflows"] > 0
    assert counters["bytes_received"] + counters["receive_overflows"] == 3000
    assert taken(loop, shared, POSITION) == (1, 0)
