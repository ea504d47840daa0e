"""Bringing ODrives up in virtual time: what depends on when they speak."""

import pytest
from virtual import VirtualArm

from config.loader import load_arm
from config.schema import ArmConfig
from shm.words import Answer, Mode, Request


@pytest.mark.parametrize("heartbeat_ms", [10, 350, 1000])
def test_every_heartbeat_that_an_arm_file_may_name_is_waited_for(heartbeat_ms: int) -> None:
    given = load_arm("odrive6").model_dump(mode="json")
    for joint in given["joints"]:
        joint["drive"]["heartbeat_ms"] = heartbeat_ms
    arm = VirtualArm(ArmConfig.model_validate(given))
    assert arm.bring_up(at_most_s=20.0).failure is None
    arm.until(lambda: arm.core["mode"] == Mode.HOLDING, at_most_s=1.0)  # the ring still holds what was said last
    assert arm.ask(Request.DISABLE) == Answer.DONE
    assert arm.release(at_most_s=20.0).failure is None
    arm.close()
