"""However a bench test ends, it tells what was not seen of its drive; beside a process that is none."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from config.loader import load_arm
from rtarm.calibrate.drives import OfflineDrives
from rtarm.commissioning import run
from rtarm.commissioning.report import Report
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.person import Quit
from rtarm.led.process import NOT_SEEN
from shm.errors import NotRunning, SharedMemoryError

LIMP = "The drive of joint6 is limp."
FOUND = {"problems": [], "enabled": True, "firmware": "2.0.0"}
FINDING = {"check": "answers", "asked": "a", "documented": "b", "came": "c", "verdict": "as documented", "figures": {}}


class Person:
    def __init__(self, *answers: str | Exception) -> None:
        self.told: list[str] = []
        self._answers = list(answers)

    def tell(self, text: str) -> None:
        self.told.append(text)

    def answer(self, question: str) -> str:
        match self._answers.pop(0):
            case Exception() as ends:
                raise ends
            case answer:
                return answer


class Process:
    """One that obeys; `unseen` is what closing it tells."""

    def __init__(self, report: Report, unseen: str | None) -> None:
        self.refused: str | None = None
        self.unseen = unseen
        self._answers: dict[str, Any] = {
            "ready": {"drives": {"5": FOUND, 5: {"joint": "j", "address": 6, "homing_rpm": None, **FOUND}}},
            "checks": [["answers", "It is asked.", "Ask it?", False], ["silence", "It is sent.", "Turn it?", False]],
            "found": {"findings": [FINDING], "record": asdict(report.record)},
        }

    def order(self, _: str) -> None:
        """Obeyed."""

    def answer(self, word: str, told: Callable[[str], None] = lambda _: None) -> Any:
        if word == "ready":
            told("A mark is not kept.")
        return self._answers[word]


@pytest.fixture
def commission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., bool]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(run, "require_at_rest", lambda *_: None)
    monkeypatch.setattr(run, "_recorded", lambda *_: nullcontext())
    overrides = {"bus": {"channel": "/dev/ttyACM0"}}

    def commission(person: Person, unseen: str | None) -> bool:
        @contextmanager
        def offline_process(*_: object) -> Iterator[Process]:
            arm = load_arm("episode1", overrides=overrides)
            process = Process(Report(arm, 5, tmp_path / "report", None), unseen)
            try:
                yield process
            finally:
                process.refused = process.unseen

        monkeypatch.setattr(run, "offline_process", offline_process)
        return run.commission("episode1", "joint6", tmp_path / "report", overrides, person)

    return commission


@pytest.mark.parametrize(
    ("end", "begins", "code"),
    [
        ("n", "", ExitCode.LOOP_REFUSED),
        (Quit("you ended it"), "Ended early (you ended it). ", ExitCode.LOOP_REFUSED),
        (Refusal("The recording cannot be written."), "The recording cannot be written. ", ExitCode.LOOP_REFUSED),
        (SharedMemoryError("It is none."), "It is none. ", ExitCode.LOOP_REFUSED),
        (NotRunning("It is gone."), "It is gone. ", ExitCode.LOOP_DIED),
    ],
)
def test_however_it_ends_a_drive_that_was_not_seen_to_stand_is_told(
    commission: Callable[..., bool], tmp_path: Path, end: str | Exception, begins: str, code: ExitCode
) -> None:
    with pytest.raises(Refusal) as ended:
        commission(Person("y", end), LIMP)
    assert (ended.value.sentence, ended.value.code) == (f"{begins}{LIMP} {NOT_SEEN}", code)
    assert json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["ended"] == str(ended.value)


def test_what_it_refused_is_not_told_twice(commission: Callable[..., bool]) -> None:
    with pytest.raises(Refusal) as ended:
        commission(Person("y", Refusal(LIMP, ExitCode.LOOP_REFUSED)), LIMP)
    assert ended.value.sentence == f"{LIMP} {NOT_SEEN}"


def test_a_drive_that_was_seen_to_stand_is_no_trouble(commission: Callable[..., bool], tmp_path: Path) -> None:
    person = Person("y", "n")
    assert commission(person, None)
    assert "A mark is not kept." in person.told and NOT_SEEN not in (tmp_path / "report" / "report.txt").read_text()


def test_a_calibration_tells_what_is_not_kept_too(commission: Callable[..., bool], tmp_path: Path) -> None:
    person = Person()
    process: Any = Process(Report(load_arm("episode1"), 5, tmp_path, None), None)
    process._answers["ready"]["drives"].pop("5")
    OfflineDrives(process, person)
    assert person.told == ["A mark is not kept."]
