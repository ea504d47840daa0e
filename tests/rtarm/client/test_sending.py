"""Goals from a process that speaks no ROS, through the ordinary action of a real arm."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stack import Stack

from config.loader import load_arm
from rtarm.client.sender import Outcome, Sender, goal_document, sending
from rtarm.console.errors import Refusal
from rtarm.running.status import read_status

JOINTS = [f"joint{number}" for number in range(1, 7)]
PATIENCE_S = 30.0


def move(joint: str, degrees: float, duration_s: float, start_deg: float = 0.0) -> dict[str, Any]:
    return goal_document([joint], np.array([0.0, duration_s]), np.radians([[start_deg], [degrees]]))


@pytest.fixture(scope="module")
def stack(new_arm_name: Callable[[], str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """An arm whose drives do as they are told: no stall of the machine leaves a fault to the next test."""
    with closing(Stack(new_arm_name(), tmp_path_factory.mktemp("sending"), "mock")) as stack:
        stack.start_loop()
        stack.start_front()
        yield stack


def arm_of(stack: Stack) -> Any:
    return load_arm(str(stack.arm_file))


def until_executing(stack: Stack, sender: Sender, number: int) -> None:
    while read_status(stack.name)["mode"] != "executing":
        assert sender.ended(number) is None


def end_of(sender: Sender, number: int) -> Outcome:
    ended = sender.ended(number, PATIENCE_S)
    assert ended is not None
    return ended


@pytest.mark.process
def test_a_goal_moves_the_arm_and_says_how_it_ended(stack: Stack) -> None:
    with sending(arm_of(stack)) as sender:
        outcome = end_of(sender, sender.send(move("joint6", 5.0, 1.0)))
        assert outcome.succeeded and outcome.code == 0 and "Goal reached" in outcome.sentence
        back = end_of(sender, sender.send(move("joint6", 0.0, 1.0, 5.0)))
        assert back.succeeded


@pytest.mark.process
@pytest.mark.parametrize(
    ("document", "said"),
    [
        (move("joint6", 5.0, 0.01), "joint6"),
        (move("elbow", 5.0, 1.0), "elbow"),
        ({"trajectory": {"joint_names": "joint6"}}, "joint_names"),
        ({"path": 1}, "'path'"),
    ],
    ids=["too fast", "unknown joint", "no list", "no such field"],
)
def test_a_goal_that_is_refused_says_why_and_the_next_one_goes(
    stack: Stack, document: dict[str, Any], said: str
) -> None:
    with sending(arm_of(stack)) as sender:
        outcome = end_of(sender, sender.send(document))
        assert not outcome.succeeded and outcome.code != 0 and said in outcome.sentence
        assert end_of(sender, sender.send(move("joint6", 0.0, 0.5))).succeeded


@pytest.mark.process
def test_a_goal_that_is_cancelled_ends_on_its_path(stack: Stack) -> None:
    with sending(arm_of(stack)) as sender:
        number = sender.send(move("joint6", 0.0, 20.0))
        until_executing(stack, sender, number)
        sender.cancel()
        assert not end_of(sender, number).succeeded
        hasty = sender.send(move("joint6", 0.0, 20.0))
        sender.cancel()  # before its answer can have come
        assert not end_of(sender, hasty).succeeded


@pytest.mark.process
def test_what_still_runs_is_cancelled_when_nobody_waits_any_more(stack: Stack) -> None:
    with sending(arm_of(stack)) as sender:
        until_executing(stack, sender, sender.send(move("joint6", 0.0, 20.0)))
    status = read_status(stack.name)
    assert (status["mode"], status["last_result"]["outcome"]) == ("holding", "canceled")


@pytest.mark.process
def test_a_sender_that_is_killed_is_told_and_its_arm_is_not_hurt(stack: Stack) -> None:
    with sending(arm_of(stack)) as sender:
        number = sender.send(move("joint6", 0.0, 3.0))
        until_executing(stack, sender, number)
        os.kill(sender.pid, signal.SIGKILL)
        with pytest.raises(Refusal, match="process that sends goals has ended"):
            end_of(sender, number)
        with pytest.raises(Refusal, match="has ended"):
            sender.send(move("joint6", 0.0, 1.0))
        sender.cancel()
    with sending(arm_of(stack)) as sender:
        assert end_of(sender, sender.send(move("joint6", 0.0, 0.5))).succeeded


@pytest.mark.process
def test_an_arm_that_nobody_serves_is_one_sentence(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtarm.client.sender.action_name", lambda *_: "/nobody/follow_joint_trajectory")
    said = r"^No ROS process serves /nobody/.* in ROS domain \d+: .*rtarm status"
    with pytest.raises(Refusal, match=said), sending(arm_of(stack)):
        pass


@given(
    times=st.lists(st.floats(0, 1e6), min_size=1, max_size=20).map(sorted),
    scale=st.floats(-10, 10),
)
def test_a_document_holds_each_time_to_the_nanosecond(times: list[float], scale: float) -> None:
    positions = np.outer(np.arange(len(times)), np.ones(6)) * scale
    document = goal_document(JOINTS, np.array(times), positions, positions, None)
    points = document["trajectory"]["points"]
    assert document["trajectory"]["joint_names"] == JOINTS
    for time_s, row, point in zip(times, positions, points, strict=True):
        stamp = point["time_from_start"]
        assert 0 <= stamp["nanosec"] < 1_000_000_000
        assert math.isclose(stamp["sec"] + stamp["nanosec"] * 1e-9, time_s, rel_tol=1e-12, abs_tol=1e-9)
        assert point["positions"] == point["velocities"] == row.tolist()
        assert "accelerations" not in point
