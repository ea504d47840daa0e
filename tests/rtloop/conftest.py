"""Arms in virtual time, closed after each test."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from virtual import VirtualArm, recorded_goal


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
