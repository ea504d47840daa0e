"""What an arm was told and what became of it: requests and their answers, goals and their results."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from rtarm.running.status import key
from sentences.told import answer_sentence, command_sentence, joint_name, outcome_sentence
from shm.recording import Recording
from shm.words import Answer, Entry, Event, Outcome, Request

MOST_OPEN = 256
"""Goals and requests that may wait for their answer; what is older was forgotten by the arm too."""


class Command(NamedTuple):
    """A message of the commands, and when it was (CLOCK_MONOTONIC)."""

    monotonic_ns: int
    content: dict[str, Any]


class Commands:
    """Brings together what was asked and what was answered, however many of both come at a time."""

    def __init__(self) -> None:
        self._requests: dict[int, str] = {}
        self._openings: dict[int, np.void] = {}

    def add(self, recording: Recording) -> list[Command]:
        """What was asked and answered in a recording, or in the piece of one that follows the last, in its order."""
        for opening in recording.openings:
            self._openings[int(opening["goal_id"])] = opening
        found = [*self._asked(recording), *self._answered(recording)]
        for table in (self._requests, self._openings):
            for old in list(table)[:-MOST_OPEN]:
                del table[old]
        return sorted(found, key=lambda command: command.monotonic_ns)

    def _asked(self, recording: Recording) -> Iterator[Command]:
        for request in recording.requests:
            number, name = int(request["sequence"]), key(Request, int(request["kind"]))
            self._requests[number] = name
            yield _command(
                int(request["monotonic_ns"]),
                "request",
                number,
                name,
                sentence=f"Request {number}: {name.replace('_', ' ')}.",
                joints=_named(int(request["joint_mask"]), recording.joints),
                value=float(request["value"]),
            )

    def _answered(self, recording: Recording) -> Iterator[Command]:
        for event in recording.events:
            at, kind, code = int(event["monotonic_ns"]), int(event["kind"]), int(event["code"])
            value = float(event["value"])
            if kind == Event.REQUEST:
                number = int(value)
                yield _command(
                    at,
                    "answer",
                    number,
                    self._requests.get(number),
                    answer=key(Answer, code),
                    sentence=answer_sentence(code),
                )
            elif kind == Event.COMMAND:
                name = key(Request, code)
                scale = value if code == Request.SPEED_SCALE else math.nan
                yield _command(at, "request", None, name, sentence=command_sentence(code, value), value=scale)
            elif kind == Event.GOAL:
                yield self._goal(at, code, recording)
            elif kind == Event.RESULT:
                joint = joint_name(int(event["joint"]), recording.joints)
                sentence = outcome_sentence(code, joint, value, float(event["limit"]))
                number_known = _goal_of(event, recording)
                yield _command(at, "result", number_known, None, answer=key(Outcome, code), sentence=sentence)

    def _goal(self, at: int, goal_id: int, recording: Recording) -> Command:
        opening = self._openings.get(goal_id)
        sentence = f"Goal {goal_id} was announced."
        if opening is None:
            return _command(at, "goal", goal_id, None, sentence=sentence)
        streams = int(opening["entry"]) & Entry.STREAM
        return _command(
            at,
            "goal",
            goal_id,
            "stream" if streams else "trajectory",
            sentence=sentence,
            joints=_named(int(opening["joint_mask"]), recording.joints),
            value=float(opening["goal_time_s"]),
        )


def _command(
    monotonic_ns: int,
    what: str,
    number: int | None,
    name: str | None,
    *,
    sentence: str,
    joints: list[str] | None = None,
    value: float = math.nan,
    answer: str | None = None,
) -> Command:
    content = {
        "monotonic_ns": monotonic_ns,
        "what": what,
        "number": number,
        "name": name,
        "joints": joints or [],
        "value": value if math.isfinite(value) else None,
        "answer": answer,
        "sentence": sentence,
    }
    return Command(monotonic_ns, content)


def _named(mask: int, joints: tuple[str, ...]) -> list[str]:
    return [name for number, name in enumerate(joints) if mask >> number & 1]


def _goal_of(event: np.void, recording: Recording) -> int | None:
    """Which goal a result belongs to; None where it is not among the newest results any more."""
    results = recording.results
    same = (results["monotonic_ns"] == event["monotonic_ns"]) & (results["outcome"] == event["code"])
    return int(results["goal_id"][same][0]) if np.count_nonzero(same) == 1 else None


def properties() -> dict[str, dict[str, Any]]:
    """The JSON schema of each word of a command."""
    text = {"type": ["string", "null"]}
    return {
        "monotonic_ns": {"type": "integer"},
        "what": {"type": "string", "enum": ["request", "answer", "goal", "result"]},
        "number": {"type": ["integer", "null"], "description": "of the request, or of the goal"},
        "name": {**text, "description": "what was asked for, such as hold; of a goal: trajectory or stream"},
        "joints": {"type": "array", "items": {"type": "string"}, "description": "the joints it names"},
        "value": {
            "type": ["number", "null"],
            "description": "of a request: speed scale, or angle (rad); of a goal: patience at its end (s)",
        },
        "answer": {**text, "description": "how a request was answered, or how a goal ended"},
        "sentence": {"type": "string"},
    }
