"""How a goal ended, in the action's terms: status, error code and sentence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from rosfront import refusals
from sentences.told import joint_name, latched_sentence, outcome_sentence
from shm.snapshot import Snapshot
from shm.words import Fault, Outcome


class Status(Enum):
    """The three ends an action goal can have."""

    SUCCEEDED = 1
    CANCELED = 2
    ABORTED = 3


class Names(NamedTuple):
    """What sentences call the parts of an arm: its joints, and its buses where it has several."""

    joints: Sequence[str]
    buses: Sequence[str]


@dataclass(frozen=True)
class Verdict:
    """The end of a goal."""

    status: Status
    code: int
    sentence: str
    outcome: Outcome = Outcome.NONE
    """The end in the control process' terms; NONE where it decided nothing."""


_CODES = {
    Outcome.SUCCEEDED: refusals.SUCCESSFUL,
    Outcome.CANCELED: refusals.SUCCESSFUL,
    Outcome.PATH_TOLERANCE: refusals.PATH_TOLERANCE_VIOLATED,
    Outcome.PATH_VELOCITY: refusals.PATH_TOLERANCE_VIOLATED,
    Outcome.PATH_ACCELERATION: refusals.PATH_TOLERANCE_VIOLATED,
    Outcome.GOAL_TOLERANCE: refusals.GOAL_TOLERANCE_VIOLATED,
    Outcome.GOAL_VELOCITY: refusals.GOAL_TOLERANCE_VIOLATED,
    Outcome.GOAL_ACCELERATION: refusals.GOAL_TOLERANCE_VIOLATED,
}
_STATUS = {Outcome.SUCCEEDED: Status.SUCCEEDED, Outcome.CANCELED: Status.CANCELED}
_TOLD = {Outcome.SUCCEEDED, Outcome.GOAL_TOLERANCE}
"""Outcomes whose sentence says how far the arm is from its target."""
_NOT_BEGUN = {
    Outcome.REFUSED_MODE,
    Outcome.REFUSED_HELD,
    Outcome.REFUSED_OUTDATED,
    Outcome.REFUSED_STREAM,
    Outcome.REFUSED_UNREFERENCED,
    Outcome.REFUSED_START,
    Outcome.REFUSED_LIMITS,
    Outcome.REFUSED_CORRUPT,
}


def aborted(sentence: str, code: int = refusals.INVALID_GOAL) -> Verdict:
    return Verdict(Status.ABORTED, code, sentence)


def refused(reason: refusals.GoalRefused) -> Verdict:
    """The end of a goal that was never begun."""
    return aborted(reason.sentence, reason.code)


def with_final_error(verdict: Verdict, distance: str) -> Verdict:
    """The same verdict, its sentence ending in how far the arm is from the goal's target."""
    return replace(verdict, sentence=f"{verdict.sentence.removesuffix('.')}; {distance}.")


def final_error(snapshot: Snapshot, target_rad: np.ndarray, joint_mask: int, joints: Sequence[str]) -> str:
    """The largest distance between measured and target position among the goal's joints, in words."""
    mask = np.array([bool(joint_mask >> joint & 1) for joint in range(len(joints))])
    measured = snapshot["joints"]["measured_position_rad"][: len(joints)]
    errors = np.where(mask, np.abs(measured - target_rad), -1.0)
    worst = int(errors.argmax())
    return f"{joints[worst]} is {errors[worst]:.4f} rad from its target"


def fault_of(snapshot: Snapshot, names: Names) -> str:
    """The sentence of the latched fault."""
    return latched_sentence(snapshot, names.joints, buses=names.buses)


def judge(
    outcome: int,
    joint: int,
    value: float,
    limit: float,
    snapshot: Snapshot,
    target_rad: np.ndarray,
    joint_mask: int,
    names: Names,
) -> Verdict:
    """The verdict on a goal from its result (`outcome`, `joint`, `value`, `limit`) in the snapshot."""
    if outcome == Outcome.FAULT and snapshot["fault"] != Fault.NONE:
        sentence = fault_of(snapshot, names)
    else:
        sentence = outcome_sentence(outcome, joint_name(joint, names.joints), value, limit)
    known = Outcome(outcome) if outcome in set(Outcome) else Outcome.NONE
    status, code = _STATUS.get(known, Status.ABORTED), _CODES.get(known, refusals.INVALID_GOAL)
    verdict = Verdict(status, code, sentence, known)
    if known in _TOLD or known in _NOT_BEGUN:
        return verdict
    return with_final_error(verdict, final_error(snapshot, target_rad, joint_mask, names.joints))
