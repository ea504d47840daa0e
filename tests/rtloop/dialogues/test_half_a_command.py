"""What a control process that was killed in mid-command leaves behind does not keep the next one from starting."""

import pytest
from virtual import VirtualArm

from shm.words import Mode


@pytest.mark.parametrize("drive", [1, 6])
def test_half_a_position_command_before_the_bring_up(drive: int) -> None:
    arm = VirtualArm()
    arm.sim.feed(arm.sim.now_ns, b"T%06X008FD0A0BB8FF000000\r" % drive)
    talk = arm.bring_up()
    assert talk.failure is None, str(talk.failure)
    assert arm.memory["mode"] == Mode.HOLDING
    arm.close()
