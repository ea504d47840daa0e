"""The slow way to where a motion begins, and which arm is fit to be moved."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hand_readings import limits
from hypothesis import given, settings
from hypothesis import strategies as st
from written_arm import WrittenArm

from rosfront.verdict import Names, judge
from rtarm.client import moves
from rtarm.client.sender import Outcome as Ended
from rtarm.client.sender import Sender
from rtarm.console.errors import ExitCode, GoalFailed, Refusal
from rtarm.running.arm_file import arm_file as file_of
from rtarm.running.requests import connect
from shm.words import Fault, Mode, Outcome

LIMITS = limits()


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=12, max_size=12))
def test_the_move_to_the_beginning_is_slow_and_ends_there(shares: list[float]) -> None:
    room = LIMITS.upper_rad - LIMITS.lower_rad
    start_rad, target_rad = (LIMITS.lower_rad + room * np.array(part) for part in (shares[:6], shares[6:]))
    times_s, positions, velocities, accelerations = moves.slow_move(
        start_rad, target_rad, LIMITS.velocity_rad_s, LIMITS.acceleration_rad_s2
    )
    assert positions[0] == pytest.approx(start_rad) and positions[-1] == pytest.approx(target_rad)
    assert (np.diff(times_s) > 0.0).all()
    assert (np.abs(velocities) <= 0.25 * LIMITS.velocity_rad_s * (1 + 1e-9)).all()
    assert (np.abs(accelerations) <= 0.25 * LIMITS.acceleration_rad_s2 * (1 + 1e-9)).all()


class Answering:
    """What takes goals for the action, and a person who is told of them."""

    def __init__(self, outcome: Ended) -> None:
        self.goals: list[dict[str, Any]] = []
        self.told: list[str] = []
        self._outcome = outcome

    def send(self, goal: dict[str, Any]) -> int:
        self.goals.append(goal)
        return len(self.goals)

    def ended(self, number: int, patience_s: float) -> Ended:
        assert number == len(self.goals)
        return self._outcome

    def tell(self, text: str) -> None:
        self.told.append(text)

    def answer(self, question: str) -> str:
        raise AssertionError(question)


@pytest.fixture
def standing(arm: WrittenArm) -> WrittenArm:
    """An arm with limits, at 0.1 and -0.2 rad."""
    rows = arm.state["limits"]["joints"][:2]
    rows["max_velocity_rad_s"], rows["max_acceleration_rad_s2"] = 1.0, 2.0
    arm.rows["commanded_position_rad"] = 0.1, -0.2
    arm.publish()
    return arm


@pytest.mark.parametrize(
    ("away_rad", "told"),
    [
        (0.0, []),
        (math.radians(0.4), []),  # the arm's start tolerance may be less than this, so it goes there all the same
        (0.29, ["To where it begins, 1.9 s: elbow -11.5° → 5.2°."]),
    ],
)
def test_the_arm_goes_exactly_to_where_a_motion_begins(standing: WrittenArm, away_rad: float, told: list[str]) -> None:
    there = np.array([0.1, -0.2 + away_rad])
    action = Answering(Ended(True, 0, "Goal reached."))
    with connect(standing.name) as connection:
        moves.go_slowly(connection, cast(Sender, action), there, action)
    assert action.told == told
    assert len(action.goals) == (away_rad > 0.0)
    for goal in action.goals:
        points = goal["trajectory"]["points"]
        assert points[0]["positions"] == [0.1, -0.2] and points[-1]["positions"] == pytest.approx(there)
        assert np.abs([point["velocities"] for point in points]).max() <= 0.25


@pytest.mark.parametrize(
    ("outcome", "joint", "limit_rad", "told"),
    [
        (Outcome.PATH_TOLERANCE, 1, 0.1, ("elbow", 0.3, 0.1)),
        (Outcome.REFUSED_UNREFERENCED, 1, 0.0, ("elbow", None, None)),
        (Outcome.REFUSED_LIMITS, -1, 0.0, (None, None, None)),
    ],
)
def test_a_failure_tells_what_the_control_process_decided_by(
    standing: WrittenArm, outcome: Outcome, joint: int, limit_rad: float, told: tuple[str | float | None, ...]
) -> None:
    """Not what it decided about others: another goal of another client, say."""
    standing.snapshot["results"][2] = 3, Outcome.PATH_TOLERANCE, 0, 0.7, 0.2, 5
    standing.snapshot["results"][3] = 4, outcome, joint, 0.3, limit_rad, 6
    standing.publish()
    names = Names(("shoulder", "elbow"), ())
    verdict = judge(outcome, joint, 0.3, limit_rad, standing.snapshot, np.zeros(2), 0b11, names)
    assert (" rad from its target" in verdict.sentence) == (outcome == Outcome.PATH_TOLERANCE)
    action = Answering(Ended(False, -4, verdict.sentence))
    with connect(standing.name) as connection, pytest.raises(GoalFailed) as failed:
        moves.run(connection, cast(Sender, action), {})
    assert (failed.value.joint, failed.value.value, failed.value.limit) == told


def test_a_goal_that_fails_ends_it_with_its_sentence(standing: WrittenArm) -> None:
    action = Answering(Ended(False, -5, "elbow is not there."))
    with connect(standing.name) as connection, pytest.raises(Refusal, match="elbow is not there") as refused:
        moves.go_slowly(connection, cast(Sender, action), np.zeros(2), action)
    assert refused.value.code == ExitCode.GOAL_FAILED


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"mode": Mode.FREE}, "does not stand still and hold at the moment"),
        ({"mode": Mode.EXECUTING, "goal_id": 4}, "does not stand still and hold at the moment"),
        ({"mode": Mode.FAULT, "fault": Fault.WIRE}, "A fault is latched, clear it first"),
    ],
)
def test_only_an_arm_that_holds_is_moved(arm: WrittenArm, words: dict[str, int], said: str) -> None:
    with connect(arm.name) as connection:
        moves.refuse_unless_holding(connection)
        for word, value in words.items():
            arm.snapshot[word] = value
        arm.publish()
        with pytest.raises(Refusal, match=said):
            moves.refuse_unless_holding(connection)


def test_the_file_of_an_arm_is_its_own_or_the_one_that_was_named(arm_name: str, arm_file: Path) -> None:
    assert file_of(str(arm_file), arm_name).name == arm_name
    assert file_of(None, "episode1").name == file_of("episode1", "episode1").name == "episode1"
    with pytest.raises(Refusal, match=rf"give its path, `--arm \./{arm_name}\.yaml`"):
        file_of(None, arm_name)
