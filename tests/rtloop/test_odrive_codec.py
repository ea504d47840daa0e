"""ODrive frames beyond `tests/golden/odrive.yaml`: numbers against struct."""

import struct

from codec_rig import word
from hypothesis import given, settings
from hypothesis import strategies as st

from rtloop.drives import odrive


@settings(deadline=None)  # some of it is compiled on the way
@given(turns=st.floats(allow_nan=False, allow_infinity=False, width=32), turns_s=st.floats(-40.0, 40.0))
def test_positions_and_velocities_are_packed_as_struct_does(turns: float, turns_s: float) -> None:
    ahead = min(max(round(turns_s * 1000.0), -32_767), 32_767)
    expected = word(struct.pack("<fhh", turns, ahead, 0))
    assert odrive.input_position(turns, turns_s) == odrive.input_position.py_func(turns, turns_s) == expected
