"""ODrive frames beyond `tests/golden/odrive.yaml`: numbers against struct, and which zeros are a position."""

import struct

import pytest
from codec_rig import Rig, word
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.drives import odrive
from rtloop.memory import status


@settings(deadline=None)  # some of it is compiled on the way
@given(turns=st.floats(allow_nan=False, allow_infinity=False, width=32), turns_s=st.floats(-40.0, 40.0))
def test_positions_and_velocities_are_packed_as_struct_does(turns: float, turns_s: float) -> None:
    ahead = min(max(round(turns_s * 1000.0), -32_767), 32_767)
    expected = word(struct.pack("<fhh", turns, ahead, 0))
    assert odrive.input_position(turns, turns_s) == expected


LATER_NS = 1_000_000_000
ZEROS = "029# 00 00 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("measured_rad", "age_ns", "closed", "status_age_ns", "told"),
    [
        (0.05, 0, False, 0, True),  # where it was just measured
        (0.15, 0, False, 0, False),  # not there
        (0.15, 0, True, 0, False),
        (0.05, 200_000_000, False, 0, False),  # it has not been measured for long
        (0.15, 200_000_000, True, 100_000_000, True),  # but has said since that its loop is closed
        (0.15, 200_000_000, True, 200_000_000, True),
        (0.05, 200_000_000, True, 300_000_000, False),  # or before that: it may have lost its power meanwhile
    ],
)
def test_zeros_are_believed_where_they_follow_from_what_is_known(
    measured_rad: float, age_ns: int, closed: bool, status_age_ns: int, told: bool
) -> None:
    rig = Rig.named("odrive").stands(measured_rad)
    rig.record["timing"]["now_ns"], rig.axis["measured"]["readings"] = LATER_NS, 1
    rig.axis["measured"]["time_ns"] = LATER_NS - age_ns
    rig.axis["drive"]["status"], rig.axis["drive"]["status_ns"] = status.ENABLED * closed, LATER_NS - status_age_ns
    assert ("position_rad" in rig.hears(ZEROS)) == told
