"""Which way `rtarm calibrate` turns which drives of an arm, and what it says of one that was not seen to stand."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from mixed_arm import mixed
from two_buses import divided

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate import run
from rtarm.calibrate.arm_file import ArmFile
from rtarm.calibrate.run import Calibration
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.person import Quit
from rtarm.led import process as led_process
from rtarm.led.joint import alone
from rtarm.led.process import NOT_SEEN, LedProcess, led_alone
from shm.errors import NotRunning

LIMP = "The drive of joint2 is limp."


class Silent:
    """A person who is told and asked nothing."""

    def tell(self, text: str) -> None:
        assert text == "Nothing was written."

    def answer(self, question: str) -> str:
        raise AssertionError(question)


class Ways(Calibration):
    """One that notes which way each joint is turned."""

    def __init__(self, *what: Any) -> None:
        super().__init__(*what)
        self.ways: list[tuple[str, Sequence[int]]] = []

    def _by_dialogues(self, joints: Sequence[int]) -> None:
        self.ways.append(("dialogues", joints))

    def _led(self, joint: int) -> None:
        self.ways.append(("led", [joint]))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mixed.yaml"
    path.write_text(yaml.safe_dump(mixed().model_dump(mode="json", exclude_unset=True)), encoding="utf-8")
    return path


def test_joints_are_turned_in_their_order_and_one_process_has_the_bus_at_a_time(file: Path) -> None:
    ways = Ways(load_arm(file), str(file), {}, Silent(), ArmFile(str(file), None))
    ways.go([0, 2, 3, 4, 5])
    assert ways.ways == [("dialogues", [0, 2]), ("led", [3]), ("dialogues", [4]), ("led", [5])]


@pytest.mark.parametrize(
    ("end", "unseen", "sentence", "code"),
    [
        (None, "", None, None),
        (None, LIMP, f"{LIMP} {NOT_SEEN}", ExitCode.LOOP_REFUSED),
        (Quit("you ended it"), "", "Ended (you ended it); the arm stands. Nothing was written.", ExitCode.REFUSED),
        (Quit("you ended it"), LIMP, f"{LIMP} {NOT_SEEN} Nothing was written.", ExitCode.LOOP_REFUSED),
        (Refusal("It is held.", ExitCode.LOOP_REFUSED), "", "It is held.", ExitCode.LOOP_REFUSED),
        (Refusal(LIMP, ExitCode.LOOP_REFUSED), LIMP, f"{LIMP} {NOT_SEEN}", ExitCode.LOOP_REFUSED),
        (NotRunning("It is gone."), LIMP, f"It is gone. {LIMP} {NOT_SEEN}", ExitCode.LOOP_DIED),
    ],
)
def test_however_it_ends_a_drive_that_was_not_seen_to_stand_is_told(
    monkeypatch: pytest.MonkeyPatch,
    file: Path,
    end: Exception | None,
    unseen: str,
    sentence: str | None,
    code: ExitCode | None,
) -> None:
    process = LedProcess.__new__(LedProcess)
    process.refused = unseen

    class Led:
        def __init__(self, *_: object) -> None:
            """Led by that process."""

        def __enter__(self) -> Led:
            return self

        def __exit__(self, *_: object) -> None:
            """Ended."""

    def one_joint(calibration: Calibration, *_: object) -> None:
        calibration._process = process
        if end is not None:
            raise end

    monkeypatch.setattr(run, "require_at_rest", lambda *_: None)
    monkeypatch.setattr(run, "agrees", lambda *_: True)
    monkeypatch.setattr(run, "LedDrive", Led)
    monkeypatch.setattr(Calibration, "_one_joint", one_joint)
    monkeypatch.setattr(Calibration, "_introduce", lambda _: None)
    if sentence is None:
        run.calibrate(str(file), ["joint2"], None, {}, Silent())
        return
    with pytest.raises(Refusal) as ended:
        run.calibrate(str(file), ["joint2"], None, {}, Silent())
    assert (ended.value.sentence, ended.value.code) == (sentence, code)


def test_what_another_one_keeps_that_began_meanwhile_is_left_to_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its control process has its references there."""
    arm = load_arm("odrive6")
    kept = tmp_path / "rtarm-led-odrive6-another"
    kept.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(led_process.files, "open_state", lambda name: BytesIO())
    with pytest.raises(Refusal, match="this arm has one already"), led_alone(arm, 0, alone(arm, 0)):
        raise AssertionError
    assert list(tmp_path.iterdir()) == [kept]


def test_a_joint_that_is_led_alone_has_its_bus_alone() -> None:
    arm = divided("odrive6")
    led = ArmConfig.model_validate(alone(arm, 4))
    assert [joint.name for joint in led.joints] == [arm.joints[4].name]
    assert [bus.channel for bus in led.buses] == ["/dev/ttywrist"]
