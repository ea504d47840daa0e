"""What happened, as sentences: the newest records of the event ring."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from shm.sentences import (
    WIRE_IS_BACK,
    answer_sentence,
    command_sentence,
    fault_sentence,
    joint_name,
    mode_name,
    outcome_sentence,
    unreferenced_sentence,
)
from shm.words import Event, Outcome

GOOD, BAD, ODD, PLAIN = "green", "red", "yellow", ""
"""How a happening is coloured."""


class Happening(NamedTuple):
    """Something that happened, when (CLOCK_MONOTONIC), and the style in which it is shown."""

    monotonic_ns: int
    sentence: str
    style: str = PLAIN


def happening(event: np.void, joints: Sequence[str]) -> Happening:
    """An event in words; whatever stands in it, there are some."""
    kind, code = int(event["kind"]), int(event["code"])
    value, limit = float(event["value"]), float(event["limit"])
    joint = joint_name(int(event["joint"]), joints)
    sentence, style = _told(kind, code, joint, value, limit)
    return Happening(int(event["monotonic_ns"]), sentence, style)


def _told(kind: int, code: int, joint: str, value: float, limit: float) -> tuple[str, str]:
    if kind == Event.MODE:
        return f"Mode: {mode_name(code)}.", PLAIN
    if kind == Event.FAULT:
        return fault_sentence(code, joint, value, limit), BAD
    if kind == Event.GOAL:
        return f"Goal {code} was announced.", PLAIN
    if kind == Event.RESULT:
        return outcome_sentence(code, joint, value, limit), GOOD if code == Outcome.SUCCEEDED else ODD
    if kind == Event.REQUEST:
        return f"Request {value:.0f}: {answer_sentence(code)}", PLAIN
    if kind == Event.COMMAND:
        return command_sentence(code, value), PLAIN
    if kind == Event.OVERRUN:
        return outcome_sentence(Outcome.CLOCK_GAP, joint, value, limit), BAD
    if kind == Event.REFERENCE:
        return unreferenced_sentence(code, joint), BAD
    if kind == Event.WIRE:
        return WIRE_IS_BACK, GOOD
    return f"Unknown event {kind}: start all processes from one installation.", ODD
