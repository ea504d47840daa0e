"""A drive of any family, calibrated by the control process that leads its joint alone, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
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
from rtarm.console.interrupt import Interrupted
from rtarm.console.person import Quit
from rtarm.led.joint import Led, alone
from rtloop.offline.calibration.session import NotDone
from shm.words import Mode
from sim import faults

JOINT = 1
GEARED = ("odrive6", "mks6", "cia402_6")
WITH_GEAR_INSIDE = ("damiao6", "damiao6_pv", "robstride6", "robstride6_position", "myactuator6", "vesc6")
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
        self,
        folder: Path,
        name: str,
        how: Built,
        *,
        by: str = "d",
        start_deg: float = -10.0,
        encoder: str | None = None,
        reach_deg: float | None = None,
    ) -> None:
        super().__init__(self, by)
        self.between_deg = 45.0
        self.path = folder / f"{name}.yaml"
        self.path.write_text(yaml.safe_dump(file_of(name, how.in_file, encoder)), encoding="utf-8")
        self.arm = load_arm(self.path)
        self.truth = ArmConfig.model_validate(alone(ArmConfig.model_validate(file_of(name, how.truth, encoder)), JOINT))
        values = by_its_motor(self.arm, JOINT)
        if reach_deg is not None:
            values["joints"][0] |= {"lower_deg": -reach_deg, "upper_deg": reach_deg}
        self.alone = ArmConfig.model_validate(values)
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

        def is_there() -> bool:
            if way * (to_deg - self.here_deg) <= 0.0:
                return True
            rig.drive.lead(rig.now_ns, way * config.direction * config.ratio * 10.0 / 360.0)  # however often it lets go
            return False

        rig.until(is_there)
        rig.drive.lead(rig.now_ns, 0.0)
        for _ in range(50):
            rig.pass_time()


def until_it_moves(scene: Scene, then: Callable[[], None], by_deg: float = 0.4) -> None:
    """Have something happen amid its first move."""
    lived, began_deg = scene.rig.pass_time, scene.here_deg

    def pass_time() -> None:
        lived()
        if abs(scene.here_deg - began_deg) > by_deg:
            scene.rig.led._pass_time = lived
            then()

    scene.rig.led._pass_time = pass_time


@pytest.mark.parametrize("name", ARMS)
def test_a_wrong_direction_ratio_and_zero_are_found_and_written(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how)
    found = scene.go().joints[JOINT]
    assert (found.direction, found.ratio) == (how.truth.direction, how.truth.ratio)
    assert found.zero_deg == pytest.approx(how.truth.zero_deg, abs=0.1)
    assert scene.rig.drive.enabled


@pytest.mark.parametrize("name", ["odrive6", "mks6", "damiao6", "myactuator6"])
def test_the_ratio_by_hand(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how, by="h")
    given = scene.answer

    def answer(question: str) -> str:
        if "zero mark" in question or "Home joint2" in question:
            scene.by = "d"
        return given(question)

    scene.answer = answer  # type: ignore[method-assign]
    found = scene.go().joints[JOINT]
    assert (found.direction, found.ratio) == (how.truth.direction, how.truth.ratio)
    assert found.zero_deg == pytest.approx(how.truth.zero_deg, abs=0.1)
    assert scene.rig.drive.enabled


@pytest.mark.parametrize("name", [name for name in ARMS if name != "mks6"])
def test_of_a_drive_that_does_not_know_its_angle_no_zero_is_sought(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how, encoder="incremental")
    found = scene.go().joints[JOINT]
    assert (found.direction, found.ratio, found.zero_deg) == (how.truth.direction, how.truth.ratio, 45.0)
    assert "does not know by itself where the joint stands" in " ".join(scene.told)
    assert not any("At how many degrees" in question for question in scene.asked)
    assert not any("was not found with these values" in line for line in scene.told)


@pytest.mark.parametrize("motor_deg", [30.0, 7.5])
@pytest.mark.parametrize("name", ARMS)
def test_one_that_does_not_follow_is_stopped_and_presses_no_more(tmp_path: Path, name: str, motor_deg: float) -> None:
    scene = Scene(tmp_path, name, built(name))
    with scene.drive as drive:
        began_deg = scene.here_deg
        scene.rig.drive.block_shaft(scene.rig.now_ns)
        with pytest.raises(Refusal) as refused:
            drive.turn(motor_deg / 360.0, 1)
        assert refused.value.code == ExitCode.LOOP_REFUSED
        joint = scene.rig.led.joint()
        away_rad = abs(float(joint["commanded_position_rad"] - joint["measured_position_rad"]))
        assert scene.rig.led.fault(scene.rig.led.snapshot()) or away_rad < math.radians(0.1)
    assert "does not turn as it was told: it was stopped, after" in str(refused.value)
    assert f"of {motor_deg:+.1f}° of the motor" in str(refused.value)
    assert scene.here_deg == pytest.approx(began_deg, abs=0.1)


@pytest.mark.parametrize("name", ARMS)
def test_one_that_falls_silent_amid_a_move_ends_it(tmp_path: Path, name: str) -> None:
    scene = Scene(tmp_path, name, built(name))
    with scene.drive as drive:
        began_deg, sim = scene.here_deg, scene.rig.sim
        assert sim is not None
        until_it_moves(scene, lambda: sim.inject(faults.Silent("joint2", 0.0, 60.0), sim.now_ns))
        with pytest.raises(Refusal) as refused:
            drive.turn(1.0 / 12.0, 1)
        assert refused.value.code == ExitCode.LOOP_REFUSED
        with pytest.raises(Refusal):
            drive.look()
        scene.rig.led.let_pass(1.0)
        assert "did not answer at the end" in scene.rig.led.not_seen_to_stand()
    gone_deg = abs(scene.here_deg - began_deg) * scene.true_ratio
    assert gone_deg < 30.5
    scene.rig.cycles(50)
    assert abs(scene.here_deg - began_deg) * scene.true_ratio == pytest.approx(gone_deg, abs=0.1)


@pytest.mark.parametrize("name", ARMS)
def test_a_signal_amid_a_move_stops_it(tmp_path: Path, name: str) -> None:
    scene = Scene(tmp_path, name, built(name))

    def interrupt() -> None:
        raise Interrupted("SIGINT")

    with pytest.raises(Interrupted), scene.drive as drive:
        began_deg = scene.here_deg
        until_it_moves(scene, interrupt)
        drive.turn(1.0 / 12.0, 1)
    scene.rig.cycles(round(1e9 / scene.rig.period_ns))
    stands_deg = scene.here_deg
    assert 0.4 < abs(stands_deg - began_deg) * scene.true_ratio < 25.0
    scene.rig.cycles(100)
    assert scene.here_deg == pytest.approx(stands_deg, abs=0.01)
    assert scene.rig.drive.enabled and scene.rig.led.not_seen_to_stand() == ""


def test_a_homing_run_that_is_ended_stands_and_is_seen_to(tmp_path: Path) -> None:
    """Far from where it began: a drive without a reference is not away from anything."""
    scene = Scene(tmp_path, "mks6", built("mks6"))

    def interrupt() -> None:
        raise Interrupted("SIGINT")

    with scene.drive:
        led, began_deg = scene.rig.led, scene.here_deg
        until_it_moves(scene, interrupt, by_deg=20.0)
        with pytest.raises(Interrupted), led.stopped_by_any_end():
            led.home()
        assert led.not_seen_to_stand() == "joint2 was still on its way."
        led.until(lambda now: int(now["mode"]) == Mode.HOLDING, 5.0)
        stands_deg = scene.here_deg
        assert led.not_seen_to_stand() == "" and not led.referenced
        scene.rig.cycles(100)
    assert 20.0 < abs(stands_deg - began_deg) < 45.0
    assert scene.here_deg == pytest.approx(stands_deg, abs=0.01)


@pytest.mark.parametrize("name", ["mks6", "damiao6"])
def test_a_joint_that_is_limp_when_it_ends_is_held_again(tmp_path: Path, name: str) -> None:
    scene = Scene(tmp_path, name, built(name))
    with pytest.raises(Quit), scene.drive as drive:
        assert drive.look().enabled
        assert not drive.let_go().enabled
        raise Quit("you ended it")
    assert scene.rig.drive.enabled and scene.rig.memory["mode"] == Mode.HOLDING


@pytest.mark.parametrize("name", ARMS)
def test_a_move_is_as_far_and_as_fast_as_it_was_told(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how)
    with scene.drive as drive:
        began, began_deg, ns = drive.look().turns, scene.here_deg, scene.rig.now_ns
        after = drive.turn(-1.0 / 12.0, 2)
    assert (after.turns - began) * 360.0 == pytest.approx(-30.0, abs=0.5)
    assert (scene.here_deg - began_deg) * how.truth.ratio * how.truth.direction == pytest.approx(-30.0, abs=0.5)
    assert scene.rig.sim is not None
    _, speeds_rad_s = scene.rig.sim.truth(0, range(ns, scene.rig.now_ns, 10_000_000))
    assert max(abs(speeds_rad_s)) * how.truth.ratio < 2.0 * math.tau / 60.0 * 1.2


def test_no_move_leads_beyond_the_range_or_beyond_what_the_drive_can_be_told(tmp_path: Path) -> None:
    scene = Scene(tmp_path, "damiao6", built("damiao6"))
    with scene.drive as drive:
        began_deg = scene.here_deg
        with pytest.raises(NotDone, match="120° with a ratio of 2: turn it by hand"):
            drive.turn(0.7, 10)
        scene.drive._origin_rad += math.pi * 1.9
        with pytest.raises(NotDone, match=r"can be commanded within 1.989: turn the joint the other way"):
            drive.turn(0.2, 10)
    assert scene.here_deg == pytest.approx(began_deg, abs=0.05)


def test_a_first_move_beyond_what_the_drive_can_be_told_is_made_the_other_way(tmp_path: Path) -> None:
    """Else a drive that stands near an end of what it counts could not be calibrated at all."""
    scene = Scene(tmp_path, "damiao6", built("damiao6"), by="")
    given, ways = scene.answer, iter("yoy")

    def answer(question: str) -> str:
        return next(ways) if "Turn it? [y/N; o" in question else given(question)

    with scene.drive as drive:
        scene.drive._origin_rad = math.pi * 1.97
        scene.answer = answer  # type: ignore[method-assign]
        scene.seen_deg = scene.here_deg
        scene.guide = Guide(scene.arm, JOINT, drive, scene, lambda changes: None)
        scene.guide.go()
    assert any("turn the joint the other way" in line for line in scene.told)
    assert scene.guide.values.direction == built("damiao6").truth.direction


@pytest.mark.parametrize("name", [*ARMS, "episode1"])
def test_every_joint_can_be_brought_up_by_its_motor(name: str) -> None:
    arm = load_arm(name)
    for joint, config in enumerate(arm.joints):
        found = ArmConfig.model_validate(by_its_motor(arm, joint)).joints[0]
        assert (found.direction, found.zero_deg, found.ratio) == (1, 0.0, config.ratio)
        assert found.upper_deg == -found.lower_deg <= config.upper_deg - config.lower_deg


@pytest.mark.parametrize("by", ["d", "h"])
def test_who_ends_it_at_any_question_leaves_the_joint_held_where_it_stands(tmp_path: Path, by: str) -> None:
    """The zero aside, which asks the same again."""
    how = built("damiao6")
    whole = Scene(tmp_path, "damiao6", how, by=by, encoder="incremental")
    whole.go()
    for question in range(len(whole.asked)):
        scene = Scene(tmp_path, "damiao6", how, by=by, encoder="incremental")
        scene.ends_at = question
        with pytest.raises(Quit):
            scene.go()
        stands_deg = scene.here_deg
        scene.rig.cycles(50)
        assert scene.rig.drive.enabled and scene.here_deg == pytest.approx(stands_deg, abs=0.05)
        assert scene.rig.led.not_seen_to_stand() == ""
    assert len(whole.asked) > 8


@pytest.mark.parametrize("name", ["odrive6", "mks6", "damiao6"])
def test_a_joint_that_was_turned_far_by_hand_goes_on_from_there(tmp_path: Path, name: str) -> None:
    how = built(name)
    scene = Scene(tmp_path, name, how, reach_deg=10.0)
    with scene.drive as drive:
        began, began_deg = drive.look(), scene.here_deg
        drive.let_go()
        scene.by_hand(began_deg + 40.0)
        held = drive.hold()
        assert scene.rig.led.referenced
        moved = drive.turn(1.0 / 24.0, 2)
    by_hand_deg = 40.0 * how.truth.ratio * how.truth.direction
    assert (held.turns - began.turns) * 360.0 == pytest.approx(by_hand_deg, rel=0.02)
    assert (moved.turns - held.turns) * 360.0 == pytest.approx(15.0, abs=0.5)


def test_a_joint_that_falls_silent_when_it_is_up_is_not_left_behind(tmp_path: Path) -> None:
    scene = Scene(tmp_path, "damiao6", built("damiao6"))
    closed: list[bool] = []

    @contextmanager
    def falls_silent() -> Iterator[Led]:
        with scene._brought_up() as led:
            assert scene.rig.sim is not None
            scene.rig.sim.inject(faults.Silent("joint2", 0.0, 60.0), scene.rig.sim.now_ns)
            scene.rig.led.let_pass(0.5)
            try:
                yield led
            finally:
                closed.append(True)

    with pytest.raises(Refusal, match="joint2"), LedDrive(scene.arm, JOINT, falls_silent):
        raise AssertionError
    assert closed
