"""Numbers in fields of a few bits, as drives with "MIT" commands have them; ordinary Python, compiled by `words`."""

LEAST_STEP = 1e-6
"""Share of a step by which a number may be off, so that what came out of a field goes back in as it was."""


def field(value: float, most: float, bits: int) -> int:
    """A number within ±most as a field of `bits` bits: 0 is -most, all ones +most; cut off to a whole step.

    What is beyond the range becomes its end. Of what is no number the field is undefined, since it has no code for
    that: `may_be_sent` keeps it away.
    """
    steps = (1 << bits) - 1
    share = (min(max(value, -most), most) + most) / (2.0 * most)
    return min(int(share * steps + LEAST_STEP), steps)


def of_field(code: int, most: float, bits: int) -> float:
    """The number that such a field holds."""
    return code * (2.0 * most) / ((1 << bits) - 1) - most
