"""The simulated CAN interface: raw socket records to frames and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.bus import Frame, joined
from sim.can_interface import CanInterface

# struct can_frame of linux/can.h on a little-endian machine: identifier with flags, length, padding, data.
GOLDEN = [
    ("23010000 02000000 AA55000000000000", Frame(0x123, b"\xaa\x55", extended=False)),
    ("23010080 01000000 7F00000000000000", Frame(0x123, b"\x7f")),
    ("29000040 08000000 0000000000000000", Frame(0x029, bytes(8), extended=False, remote=True)),
    ("EFCDABD2 00000000 0000000000000000", Frame(0x12ABCDEF, b"", remote=True)),
]


@pytest.mark.parametrize(("record", "frame"), GOLDEN)
def test_golden_records_both_ways(record, frame):
    interface = CanInterface()
    interface.feed(7, bytes.fromhex(record))
    assert list(interface.outbox) == [(7, frame)]
    interface.receive(9, frame)
    assert interface.next_due_ns() == 9
    assert joined(interface.arrivals(8)) == b""
    assert joined(interface.arrivals(9)) == bytes.fromhex(record)


frames = st.builds(
    lambda extended, can_id, data, remote: Frame(
        can_id if extended else can_id % 0x800, bytes(len(data)) if remote else data, extended, remote
    ),
    st.booleans(),
    st.integers(0, 0x1FFFFFFF),
    st.binary(max_size=8),
    st.booleans(),
)


@given(st.lists(frames, max_size=5))
def test_what_one_interface_writes_another_reads(sent):
    there, here = CanInterface(), CanInterface()
    for frame in sent:
        there.receive(0, frame)
    here.feed(0, joined(there.arrivals(0)))
    assert [frame for _, frame in here.outbox] == sent


def test_of_a_remote_frame_the_data_means_nothing():
    interface = CanInterface()
    interface.feed(0, bytes.fromhex("29000040 02000000 DEADBEEF00000000"))
    assert [frame for _, frame in interface.outbox] == [Frame(0x029, bytes(2), extended=False, remote=True)]


def test_what_is_no_frame_is_refused():
    with pytest.raises(ValueError, match="no whole number of CAN frames"):
        CanInterface().feed(0, bytes(15))
    with pytest.raises(ValueError, match="at most 8 data bytes"):
        CanInterface().feed(0, bytes(4) + b"\x09" + bytes(11))
