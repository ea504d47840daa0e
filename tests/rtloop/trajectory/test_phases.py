"""The table of a goal's phases: what it allows, and that each change of it happens."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from virtual import VirtualArm

from rtloop.safety.faults import latch_fault
from rtloop.trajectory.phases import ALLOWED, change_phase
from shm.words import Fault, Outcome, Phase


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("to", Phase)
def test_a_goal_changes_its_phase_as_the_table_allows(phase: Phase, to: Phase) -> None:
    arm = VirtualArm.brought_up("mock")
    arm.running["phase"] = phase
    allowed = to in ALLOWED[phase]
    assert change_phase(arm.loop[0], int(arm.memory["goals"]["active"]), to) == allowed
    assert arm.running["phase"] == (to if allowed else phase)
    arm.close()


def comes_to(arm: VirtualArm, phase: Phase) -> None:
    arm.until(lambda: arm.running["phase"] == phase)


def waiting(arm: VirtualArm) -> None:
    arm.send_shift(start_ns=arm.now_ns + 500_000_000)
    arm.until(lambda: arm.waiting_goal != 0)


def running(arm: VirtualArm) -> None:
    arm.send_shift(0.05)
    comes_to(arm, Phase.RUNNING)
    arm.cycles(30)


def settling(arm: VirtualArm) -> None:
    running(arm)
    arm.writer.scale(1.0)
    comes_to(arm, Phase.SETTLING)


def stopping(arm: VirtualArm) -> None:
    running(arm)
    arm.stop()


def paused(arm: VirtualArm) -> None:
    running(arm)
    arm.hold()


def paused_while_settling(arm: VirtualArm) -> None:
    settling(arm)
    arm.hold()
    arm.cycles(10)


STORIES: dict[tuple[Phase, Phase], tuple[Callable[[VirtualArm], None], Callable[[VirtualArm], object]]] = {
    (Phase.NONE, Phase.WAITING): (lambda arm: None, waiting),
    (Phase.WAITING, Phase.RUNNING): (waiting, lambda arm: comes_to(arm, Phase.RUNNING)),
    (Phase.WAITING, Phase.NONE): (waiting, lambda arm: arm.cancel(arm.waiting_goal)),
    (Phase.RUNNING, Phase.PAUSED): (running, lambda arm: arm.hold()),
    (Phase.RUNNING, Phase.SETTLING): (running, lambda arm: comes_to(arm, Phase.SETTLING)),
    (Phase.RUNNING, Phase.STOPPING): (running, lambda arm: arm.cancel(arm.running_goal)),
    (Phase.RUNNING, Phase.NONE): (running, lambda arm: arm.end_of(arm.send_shift(0.1))),
    (Phase.SETTLING, Phase.PAUSED): (settling, lambda arm: arm.hold()),
    (Phase.SETTLING, Phase.STOPPING): (settling, lambda arm: arm.cancel(arm.running_goal)),
    (Phase.SETTLING, Phase.NONE): (settling, lambda arm: comes_to(arm, Phase.NONE)),
    (Phase.STOPPING, Phase.NONE): (stopping, lambda arm: comes_to(arm, Phase.NONE)),
    (Phase.PAUSED, Phase.RUNNING): (paused, lambda arm: arm.resume()),
    (Phase.PAUSED, Phase.SETTLING): (paused_while_settling, lambda arm: arm.resume()),
    (Phase.PAUSED, Phase.STOPPING): (paused, lambda arm: arm.stop()),
    (Phase.PAUSED, Phase.NONE): (paused, lambda arm: arm.cycle(periods=30)),  # the drives have stopped by themselves
}


def test_there_is_a_story_for_each_change() -> None:
    assert set(STORIES) == {(phase, to) for phase, goes_to in ALLOWED.items() for to in goes_to}


@pytest.mark.parametrize("change", STORIES, ids=lambda change: f"{change[0].name}-{change[1].name}".lower())
def test_each_change_happens(change: tuple[Phase, Phase], monkeypatch: pytest.MonkeyPatch) -> None:
    arm = VirtualArm.brought_up("mock")
    prepare, act = STORIES[change]
    prepare(arm)
    seen = []
    cycle = arm.cycle

    def watched(periods: int = 1) -> None:
        before = arm.loop[0]["paths"]["phase"].copy()
        cycle(periods)
        seen.extend(zip(before, arm.loop[0]["paths"]["phase"], strict=True))

    monkeypatch.setattr(arm, "cycle", watched)
    act(arm)
    arm.cycles(2)
    assert change in seen
    arm.close()


def test_the_first_reason_to_stop_stands_but_a_fault_comes_before_it() -> None:
    arm = VirtualArm.brought_up("mock")
    running(arm)
    goal = arm.running_goal
    arm.cancel(goal)
    arm.stop()
    assert arm.running["reason"] == Outcome.CANCELED
    latch_fault(arm.loop[0], arm.state.array[0], Fault.FOLLOWING_ERROR, 0, 1.0, 0.1)
    assert arm.running["reason"] == Outcome.FAULT
    assert arm.end_of(goal) == Outcome.FAULT
    arm.close()
