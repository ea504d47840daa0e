"""The simulated SLCAN adapter: golden lines, answers in both dialects, time on the serial line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.adapter import SlcanAdapter
from sim.bus import Frame, joined
from sim.drives.ramp import NEVER


def opened(**options):
    adapter = SlcanAdapter(500_000, **options)
    adapter.feed(0, b"S6\rO\r")
    adapter.wake(10**9)
    adapter.arrivals(10**9)
    return adapter


def ask(adapter, line):
    adapter.feed(0, line)
    return joined(adapter.arrivals(0))


GOLDEN = [
    (b"T12ABCDEF2AA55\r", Frame(0x12ABCDEF, b"\xaa\x55")),
    (b"t4563112233\r", Frame(0x456, b"\x11\x22\x33", extended=False)),
    (b"T000001002366B\r", Frame(0x100, b"\x36\x6b")),
    (b"R000001002\r", Frame(0x100, bytes(2), remote=True)),
    (b"r7FF0\r", Frame(0x7FF, b"", extended=False, remote=True)),
]


@pytest.mark.parametrize(("line", "frame"), GOLDEN)
def test_golden_lines_both_ways(line, frame):
    adapter = opened()
    assert ask(adapter, line) == (b"Z\r" if frame.extended else b"z\r")
    assert [sent for _, sent in adapter.outbox] == [frame]
    adapter.receive(5, frame)
    assert joined(adapter.arrivals(5)) == line


def test_opening_is_answered_step_by_step():
    adapter = SlcanAdapter(500_000)
    assert ask(adapter, b"O\r") == b"\x07"  # no rate yet
    assert ask(adapter, b"C\r") == b"\x07"  # not open
    assert ask(adapter, b"S6\r") == b"\r"
    assert ask(adapter, b"O\r") == b"\r"
    assert ask(adapter, b"O\r") == b"\x07"
    assert ask(adapter, b"S6\r") == b"\x07"  # only while closed
    assert ask(adapter, b"V\rN\r") == b"V1013\rNA123\r"
    assert ask(adapter, b"F\r") == b"F00\r"
    assert ask(adapter, b"C\r") == b"\r"
    assert ask(adapter, b"F\r") == b"\x07"


def test_the_silent_dialect_says_nothing_but_works():
    adapter = SlcanAdapter(500_000, dialect="canable")
    assert ask(adapter, b"C\rS6\rO\rV\rF\rnonsense\rT000001002366B\rt9990\r") == b""
    assert [frame.can_id for _, frame in adapter.outbox] == [0x100]


@pytest.mark.parametrize(
    "line",
    [
        b"S7\r", b"S9\r", b"s031C\r", b"X1\r", b"Q\r", b"T\r", b"T0000010\r", b"T00000100\r", b"T000001009\r",
        b"T000001002366\r", b"T000001002366B00\r", b"T00000100236 6B\r", b"T2000000000\r", b"t8000\r",
        b"T0x0001002366B\r", b"T+00001002366B\r", b"t10\r", b"T00000100A366B\r", b"R0000010021122\r", b"O1\r",
        b"\xff\xfe\r", b"A" * 200 + b"\r",
    ],
)  # fmt: skip
def test_bad_lines_are_errors_and_send_nothing(line):
    adapter = opened()
    assert ask(adapter, line) == b"\x07"
    assert not adapter.outbox
    assert ask(adapter, b"T000001002366B\r") == b"Z\r"


def test_transmission_needs_an_open_channel_that_may_speak():
    adapter = SlcanAdapter(500_000)
    assert ask(adapter, b"S6\rT000001002366B\r") == b"\r\x07"
    assert ask(adapter, b"L\rT000001002366B\r") == b"\r\x07"


def test_a_full_buffer_loses_frames_and_says_so():
    adapter = opened(depth=2)
    assert ask(adapter, b"t1000\r" * 3) == b"z\rz\r\x07"
    assert adapter.lost_frames == 1
    assert ask(adapter, b"F\rF\r") == b"F02\rF00\r"


def test_at_another_rate_nothing_gets_through():
    adapter = SlcanAdapter(500_000, depth=2)
    assert ask(adapter, b"S8\rO\rt1000\rt1000\rt1000\r") == b"\r\rz\rz\r\x07"
    assert not adapter.outbox
    assert not adapter.listening
    assert ask(adapter, b"F\r") == b"FA2\r"


def test_echo_is_an_option():
    for echo, answer in ((False, b""), (True, b"t1000\r")):
        adapter = opened(echo=echo)
        adapter.sent(0, Frame(0x100, b"", extended=False))
        assert joined(adapter.arrivals(0)) == answer


def test_stamps_count_milliseconds_and_wrap():
    adapter = SlcanAdapter(500_000)
    ask(adapter, b"S6\rZ1\rO\r")
    adapter.receive(59_999_000_000, Frame(0x100, b"\x36"))
    adapter.receive(60_000_000_000, Frame(0x100, b"\x36"))
    assert joined(adapter.arrivals(60_000_000_000)) == b"T00000100136EA5F\rT000001001360000\r"


def test_characters_take_their_time_in_both_directions():
    byte_ns = 10_000  # 1 Mbaud
    adapter = SlcanAdapter(500_000, baud=1_000_000)
    adapter.feed(0, b"S6\rO\r")
    assert adapter.wake_ns == 3 * byte_ns
    adapter.wake(3 * byte_ns)
    assert not adapter.is_open
    assert adapter.wake_ns == 5 * byte_ns
    adapter.wake(5 * byte_ns)
    assert adapter.is_open
    assert adapter.wake_ns == NEVER
    assert joined(adapter.arrivals(4 * byte_ns)) == b"\r"
    assert joined(adapter.arrivals(6 * byte_ns)) == b"\r"
    adapter.receive(10**6, Frame(0x100, b"\x36\x6b"))
    line = b"T000001002366B\r"
    assert adapter.next_due_ns() == 10**6 + len(line) * byte_ns
    assert joined(adapter.arrivals(10**6 + 5 * byte_ns - 1)) == line[:4]
    assert joined(adapter.arrivals(10**6 + 5 * byte_ns)) == line[4:5]
    assert joined(adapter.arrivals(10**7)) == line[5:]


def test_a_second_write_waits_for_the_first():
    adapter = SlcanAdapter(500_000, baud=1_000_000)
    adapter.feed(0, b"V\r")
    adapter.feed(5_000, b"V\r")
    adapter.wake(20_000)
    assert adapter.wake_ns == 40_000


@given(st.lists(st.binary(max_size=40), max_size=12), st.booleans())
def test_noise_never_sends_a_frame_that_was_not_spelt(chunks, split):
    adapter = opened()
    noise = b"".join(chunks).replace(b"T", b"?").replace(b"t", b"?").replace(b"R", b"?").replace(b"r", b"?")
    for chunk in [noise[:7], noise[7:]] if split else [noise]:
        adapter.feed(0, chunk)
    assert not adapter.outbox


def test_refused_opening_and_corruption_are_faults():
    adapter = SlcanAdapter(500_000)
    adapter.refuses_open = True
    assert ask(adapter, b"S6\rO\r") == b"\r\x07"
    adapter = opened()
    adapter.corruption = 1.0
    adapter.receive(0, Frame(0x100, b""))
    garbled = joined(adapter.arrivals(0))
    assert len(garbled) == 11
    assert all(a != b for a, b in zip(garbled, b"T000001000\r", strict=True))
