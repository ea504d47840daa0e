"""ZDT frames beyond `tests/golden/zdt.yaml`: targets read back or bounded, and packets that are no replies."""

from codec_drives import RPM, TURN, zdt_reads
from codec_rig import data_of, word
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.drives import zdt

relaxed = settings(deadline=None)
commands = (st.integers(0, 3000), st.integers(0, 255), st.integers(-(2**32) + 1, 2**32 - 1))


@relaxed
@given(st.integers(-(2**40), 2**40))
def test_fast_targets_are_read_back_or_bounded(pulses):
    data = data_of(zdt.pack_fast_target(pulses), 8)
    assert data[0] == 0xFC and data[5:] == b"\x6b\x00\x00"
    assert int.from_bytes(data[1:5], "big", signed=True) == min(max(pulses, -(2**31)), 2**31 - 1)


@relaxed
@given(*commands)
def test_commands_are_read_back_as_they_were_meant(rpm, acc, pulses):
    first, second = zdt.pack_target(rpm, acc, pulses)
    read = zdt_reads([data_of(first, 8), data_of(second, 5)])
    assert (round(read.rad_s / RPM), data_of(first)[4], round(read.rad / TURN * 3200)) == (rpm, acc, pulses)
    assert second >> 40 == 0


@relaxed
@given(*commands)
def test_echoes_of_position_commands_are_never_replies(rpm, acc, pulses):
    first, second = zdt.pack_target(rpm, acc, pulses)
    assert zdt.decode(0, 8, first)[0] == zdt.OTHER
    for packet in (0, 1):
        assert zdt.decode(packet, 5, second)[0] == zdt.OTHER


@relaxed
@given(st.integers(0, 255), st.binary(max_size=8))
def test_any_frame_is_understood_or_left(packet, data):
    kind, value = zdt.decode(packet, len(data), word(data))
    assert kind in (zdt.OTHER, zdt.POSITION, zdt.STATUS, zdt.REFUSED, zdt.ACCEPTED)
    assert abs(value) < 2**32
