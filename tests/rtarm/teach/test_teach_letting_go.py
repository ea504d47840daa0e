"""When an arm is let go, and that it is held again whatever a signal interrupts."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import NoReturn

import pytest
from written_arm import WrittenArm

from rtarm.console.errors import Refusal
from rtarm.teach import teach as teaching
from rtarm.teach.recording import FreeMotion
from rtarm.teach.teach import Wish, teach
from shm.files import MemoryFile
from shm.words import Answer, DriveStatus, Mode, Request


class Listener:
    """Somebody who is told things, and asked nothing."""

    def tell(self, text: str) -> None:
        pass

    def answer(self, question: str) -> NoReturn:
        raise AssertionError(question)


def obey(arm: WrittenArm, kind: int) -> int:
    limp = kind == Request.FREE
    arm.snapshot["mode"] = Mode.FREE if limp else Mode.HOLDING
    arm.rows["drive_status"] = DriveStatus.ANSWERED if limp else DriveStatus.ANSWERED | DriveStatus.ENABLED
    return Answer.DONE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_before_the_first_reading_leaves_no_limp_arm(
    arm: WrittenArm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    class Interrupted(FreeMotion):
        def __init__(self, memory: MemoryFile) -> None:
            os.kill(os.getpid(), number)
            super().__init__(memory)

    monkeypatch.setattr(teaching, "FreeMotion", Interrupted)
    wish = Wish(str(tmp_path / "wave.yaml"), tolerance_deg=0.5, seconds=0.1, yes=True, force=False)
    with arm.answering(obey), pytest.raises(Refusal, match="Too little was recorded"):
        teach(arm.name, wish, Listener())
    assert arm.snapshot["mode"] == Mode.HOLDING


@pytest.mark.parametrize("words", [{"mode": Mode.EXECUTING, "goal_id": 4}, {"goal_id": 4}])
def test_nobody_is_asked_to_hold_an_arm_that_moves(arm: WrittenArm, tmp_path: Path, words: dict[str, int]) -> None:
    for word, value in words.items():
        arm.snapshot[word] = value
    arm.publish()
    wish = Wish(str(tmp_path / "wave.yaml"), tolerance_deg=0.5, seconds=0.1, yes=False, force=False)
    with pytest.raises(Refusal, match="moves, or its goal is paused"):
        teach(arm.name, wish, Listener())
