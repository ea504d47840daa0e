"""Numbers in a frame's eight bytes, as drives' codecs read and write them: against struct and int.from_bytes."""

import math
import struct
from typing import Literal

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rtloop.drives import fields, numbers, words
from rtloop.drives.numbers import Bits, Number, Single

relaxed = settings(deadline=None)
finite_singles = st.floats(allow_nan=False, allow_infinity=False, width=32)


def signed(word: int) -> int:
    """Eight data bytes as the cycle holds them, also where the word was made without the compiler."""
    return int.from_bytes((int(word) & (1 << 64) - 1).to_bytes(8, "little"), "little", signed=True)


@st.composite
def places(draw: st.DrawFn) -> Number:
    """A number anywhere in eight bytes."""
    at = draw(st.integers(0, 7))
    size = draw(st.integers(1, min(8 - at, 6)))
    return Number(at, size, draw(st.booleans()), draw(st.booleans()), draw(st.sampled_from([1.0, 0.1, 100.0])))


@relaxed
@given(places(), st.binary(min_size=8, max_size=8))
@example(Number(1, 6, signed=True, big_endian=True), b"\xff" * 8)
def test_a_number_of_a_table_is_read_as_int_from_bytes_does(number: Number, data: bytes) -> None:
    order: Literal["big", "little"] = "big" if number.big_endian else "little"
    expected = int.from_bytes(data[number.at : number.at + number.size], order, signed=number.signed)
    word = int.from_bytes(data, "little", signed=True)
    assert words.whole(word, number) == numbers.unpacked(data, number) == expected
    assert words.quantity(word, number) == expected * number.step


@relaxed
@given(places(), st.integers(-(2**62), 2**62))
def test_a_number_that_is_placed_is_read_again_and_stands_alone(number: Number, value: int) -> None:
    """Of one that is too large the cycle sends the lowest bytes; a dialogue does not send it."""
    bits = 8 * number.size
    kept = value % (1 << bits)
    kept -= (1 << bits) if number.signed and kept >> (bits - 1) else 0
    word = signed(words.placed(number, value))
    assert words.whole(word, number) == kept
    data = word.to_bytes(8, "little", signed=True)
    assert not any(data[: number.at] + data[number.at + number.size :])
    if kept == value:
        assert numbers.packed({number: value}) == data
    else:
        with pytest.raises(OverflowError):
            numbers.packed({number: value})


@relaxed
@given(st.integers(0, 63), st.integers(1, 16), st.binary(min_size=8, max_size=8), st.integers(0, 0xFFFF))
@example(0, 16, b"\x80" + bytes(7), 0x8000)
@example(52, 12, b"\xff" * 8, 0xFFF)
@example(63, 1, b"\xff" * 8, 1)
def test_bits_of_a_table_stand_where_the_frame_as_one_number_has_them(
    at: int, size: int, data: bytes, value: int
) -> None:
    where = Bits(at, min(size, 64 - at))
    kept = value % (1 << where.size)
    expected = int.from_bytes(data, "big") >> 64 - at - where.size & (1 << where.size) - 1
    word = int.from_bytes(data, "little", signed=True)
    assert words.bits(word, where) == numbers.unpacked(data, where) == expected
    made = words.placed_bits(where, kept).to_bytes(8, "little", signed=True)
    assert made == numbers.packed({where: kept}) == (kept << 64 - at - where.size).to_bytes(8, "big")
    with pytest.raises(OverflowError):
        numbers.packed({where: 1 << where.size})


@relaxed
@given(st.integers(0, 4), finite_singles)
def test_a_single_of_a_table_is_read_and_placed_as_struct_does(at: int, value: float) -> None:
    single, data = Single(at), struct.pack("<f", value).rjust(at + 4, b"\0").ljust(8, b"\0")
    word = int.from_bytes(data, "little", signed=True)
    assert words.single(word, single) == numbers.unpacked(data, single) == value
    assert signed(words.placed_single(single, value)) == word
    assert numbers.packed({single: value}) == data


@relaxed
@given(st.floats(-1e12, 1e12), st.sampled_from([100, 32_767, 2**31 - 1]))
def test_numbers_are_rounded_and_kept_within_bounds(value: float, most: int) -> None:
    assert words.bounded(value, most) == min(max(round(value), -most), most)
    assert (words.bounded(math.inf, most), words.bounded(-math.inf, most)) == (most, -most)


@relaxed
@given(st.sampled_from([12, 16]), st.floats(1e-3, 1e4), st.floats(0.0, 1.0))
def test_fields_go_back_in_as_they_came_out(bits: int, most: float, share: float) -> None:
    code = round(share * ((1 << bits) - 1))
    value = fields.of_field(code, most, bits)
    assert -most <= value <= most * (1.0 + 1e-12)
    assert fields.field(value, most, bits) == code == words.field(value, most, bits)
    assert words.of_field(code, most, bits) == value


@pytest.mark.parametrize(("value", "code"), [(-1e9, 0), (-math.inf, 0), (0.0, 0x7FF), (1e9, 0xFFF)])
def test_a_field_cuts_off_at_its_ends_and_to_whole_steps(value: float, code: int) -> None:
    assert words.field(value, 5.0, 12) == fields.field(value, 5.0, 12) == code
    assert fields.field(5.0 * (2 * 100.9 / 4095 - 1), 5.0, 12) == 100


@pytest.mark.parametrize(
    ("bits", "common"), [(0, 0), (1, 0x10), (6, 0x20), (2, 0x20), (7, 0x30), (0x80, 0x10), (0x100, 0)]
)
def test_an_error_word_means_all_that_any_of_its_bits_means(bits: int, common: int) -> None:
    table = ((0x81, 0x10), (0x06, 0x20))
    assert words.meaning(bits, table) == common
