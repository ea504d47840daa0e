"""What happened, as sentences: the newest records of the event ring."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from rtarm.console.chinese import REQUESTS
from rtarm.console.language import named, said
from rtarm.running.status import key
from sentences.meaning import Language
from sentences.told import (
    PHRASES,
    answer_sentence,
    command_sentence,
    fault_told,
    joint_name,
    mode_name,
    of_bus,
    outcome_sentence,
    unreferenced_sentence,
    unreferenced_sentences,
)
from shm.words import Event, Outcome, Request

GOOD, BAD, ODD, PLAIN = "green", "red", "yellow", ""
"""How a happening is coloured."""


class Happening(NamedTuple):
    """Something that happened, when (CLOCK_MONOTONIC), and the style in which it is shown."""

    monotonic_ns: int
    sentence: str
    style: str = PLAIN


def happening(event: np.void, joints: Sequence[str], language: Language = "en", buses: Sequence[str] = ()) -> Happening:
    """An event in words; whatever stands in it, there are some. `buses`: their names, where the arm has several."""
    kind, code = int(event["kind"]), int(event["code"])
    value, limit = float(event["value"]), float(event["limit"])
    if kind == Event.FAULT:
        silent, evidence = int(event["silent"]), int(event["evidence"])
        joint = int(event["joint"])
        sentence, style = fault_told(code, joint, value, limit, silent, evidence, joints, language, buses), BAD
    elif kind == Event.WIRE:
        bus = buses[code] if 0 <= code < len(buses) else ""
        sentence, style = of_bus(PHRASES[language].wire_is_back, bus, language), GOOD
    else:
        about = joint_name(int(event["joint"]), joints, language)
        sentence, style = _told(kind, code, about, value, limit, language)
    return Happening(int(event["monotonic_ns"]), sentence, style)


def happenings(
    events: Iterable[np.void], joints: Sequence[str], language: Language = "en", buses: Sequence[str] = ()
) -> list[tuple[Happening, np.void]]:
    """Events in words, each with its record, in their order; what befell several joints at one instant is said once.

    That is a lost reference, with the same reason: it stands where the first of them does.
    """
    found: list[tuple[Happening, np.void]] = []
    lost: dict[tuple[int, int], tuple[int, list[str]]] = {}
    for event in events:
        if int(event["kind"]) == Event.REFERENCE:
            together = int(event["monotonic_ns"]), int(event["code"])
            if together in lost:
                at, names = lost[together]
                names.append(joint_name(int(event["joint"]), joints, language))
                (sentence,) = unreferenced_sentences(dict.fromkeys(names, together[1]), language)
                found[at] = found[at][0]._replace(sentence=sentence), found[at][1]
                continue
            lost[together] = len(found), [joint_name(int(event["joint"]), joints, language)]
        found.append((happening(event, joints, language, buses), event))
    return found


def _request(number: float, kind: float, answer: str, language: Language) -> str:
    """What was asked for, which events of before do not say, and the answer."""
    if kind not in set(Request):
        return said(language, "Request {number:.0f}: {answer}", number=number, answer=answer)
    what = named(language, REQUESTS, key(Request, int(kind)))
    return said(language, "Request {number:.0f} ({what}): {answer}", number=number, what=what, answer=answer)


def _told(kind: int, code: int, joint: str, value: float, limit: float, language: Language) -> tuple[str, str]:
    if kind == Event.MODE:
        return said(language, "Mode: {mode}.", mode=mode_name(code, language)), PLAIN
    if kind == Event.GOAL:
        return said(language, "Goal {id} was announced.", id=code), PLAIN
    if kind == Event.RESULT:
        return outcome_sentence(code, joint, value, limit, language), GOOD if code == Outcome.SUCCEEDED else ODD
    if kind == Event.REQUEST:
        return _request(value, limit, answer_sentence(code, language), language), PLAIN
    if kind == Event.COMMAND:
        return command_sentence(code, value, language), PLAIN
    if kind == Event.OVERRUN:
        return outcome_sentence(Outcome.CLOCK_GAP, joint, value, limit, language), BAD
    if kind == Event.REFERENCE:
        return unreferenced_sentence(code, joint, language), BAD
    if kind == Event.HEALED:
        return PHRASES[language].healed, GOOD
    return said(language, "Unknown event {kind}: start all processes from one installation.", kind=kind), ODD
