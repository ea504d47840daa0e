"""The parent's side of our action client: whose report is whose, and goals of which nothing is heard."""

from __future__ import annotations

import asyncio
import io
import json
import os
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from rtarm.client import partner as partner_module
from rtarm.client.partner import Partner, Silent
from rtarm.client.player import Player
from rtarm.console.reporter import Reporter
from rtarm.demo import run as demo
from rtarm.demo.goals import tour

FIGURES = {"count": 3, "rate_hz": 120.0, "interval_ms": None, "age_ms": None}


class Scripted:
    """Stands for the process: whatever is asked, it reports what is next."""

    def __init__(self, *events: dict[str, Any] | None) -> None:
        """An event that is None is silence."""
        self.said: list[dict[str, Any]] = []
        self._events = list(events)

    def say(self, line: str) -> None:
        self.said.append(json.loads(line))

    async def event(self, _: float) -> dict[str, Any]:
        event = self._events.pop(0)
        if event is None:
            raise Silent("nothing")
        return event


def player_of(*events: dict[str, Any] | None) -> tuple[Player, Scripted]:
    """A player whose process reports these."""
    player, process = Player("It"), Scripted(*events)
    player._partner = process  # type: ignore[assignment]
    return player, process


def accepted(number: int) -> dict[str, Any]:
    return {"event": "accepted", "number": number, "sent_ns": number}


def result(number: int) -> dict[str, Any]:
    ended = {"succeeded": True, "code": 0, "sentence": "", "actual_s": 1.0, "feedback": 1}
    return {"event": "result", "number": number, **ended}


def test_what_is_reported_of_a_goal_that_was_given_up_is_no_answer_to_the_next_question() -> None:
    player, process = player_of(
        accepted(1), None, result(1), accepted(2), result(2), accepted(3), {"event": "states", **FIGURES}
    )

    async def ask() -> None:
        assert await player.play({}, patience_s=1.0) == accepted(1)
        with pytest.raises(Silent):
            await player.result(1.0)
        assert await player.play({}, "other", patience_s=1.0) == accepted(2)
        assert await player.result(1.0) == result(2)
        assert await player.states(1, 2) == FIGURES

    asyncio.run(ask())
    assert process.said == [
        {"number": 1, "goal": {}},
        {"number": 2, "goal": {}, "action": "other"},
        {"states": [1, 2]},
    ]


@pytest.mark.parametrize(
    ("heard", "sentence"),
    [
        ((None,), "The server did not answer the goal within 5 s."),
        ((accepted(1), None), "The server gave no result within 10.7 s."),
    ],
)
def test_a_goal_of_which_nothing_is_heard_is_cancelled_and_the_last(
    heard: tuple[dict[str, Any] | None, ...], sentence: str
) -> None:
    player, process = player_of(*heard, {"event": "states", **FIGURES})
    played = demo.Played()
    asyncio.run(demo._play_goals(tour(), player, played, Reporter(Console(file=io.StringIO()))))
    (only,) = played.results
    assert (only["goal"], only["succeeded"], only["error_code"]) == ("small", False, demo.NO_RESULT)
    assert only["error_string"] == sentence
    assert process.said[1] == {} and played.joint_states == FIGURES


LISTENING = """
import sys, time
from pathlib import Path
print("ready", flush=True)
for line in sys.stdin:
    pass
if {deaf}:
    time.sleep(60.0)
Path({left!r}).touch()
"""


@pytest.mark.process
@pytest.mark.parametrize("deaf", [False, True])
def test_a_child_may_take_its_leave_before_it_is_made_to_end(
    deaf: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ROS process that is killed leaves the middleware's files in /dev/shm, where the user has it use them."""
    if deaf:
        monkeypatch.setattr(partner_module, "STOP_S", 0.2)
    left = tmp_path / "left"
    (tmp_path / "listening.py").write_text(LISTENING.format(deaf=deaf, left=str(left)))

    async def live() -> None:
        child = Partner("it")
        await child.start("listening", [], {**os.environ, "PYTHONPATH": str(tmp_path)})
        await child.ready()
        await child.hang_up()
        await child.close()

    asyncio.run(live())
    assert left.exists() is not deaf
