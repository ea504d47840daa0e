"""CAN frames to and from the cycle as SocketCAN has them, and what its error frames mean."""

import numpy as np
import pytest
from can_records import EXTENDED, REMOTE, error_record, record, unpacked
from codec_rig import data_of, word
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from config.loader import load_arm
from rtloop.bus.measured import take_what_the_bus_brought
from rtloop.memory.link import CAN_FRAME_BYTES, RX_BYTES, TX_BYTES, WIRE_PYTHON_CAN, WIRE_SOCKETCAN
from rtloop.process.initial_state import new_loop
from rtloop.wire import can_frame, can_words, received
from shm import layout
from shm.words import BusState, Fault, Mode

ARM = load_arm("episode1", overrides={"bus": {"interface": "socketcan"}})

identifiers = st.one_of(
    st.tuples(st.integers(0, 0x1FFFFFFF), st.just(True)),
    st.tuples(st.integers(0, 0x7FF), st.just(False)),
)
relaxed = settings(deadline=None, max_examples=examples(200))


@pytest.fixture
def shared():
    return np.zeros(1, layout.StateFile.dtype)


@pytest.fixture
def loop(shared):
    return new_loop(ARM, shared.ctypes.data, 0)


def decoded(loop, data, at=0):
    """What the record at a byte of the ring means: kind, identifier, extended, data."""
    loop[0]["buses"][0]["received"]["bytes"][at : at + len(data)] = np.frombuffer(data, np.uint8)
    kind, frame_id, extended, length, value = (int(part) for part in can_frame.decode_record(loop[0]["buses"][0], at))
    return kind, frame_id, extended, data_of(value, length)


def brought(loop, shared, *records):
    """Let the cycle take what came, one batch."""
    data = np.frombuffer(b"".join(records), np.uint8)
    received.push(loop[0]["buses"][0], 1_000, data, len(data))
    take_what_the_bus_brought(loop[0], shared[0])


# --- one frame ----------------------------------------------------------------------------------------------


@relaxed
@given(identifiers, st.binary(max_size=8))
def test_what_is_encoded_is_what_a_raw_socket_takes(identifier, data):
    loop = new_loop(ARM, 0, 0)
    loop[0]["buses"][0]["outgoing"]["bytes"] = 0xAA
    frame_id, extended = identifier
    assert can_frame.encode_frame(loop[0]["buses"][0], frame_id, extended, len(data), word(data))
    sent = loop[0]["buses"][0]["outgoing"]["bytes"][: int(loop[0]["buses"][0]["outgoing"]["length"])].tobytes()
    assert sent == record(frame_id, data, flags=EXTENDED if extended else 0)


