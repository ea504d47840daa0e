"""Arms in virtual time, closed after each test."""

import ctypes
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from virtual import VirtualArm, recorded_goal

from rtloop.system import realtime


@pytest.fixture
def unlocked(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """For a control process that is served in this one, whose memory stays as it is and the processors' sleep too."""
    monkeypatch.setattr(realtime, "prepare_process", lambda used: realtime.Obtained(memory_locked=True))
    yield
    ctypes.CDLL(None).munlockall()  # stacks of its threads, and the recorder


@pytest.fixture
def virtual_arm() -> Iterator[Callable[..., VirtualArm]]:
    """Makes arms that are brought up and hold."""
    arms: list[VirtualArm] = []

    def make(*arguments: Any, bring_up: bool = True, goal: str | None = None, **options: Any) -> VirtualArm:
        if goal is not None:
            options["start_rad"] = recorded_goal(goal)["joints"][0, :, 0]
        arm = VirtualArm(*arguments, **options)
        arms.append(arm)
        if bring_up:
            assert arm.bring_up().failure is None
        return arm

    yield make
    for arm in arms:
        arm.close()
