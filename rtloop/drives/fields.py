"""Numbers in fields of a few bits, as drives with "MIT" commands use them; ordinary Python, compiled by `words`."""

LEAST_STEP = 1e-6
"""Share of a step by which a number may be too low, so that a number read from a field goes back in unchanged."""


def field(value: float, most: float, bits: int) -> int:
    """A number within ±most as a field of `bits` bits: 0 is -most, all ones +most; rounded down to a whole step.

    A number beyond the range becomes the end of the range. For NaN, which has no code, the field is undefined;
    `may_be_sent` keeps NaN away.
    """
    steps = (1 << bits) - 1
    share = (min(max(value, -most), most) + most) / (2.0 * most)
    return min(int(share * steps + LEAST_STEP), steps)


def of_field(code: int, most: float, bits: int) -> float:
    """The number within ±most that a field of `bits` bits holds."""
    return code * (2.0 * most) / ((1 << bits) - 1) - most