@relaxed
@given(identifiers, st.binary(max_size=8), st.integers(0, RX_BYTES // CAN_FRAME_BYTES - 1))
def test_what_a_raw_socket_gives_is_decoded(identifier, data, number):
    frame_id, extended = identifier
    content = record(frame_id, data, flags=EXTENDED if extended else 0)
    found = decoded(new_loop(ARM, 0, 0), content, number * CAN_FRAME_BYTES)
    assert found == (can_frame.RECORD_FRAME, frame_id, int(extended), data)


@relaxed
@given(st.binary(min_size=CAN_FRAME_BYTES, max_size=CAN_FRAME_BYTES))
def test_any_record_is_a_frame_or_refused(data):
    kind, frame_id, extended, content = decoded(new_loop(ARM, 0, 0), data)
    (told, told_content), length = unpacked(data)[0], data[4]
    if length > 8:
        assert kind == can_frame.RECORD_WRONG
    elif told & 0x20000000:
        assert (kind, frame_id, content) == (can_frame.RECORD_ERROR, told & 0x1FFFFFFF, told_content)
    elif told & REMOTE:
        assert kind == can_frame.RECORD_OTHER
    elif told & EXTENDED or told <= 0x7FF:
        assert (kind, frame_id, content) == (can_frame.RECORD_FRAME, told & 0x1FFFFFFF, told_content)
        assert extended == told >> 31
    else:
        assert kind == can_frame.RECORD_WRONG


def test_a_full_transmit_buffer_takes_no_half_frames(loop):
    memory = loop[0]
    memory["buses"][0]["outgoing"]["length"] = TX_BYTES - CAN_FRAME_BYTES + 1
    assert not can_frame.encode_frame(loop[0]["buses"][0], 0x100, True, 2, 0x6B36)
    assert memory["buses"][0]["outgoing"]["length"] == TX_BYTES - CAN_FRAME_BYTES + 1


@pytest.mark.parametrize("now_ms", [0, 0x1234, 0xFEDC, 0x12345])
def test_our_own_marks_stand_in_the_unused_bytes_of_the_last_frame(loop, now_ms):
    """And when it was made: milliseconds, 16 bits."""
    for _ in range(2):
        assert can_frame.encode_frame(loop[0]["buses"][0], 0x100, True, 8, -1)
    can_frame.mark(loop[0]["buses"][0], can_words.STOP, now_ms)
    first, last = (
        loop[0]["buses"][0]["outgoing"]["bytes"][at : at + CAN_FRAME_BYTES].tobytes() for at in (0, CAN_FRAME_BYTES)
    )
    assert first == record(0x100, b"\xff" * 8)
    assert last == first[:5] + bytes((can_words.STOP, now_ms & 255, now_ms >> 8 & 255)) + first[8:]


def test_the_wires_that_carry_such_records():
    assert [wire for wire in range(8) if can_frame.is_carried_by(wire)] == sorted((WIRE_SOCKETCAN, WIRE_PYTHON_CAN))


# --- what the bus brought -----------------------------------------------------------------------------------


def test_replies_become_readings_and_everything_else_does_not(loop, shared):
    reading = bytes((0x36, 0, 0, 0, 0x40, 0, 0x6B))
    brought(
        loop,
        shared,
        record(0x100, reading),
        record(0x200, reading, flags=EXTENDED | REMOTE),
        record(0x300, reading, flags=0),  # a standard identifier
        record(0x400, b"\x36\x6b"),  # the question itself: an echo
        record(0x5500, reading),  # of somebody else's drive
        record(0x600, reading[:6] + b"\x6c"),
        RECORD_TOO_LONG,
    )
    assert list(loop[0]["axes"]["measured"]["readings"][:6]) == [1, 0, 0, 0, 0, 0]
    assert loop[0]["axes"]["drive"]["status_readings"].sum() == 0
    assert (shared[0]["counters"]["frames_received"], shared[0]["counters"]["wire_errors"]) == (5, 1)


RECORD_TOO_LONG = record(0x100, b"\x36\x6b")[:4] + b"\x09" + bytes(11)


def test_a_full_ring_loses_whole_frames(loop, shared):
    reading = bytes((0x36, 0, 0, 0, 0x40, 0, 0x6B))
    chunk = np.frombuffer(record(0x100, reading) * 100, np.uint8)
    for _ in range(RX_BYTES // len(chunk) + 2):
        received.push(loop[0]["buses"][0], 1_000, chunk, len(chunk))
    take_what_the_bus_brought(loop[0], shared[0])
    counters = shared[0]["counters"]
    assert counters["receive_overflows"] > 0
    assert counters["receive_overflows"] % CAN_FRAME_BYTES == 0
    assert (counters["frames_received"], counters["wire_errors"]) == (RX_BYTES // CAN_FRAME_BYTES, 0)
    brought(loop, shared, record(0x200, reading))
    assert loop[0]["axes"]["measured"]["readings"][1] == 1


# --- error frames -------------------------------------------------------------------------------------------

CONTROLLER = can_words.CONTROLLER


@pytest.mark.parametrize(
    ("errors", "state", "unacknowledged"),
    [
        ([(CONTROLLER, b"\0\x04")], BusState.WARNING, 0),
        ([(CONTROLLER, b"\0\x08")], BusState.WARNING, 0),
        ([(CONTROLLER, b"\0\x08"), (CONTROLLER, b"\0\x20")], BusState.PASSIVE, 0),
        ([(CONTROLLER, b"\0\x10"), (CONTROLLER, b"\0\x40")], BusState.ACTIVE, 0),
        ([(CONTROLLER, b"\0\x30"), (CONTROLLER, b"\0\x01")], BusState.PASSIVE, 0),  # an overflow changes nothing
        ([(can_words.NO_ACKNOWLEDGE, b"")], BusState.ACTIVE, 1),
        ([(can_words.PROTOCOL | can_words.BUS_ERROR, b"\0\0\0\x19")], BusState.ACTIVE, 1),
        ([(can_words.PROTOCOL | can_words.BUS_ERROR, b"\0\0\x04\x08")], BusState.ACTIVE, 0),
        ([(CONTROLLER | can_words.NO_ACKNOWLEDGE, b"\0\x20")], BusState.PASSIVE, 1),
        ([(can_words.TRANSMIT_TIMEOUT, b""), (can_words.TRANSCEIVER, b"")], BusState.ACTIVE, 0),
        ([(can_words.BUS_OFF, b""), (can_words.RESTARTED, b"")], BusState.ACTIVE, 0),
    ],
)
def test_error_frames_are_counted_and_say_how_the_bus_is(loop, shared, errors, state, unacknowledged):
    brought(loop, shared, *[error_record(kind, detail) for kind, detail in errors])
    counters = shared[0]["counters"]
    assert counters["error_frames"] == len(errors)
    assert (counters["bus_state"], counters["unacknowledged"]) == (state, unacknowledged)
    assert (counters["frames_received"], counters["wire_errors"]) == (0, 0)
    if not any(kind == can_words.BUS_OFF for kind, _ in errors):
        assert loop[0]["fault"]["code"] == Fault.NONE


def test_bus_off_is_a_latched_fault(loop, shared):
    loop[0]["mode"] = Mode.HOLDING
    brought(loop, shared, error_record(can_words.BUS_OFF))
    memory = loop[0]
    assert (memory["fault"]["code"], memory["fault"]["value"], memory["mode"]) == (
        Fault.BUS_OFF,
        float(can_words.BUS_OFF),
        Mode.FAULT,
    )
    assert shared[0]["counters"]["bus_state"] == BusState.BUS_OFF
