"""What the control process decided of a goal, found behind the English sentence in which the ROS process tells it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtarm.console.language import said
from rtarm.running.requests import Connection
from sentences.meaning import Language
from sentences.told import joint_name, latched_sentence, outcome_sentence
from shm.words import Fault, Outcome

_FINAL_ERROR = re.compile(r"; (\S+) is ([\d.]+) rad from its target\.$")
"""What the ROS process puts in place of the full stop where the goal had begun."""


@dataclass(frozen=True)
class Decision:
    """How the control process ended a goal.

    Attributes:
        sentence: of a language.
        joint: by which it decided; None where it was none.
        value, limit: what was, and what is allowed (SI).
    """

    sentence: Callable[[Language], str]
    joint: str | None
    value: float
    limit: float

    def details(self) -> dict[str, Any]:
        """What an error carries of it: without a limit the joint alone, such as one whose angle is not known."""
        if self.joint is None:
            return {}
        return {"joint": self.joint, "value": self.value, "limit": self.limit} if self.limit else {"joint": self.joint}


def decision(connection: Connection, told: str) -> Decision | None:
    """The decision that a sentence tells; None where the control process made none, such as one that has died."""
    begins = _FINAL_ERROR.sub(".", told)
    return next((one for one in _newest(connection) if one.sentence("en") == begins), None)


def end_told(connection: Connection, told: str) -> str:
    """How a goal ended, in the connection's language; what the ROS process refused by itself stays English."""
    decided = decision(connection, told)
    if connection.language == "en" or decided is None:
        return told
    sentence = decided.sentence(connection.language)
    if (added := _FINAL_ERROR.search(told)) is None:
        return sentence
    far = said(connection.language, "; {joint} is {error} rad from its target.", joint=added[1], error=added[2])
    return sentence[:-1] + far


def _newest(connection: Connection) -> Iterator[Decision]:
    """The latched fault, which ends a goal in its own words, and the newest results."""
    now = connection.snapshot()
    joints = connection.joints
    if now["fault"] != Fault.NONE:
        yield Decision(
            lambda language: latched_sentence(now, joints, language, connection.buses),
            _joint(connection, now["fault_joint"]),
            now["fault_value"],
            now["fault_limit"],
        )
    for row in now["results"]:
        if int(row["outcome"]) != Outcome.NONE:
            yield _of_result(connection, row)


def _of_result(connection: Connection, row: np.void) -> Decision:
    outcome, joint, value, limit = int(row["outcome"]), int(row["joint"]), float(row["value"]), float(row["limit"])

    def sentence(language: Language) -> str:
        return outcome_sentence(outcome, joint_name(joint, connection.joints, language), value, limit, language)

    return Decision(sentence, _joint(connection, joint), value, limit)


def _joint(connection: Connection, joint: int) -> str | None:
    return connection.joints[joint] if 0 <= joint < len(connection.joints) else None
