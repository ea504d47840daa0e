"""MKS frames beyond `tests/golden/mks.yaml`: targets read back or bounded, and what a right sum makes."""

from codec_rig import Rig, data_of, word
from hypothesis import given, settings
from hypothesis import strategies as st

from config.drives.mks import FARTHEST_COUNTS
from rtloop.drives import mks, mks_protocol, words

relaxed = settings(deadline=None)
can_ids = st.integers(1, 2047)


def summed(data: bytes, can_id: int) -> bytes:
    return data + bytes(((can_id + sum(data)) & 0xFF,))


@relaxed
@given(can_ids, st.integers(0, 3000), st.integers(0, 255), st.integers(-(2**40), 2**40))
def test_targets_are_read_back_or_bounded(can_id, rpm, acc, counts):
    data = data_of(mks.pack_target(can_id, rpm, acc, counts))
    assert data[0] == 0xF5 and data == summed(data[:7], can_id)
    assert (int.from_bytes(data[1:3], "big"), data[3]) == (rpm, acc)
    assert int.from_bytes(data[4:7], "big", signed=True) == min(max(counts, -FARTHEST_COUNTS), FARTHEST_COUNTS)


@relaxed
@given(can_ids, st.integers(-(2**47), 2**47 - 1), st.integers(0, 63))
def test_positions_are_read_back_and_no_garbled_bit_is_believed(can_id, counts, bit):
    data = summed(b"\x31" + counts.to_bytes(6, "big", signed=True), can_id)
    assert words.whole(word(data), mks_protocol.COUNTS) == counts and mks.is_sound(can_id, word(data), 8)
    assert not mks.is_sound(can_id, word(data) ^ word((1 << bit).to_bytes(8, "little")), 8)


@relaxed
@given(st.binary(max_size=7), st.sampled_from([b"", b"\x31", b"\x3a", b"\x3e", b"\xf5"]))
def test_a_right_sum_alone_makes_no_answer(data, code):
    data = summed((code + data)[:7], 1)
    rig = Rig.named("mks")
    rig.takes(1, data)
    told = rig.told()
    assert ("position_rad" in told) == (len(data) == 8 and data[0] == 0x31)
    assert ("status" in told) == (len(data) == 3 and data[0] == 0x3A and data[1] <= 1)
    assert ("refusals" in told) == (len(data) == 3 and data[0] == 0xF5 and data[1] in (0, 3))
