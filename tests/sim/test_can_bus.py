"""Bit times, arbitration and acknowledgement of the simulated bus."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.bus import Bus, Frame, Outbox, frame_bits
from sim.drives.ramp import NEVER

BIT_NS = 2_000


def counted_by_hand(frame: Frame) -> int:
    """Bits on the bus, from the layout in ISO 11898-1 and a bit at a time."""
    length = f"{len(frame.data):04b}"
    if frame.extended:
        ident = f"{frame.can_id:029b}"
        bits = "0" + ident[:11] + "11" + ident[11:] + f"{frame.remote:b}" + "00" + length
    else:
        bits = "0" + f"{frame.can_id:011b}" + f"{frame.remote:b}" + "00" + length
    if not frame.remote:
        bits += "".join(f"{byte:08b}" for byte in frame.data)
    crc = 0
    for bit in bits:
        crc = (crc << 1) ^ (0x4599 if (crc >> 14) ^ int(bit) else 0)
        crc &= 0x7FFF
    sent = ""
    for bit in bits + f"{crc:015b}":
        sent += bit
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent += "1" if bit == "0" else "0"
    return len(sent) + 1 + 2 + 7 + 3


frames = st.builds(
    lambda extended, can_id, data, remote: Frame(can_id if extended else can_id % 0x800, data, extended, remote),
    st.booleans(),
    st.one_of(st.integers(0, 0x1FFFFFFF), st.integers(0, 0x7FF).map(lambda number: number << 8)),
    st.one_of(st.binary(max_size=8), st.integers(0, 8).map(bytes), st.integers(0, 8).map(lambda n: b"\xff" * n)),
    st.booleans(),
)


@given(frames)
def test_bits_as_counted_by_hand_and_within_the_table_of_the_facts(frame):
    bits = frame_bits(frame)
    assert bits == counted_by_hand(frame)
    payload = 0 if frame.remote else 8 * len(frame.data)
    bare, stuffable = (67, 53) if frame.extended else (47, 33)
    assert bare + payload <= bits <= bare + payload + (stuffable + payload) // 4


class Station:
    """A node that sends what it is given and notes what it hears."""

    def __init__(self) -> None:
        self.outbox: Outbox = deque()
        self.listening = True
        self.address: int | None = None
        self.wake_ns = NEVER
        self.heard: list[tuple[int, Frame]] = []
        self.left: list[int] = []

    def receive(self, now_ns: int, frame: Frame) -> None:
        self.heard.append((now_ns, frame))

    def sent(self, now_ns: int, frame: Frame) -> None:
        self.left.append(now_ns)

    def wake(self, now_ns: int) -> None:
        raise AssertionError("nobody asked to be woken")


@pytest.fixture
def stations():
    return [Station(), Station(), Station()]


@pytest.fixture
def bus(stations):
    bus = Bus(500_000, 0)
    bus.nodes += stations
    return bus


def test_frames_follow_each_other_and_arrive_before_the_interframe_space(bus, stations):
    frame = Frame(0x100, bytes.fromhex("36 6B"))
    stations[0].outbox += [(1000, frame), (1000, frame)]
    bus.run_until(10**9)
    length_ns = frame_bits(frame) * BIT_NS
    first_ns, second_ns = (time_ns for time_ns, _ in stations[1].heard)
    assert first_ns == 1000 + length_ns - 3 * BIT_NS
    assert second_ns - first_ns == length_ns
    assert bus.frames == 2
    assert bus.busy_ns == 2 * length_ns
    assert stations[0].heard == []


def test_the_lowest_identifier_goes_first_but_does_not_interrupt(bus, stations):
    stations[0].outbox.append((0, Frame(0x300, b"")))
    stations[1].outbox.append((10, Frame(0x200, b"")))
    stations[2].outbox.append((10, Frame(0x100, b"")))
    bus.run_until(10**9)
    order = sorted(heard for station in stations for heard in station.heard)
    assert [frame.can_id for _, frame in dict.fromkeys(order)] == [0x300, 0x100, 0x200]


def test_a_standard_frame_beats_an_extended_one_of_the_same_base(bus, stations):
    stations[0].outbox.append((0, Frame(0x123 << 18, b"")))
    stations[1].outbox.append((0, Frame(0x123, b"", extended=False)))
    bus.run_until(10**9)
    assert [frame.extended for _, frame in stations[2].heard] == [False, True]


def bits_of_arbitration(frame: Frame) -> str:
    """Identifier and flags up to where data and remote frames, base and extended ones differ (ISO 11898-1)."""
    ident = f"{frame.can_id:029b}"
    if frame.extended:
        return ident[:11] + "11" + ident[11:] + f"{frame.remote:b}"
    return f"{frame.can_id:011b}" + f"{frame.remote:b}" + "0"


close = st.builds(
    lambda base, low, extended, remote: Frame(base << 18 | low if extended else base, b"", extended, remote),
    st.integers(0, 3),
    st.integers(0, 1),
    st.booleans(),
    st.booleans(),
)


@given(st.lists(st.one_of(close, frames), min_size=1, max_size=12, unique_by=bits_of_arbitration))
def test_frames_that_wait_together_go_in_the_order_in_which_dominant_bits_win(waiting):
    bus, ear = Bus(500_000, 0), Station()
    senders = [Station() for _ in waiting]
    for sender, frame in zip(senders, waiting, strict=True):
        sender.outbox.append((0, frame))
    bus.nodes += [ear, *senders]
    bus.run_until(10**9)
    assert [frame for _, frame in ear.heard] == sorted(waiting, key=bits_of_arbitration)
    for sender, frame in zip(senders, waiting, strict=True):
        assert frame not in [heard for _, heard in sender.heard]


@pytest.mark.parametrize(
    ("frame", "hear"),
    [
        (Frame(0x2FF, b""), {2, None}),
        (Frame(0x0FF, b""), {1, 2, None}),
        (Frame(0x10000200, b""), {None}),
        (Frame(0x200, b"", extended=False), {None}),
        (Frame(0x0FF, b"", extended=False), {None}),
        (Frame(0x200, b"", remote=True), {2, None}),
        (Frame(0x2FF, b"", extended=False, remote=True), {None}),
    ],
)
def test_who_hears_what(frame, hear):
    bus, sender = Bus(500_000, 0), Station()
    ears = {address: Station() for address in (1, 2, None)}
    for address, ear in ears.items():
        ear.address = address
    bus.nodes += [sender, *ears.values()]
    sender.outbox.append((0, frame))
    bus.run_until(10**9)
    assert {address for address, ear in ears.items() if ear.heard} == hear
    assert sender.heard == []


class Answerer(Station):
    """Answers each frame that is not an answer, a time after it has heard it."""

    def __init__(self, after_ns: int, answer: Frame) -> None:
        super().__init__()
        self.after_ns, self.answer = after_ns, answer

    def receive(self, now_ns: int, frame: Frame) -> None:
        if frame.can_id != self.answer.can_id:
            self.outbox.append((now_ns + self.after_ns, self.answer))


@given(
    st.lists(st.tuples(st.integers(0, 10**6), frames), max_size=4),
    st.lists(st.tuples(st.integers(0, 10**6), frames), max_size=4),
    frames,
    st.integers(0, 300_000),
)
def test_nothing_comes_before_the_quiet_is_said_to_end(own, others, answer, after_ns):
    bus, listener, other = Bus(500_000, 0), Station(), Station()
    bus.nodes += [listener, other, Answerer(after_ns, answer)]
    listener.outbox.extend(sorted(own, key=lambda item: item[0]))
    other.outbox.extend(sorted(others, key=lambda item: item[0]))
    now_ns = 0
    while (until_ns := bus.quiet_until_ns(listener, after_ns)) != NEVER:
        assert until_ns > now_ns
        before = len(listener.heard)
        bus.run_until(until_ns - 1)
        assert len(listener.heard) == before
        now_ns = until_ns
        bus.run_until(now_ns)
    assert not listener.outbox and not other.outbox


def test_a_frame_in_flight_is_not_heard_before_its_end(bus, stations):
    frame = Frame(0x100, b"\x01")
    stations[0].outbox.append((0, frame))
    end_ns = (frame_bits(frame) - 3) * BIT_NS
    bus.run_until(end_ns - 1)
    assert stations[1].heard == []
    bus.run_until(end_ns)
    assert stations[1].heard == [(end_ns, frame)]


def test_nobody_there_to_acknowledge_keeps_the_frame(bus, stations):
    stations[0].outbox.append((0, Frame(0x100, b"")))
    stations[1].listening = stations[2].listening = False
    bus.run_until(10**6)
    assert stations[0].left == []
    stations[1].listening = True
    bus.run_until(10**9)
    assert len(stations[0].left) == 1
