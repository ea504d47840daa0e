"""An encoder that a bench test has found to be none is not believed."""

from __future__ import annotations

from pathlib import Path

import pytest

from config.loader import load_arm
from config.schema import ArmConfig
from rtloop import commissioned
from rtloop.commissioned import Commissioned, PowerProof
from rtloop.false_encoders import refuse_false_encoders
from rtloop.process import CannotStart
from rtloop.saved import channel_of


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ArmConfig:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return load_arm("damiao6", overrides={"bus": {"channel": "/dev/ttyACM0"}})


def keep(arm: ArmConfig, proof: PowerProof) -> None:
    drive = arm.joints[1].drive
    found = Commissioned(
        channel_of(arm), drive.family, drive.number, "", "2026-01-31T12:00:00Z", proof, "its angle was kept, 30.0° away"
    )
    commissioned.save(arm, 1, found)


def test_an_arm_file_that_says_absolute_of_such_a_drive_is_refused_with_what_was_found(arm: ArmConfig) -> None:
    refuse_false_encoders(arm)
    keep(arm, PowerProof.ABSOLUTE)
    refuse_false_encoders(arm)
    keep(arm, PowerProof.NONE)
    with pytest.raises(CannotStart, match=r"joint2 is absolute .* of 2026-01-31 has found otherwise .*30.0° away"):
        refuse_false_encoders(arm)


def test_one_that_says_incremental_is_not(arm: ArmConfig) -> None:
    keep(arm, PowerProof.NONE)
    drive = arm.joints[1].drive.model_copy(update={"encoder": "incremental"})
    joints = [arm.joints[0], arm.joints[1].model_copy(update={"drive": drive}), *arm.joints[2:]]
    refuse_false_encoders(arm.model_copy(update={"joints": joints}))
