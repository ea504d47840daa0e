"""A sample of the trials of a person's stop (many: `make stop-trials`), and what they notice."""

from collections.abc import Callable

import pytest
import stop_trials
from stop_trials import SENDERS, Found, Retrying, run_trial

from shm.client import CommandWriter


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("sender", SENDERS)
def test_a_stop_at_a_random_moment_is_the_end_of_all_motion_until_the_resume(sender: str, seed: int) -> None:
    assert run_trial(sender, seed).violations == []


@pytest.mark.parametrize("seed", range(3, 13))
@pytest.mark.parametrize("sender", SENDERS)
def test_the_same_of_commanded_motion_alone(sender: str, seed: int) -> None:
    assert run_trial(sender, seed, "mock").violations == []


class Resuming(Retrying):
    """A client's process that resumes what a person has stopped."""

    def turn(self) -> None:
        super().turn()
        self.arm.writer.resume()


def sabotaged(monkeypatch: pytest.MonkeyPatch, sender: type[Retrying], stop: Callable[[CommandWriter], None]) -> Found:
    monkeypatch.setitem(stop_trials.SENDERS, "sabotage", sender)
    monkeypatch.setattr(CommandWriter, "stop", stop)
    return run_trial("sabotage", 2, "mock")


def test_a_trial_notices_a_stop_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    found = sabotaged(monkeypatch, Retrying, lambda writer: None)
    assert any(sentence.startswith("commanded") for sentence in found.violations)


def test_a_trial_notices_a_stop_that_only_slows(monkeypatch: pytest.MonkeyPatch) -> None:
    found = sabotaged(monkeypatch, Retrying, lambda writer: writer.scale(0.0))
    assert any("held 0" in sentence for sentence in found.violations)


def test_a_trial_notices_motion_after_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    found = sabotaged(monkeypatch, Resuming, CommandWriter.stop)
    assert any("commanded to move again" in sentence for sentence in found.violations)
