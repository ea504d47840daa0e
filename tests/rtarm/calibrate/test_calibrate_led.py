"""A drive of any family, calibrated by the control process that leads its joint alone, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from calibrating_person import CalibratingPerson
from led_rig import LedArm

from config.loader import load_arm
from config.schema import ArmConfig
from config.serial_adapters import SLCAN_BITRATES
from rtarm.calibrate.arm_file import ArmFile
from rtarm.calibrate.guide import Guide, Values
from rtarm.calibrate.led import LedDrive, by_its_motor
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.person import Quit
from rtarm.led.joint import Led, alone
from rtloop.offline.calibration.session import NotDone
from shm.words import Mode
from sim import faults

JOINT = 1
GEARED = ("odrive6", "mks6", "cia402_6")
WITH_GEAR_INSIDE = ("damiao6", "damiao6_pv", "robstride6", "robstride6_position", "myactuator6")
ARMS = GEARED + WITH_GEAR_INSIDE
TRUE_LOWER_DEG, TRUE_UPPER_DEG = -60.0, 60.0


class Built(NamedTuple):
    """How a joint truly is, and what the arm file says of it."""

    truth: Values
    in_file: Values


def built(name: str) -> Built:
    """Otherwise than the file says, in all three."""
    true_ratio, in_file = (20.0, 25.0) if name in GEARED else (1.0, 2.0)
    return Built(Values(-1, true_ratio, -TRUE_LOWER_DEG if name == "mks6" else 20.0), Values(1, in_file, 45.0))


def file_of(name: str, values: Values, encoder: str | None = None) -> dict[str, Any]:
    """An arm file with other values of one joint."""
    fields = load_arm(name).model_dump(mode="json", exclude_unset=True)
    joint = fields["joints"][JOINT]
    joint |= vars(values) | {"lower_deg": TRUE_LOWER_DEG, "upper_deg": TRUE_UPPER_DEG}
    if name == "mks6":
        joint["max_acceleration_rad_s2"] = 1.7  # for which its drive has a ramp with either ratio
    if encoder is not None:
        joint["drive"]["encoder"] = encoder
    return fields


SCENES: list[Scene] = []


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while SCENES:
        SCENES.pop().rig.close()


class Scene(CalibratingPerson):
    """Such a joint, which is not what its arm file says, and a person who sees what truly happens."""

    def __init__(
        self, folder: Path, name: str, how: Built, *, by: str = "d", start_deg: float = -10.0, encoder: str | None = None
    ) -> None:
        super().__init__(self, by)
        self.between_deg = 45.0
        self.path = folder / f"{name}.yaml"
        self.path.write_text(yaml.safe_dump(file_of(name, how.in_file, encoder)), encoding="utf-8")
        self.arm = load_arm(self.path)
        self.truth = ArmConfig.model_validate(
            alone(ArmConfig.model_validate(file_of(name, how.truth, encoder)), JOINT)
        )
        self.alone = ArmConfig.model_validate(by_its_motor(self.arm, JOINT))
        self.rig = LedArm(self.alone, [math.radians(start_deg)], really=self.truth, homed=True)
        self._used = False
        self.drive = LedDrive(self.arm, JOINT, self._brought_up)
        SCENES.append(self)

    @contextmanager
    def _brought_up(self) -> Iterator[Led]:
        """Each time by another control process, at the same drive."""
        if self._used:
            before, self.rig = self.rig, LedArm(self.alone, [0.0])
            self.rig.sim, self.rig.drive, self.rig.now_ns = before.sim, before.drive, before.now_ns + 10_000_000
            self.rig.sim.feed(self.rig.now_ns, f"C\r{SLCAN_BITRATES[self.alone.bus.bitrate]}\rO\r".encode())  # type: ignore[union-attr]
            before.close()
        self._used = True
        self.rig.supervise()
        yield self.rig.led

    def go(self) -> ArmConfig:
        """A whole calibration: the arm as the file says afterwards."""
        file = ArmFile(str(self.path), None)
        with self.drive as drive:
            self.guide = Guide(self.arm, JOINT, drive, self, lambda changes: file.require_valid(JOINT, changes))
            self.guide.go()
        file.write(JOINT, self.guide.changes)
        return load_arm(self.path)

    @property
    def here_deg(self) -> float:
        return self.rig.true_deg()

    @property
    def true_ratio(self) -> float:
        return self.truth.joints[0].ratio

    def by_hand(self, to_deg: float) -> None:
        rig, config = self.rig, self.truth.joints[0]
        assert not rig.drive.enabled
        way = math.copysign(1.0, to_deg - self.here_deg)
        rig.drive.lead(rig.now_ns, way * config.direction * config.ratio * 10.0 / 360.0)
        while way * (to_deg - self.here_deg) > 0.0:
            rig.pass_time()
        rig.drive.lead(rig.now_ns, 0.0)
        for _ in range(50):
            rig.pass_time()


@pytest.mark.parametrize("name", ARMS)
def test_a_wrong_direction_ratio_and_zero_are_found_and_written(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how)
    found = scene.go().joints[JOINT]
    assert (found.direction, found.ratio) == (how.truth.direction, how.truth.ratio)
    assert found.zero_deg == pytest.approx(how.truth.zero_deg, abs=0.1)
    assert scene.rig.drive.enabled
