"""What a table of sentences is made of, in whichever language."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Literal, NamedTuple

from shm.words import Mode, Request

Language = Literal["en", "zh"]
"""English, which is what programs read too, or Simplified Chinese."""


class Meaning(NamedTuple):
    """One row of a table."""

    sentence: str
    reason: str
    """Why this exists."""
    remedy: str
    """The ways out, in the order in which to try them."""


class Silence(IntEnum):
    """Whose silence it probably is where more than one drive is silent at once (`sentences.whose_silence`)."""

    SEVERAL_DRIVES = 1
    NOT_BELIEVED = 2
    NOT_ACKNOWLEDGED = 3
    BABBLE = 4
    BUS = 5
    MACHINE = 6
    SIMULATED_ARM = 7
    NOT_TAKEN = 8
    ADAPTER = 9
    SUPPLY_OR_CABLE = 10
    SUPPLY = 11


class Phrases(NamedTuple):
    """What a language says beside its tables; braces stand for figures and names."""

    modes: Mapping[Mode, str]
    unknown_mode: str
    unknown_status: str
    unknown: str
    """Of a number that no table has."""
    no_joint: str
    between: str
    """Between names that are listed."""
    before_last: str
    each_of: str
    so: str
    """Between what has happened to a joint's count and what follows from it."""
    healed: str
    wire_is_back: str
    of_bus: str
    """A sentence about one of several buses."""
    asked: Mapping[Request, str]
    asked_by: str
    speed_asked: str
    unknown_command: str
