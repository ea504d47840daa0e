"""The report of a bench test: there after each check, and plain about what it withdraws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from config.loader import load_arm
from rtarm.commissioning.report import Report
from rtloop.kept import commissioned
from rtloop.kept.commissioned import PowerProof


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Report:
    """Of a drive that tells no firmware, and was found to allow everything before."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    arm = load_arm("damiao6", overrides={"bus": {"channel": "/dev/ttyACM0"}})
    blank = Report(arm, 1, tmp_path / "before", None).record
    before = replace(blank, when="2026-01-31T12:00:00Z", power_proof=PowerProof.ABSOLUTE, brakes_in_silence=True)
    commissioned.save(arm, 1, before)
    made = Report(arm, 1, tmp_path / "report", before)
    made.make()
    return made


FINDING = {"check": "answers", "asked": "a", "documented": "b", "came": "c", "verdict": "as documented", "figures": {}}


def test_it_is_there_after_the_first_check_which_withdraws_nothing(report: Report) -> None:
    report.add([FINDING], report.record)
    assert "answers: as documented" in (report.folder / "report.txt").read_text(encoding="utf-8")
    assert report.withdrawn == "" and commissioned.load(report.arm)[1].heals


def test_what_an_exchanged_drive_must_not_inherit_is_withdrawn_in_a_sentence(report: Report) -> None:
    report.add([FINDING], replace(report.record, brakes_in_silence=True))
    assert not commissioned.load(report.arm)[1].heals
    text = (report.folder / "report.txt").read_text(encoding="utf-8")
    assert "bench test of 2026-01-31 had unlocked and this one has not tried (proof of power, healing)" in text
    assert "it tells no firmware, so it may be another drive. All checks in one session unlock it again." in text
    assert report.unlocked() == {"proof of power": None, "healing": None}
    report.add([FINDING], replace(report.record, power_proof=PowerProof.ABSOLUTE))
    assert report.withdrawn == "" and commissioned.load(report.arm)[1].heals


def test_one_that_does_not_brake_in_silence_heals_no_more_whatever_else_was_tried(report: Report) -> None:
    report.add([FINDING], replace(report.record, brakes_in_silence=False))
    assert report.unlocked()["healing"] is False and not commissioned.load(report.arm)[1].heals
