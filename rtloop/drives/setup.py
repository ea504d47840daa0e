"""What a family's file `<family>_setup.py` has for ordinary Python: a drive's numbers, bring-up and release."""

from __future__ import annotations

import importlib
from typing import NamedTuple, Protocol, cast

import numpy as np

from config.drives.drive import Drive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.drives.power import Marks
from rtloop.service.conversation import Dialogue, DialogueFailed, Part
from rtloop.service.port import ServicePort
from shm.words import Unreferenced

SAME_PLACE_RAD = 0.02
"""Two readings of a joint that stands differ by less."""


class Found(NamedTuple):
    """What bring-up has found a drive to be, which is then commanded to stay."""

    reading: float
    """Where it stands, as it tells its position."""
    target: float
    """Where it holds, or would, in the same unit; the joint is commanded to be there."""
    reason: Unreferenced = Unreferenced.REFERENCED
    """Why its count is not known to mean an angle."""
    kept_power: bool = False
    """Whether it proves that it has had power since a bring-up before (`rtloop.drives.power`)."""


ERROR_AT_START = "then start again with `rtarm up … --clear-fault`, which clears it"
"""What a person does about an error that a drive has already when its control process starts."""


class Host(Protocol):
    """The bring-up that a drive's dialogue is part of."""

    arm: ArmConfig
    port: ServicePort
    now_ns: int
    clears_protection: bool
    """Whether a person has asked for it, so that a drive's latched error may be cleared."""
    heals: bool
    """Whether nobody has asked for it (`rtloop.dialogues.healing`), so that no drive may be enabled."""
    marks: Marks
    was_silent: list[bool]
    """Whether each joint's angle was given up because its drive was silent, and is known again if that cost nothing."""
    unasked_before: list[int]
    """Positions that had come unasked from each joint's drive when this began."""

    def tell(self, sentence: str) -> None:
        """Say something to people."""

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Tell the cycle a decision."""


class Setup(Protocol):
    """The functions of such a file."""

    def fill(self, row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
        """Put the numbers of the codec into a row of `memory.axis.JointParams`; the common ones are there."""

    def bring_up(self, host: Host, joint: int) -> Part[Found]:
        """See that the drive answers, is what the arm file says, and holds where it stands; raises DialogueFailed.

        Nothing moves: a drive that is on its way somewhere is stopped, one that is limp is enabled where it stands.
        """

    def disable(self, arm: ArmConfig, joint: int) -> Dialogue:
        """Let the drive go limp, and see that it has; raises DialogueFailed."""


class PowerHost(Protocol):
    """The conversation that asks for a proof of power."""

    arm: ArmConfig
    port: ServicePort
    now_ns: int
    marks: Marks


class PowerProof(Protocol):
    """What such a file has besides where its drives can prove that they had power (`rtloop.drives.power`)."""

    def kept_power(self, host: PowerHost, joint: int) -> Part[bool]:
        """Whether the drive has had power since it was given its mark; changes nothing, raises nothing."""


def require_may_enable(host: Host, joint: int) -> None:
    """Raise DialogueFailed for a drive that holds nothing although its being enabled was not asked for."""
    if host.heals:
        raise DialogueFailed(
            joint,
            f"The drive of {host.arm.joints[joint].name} holds nothing any more, and nobody has asked for its being "
            "enabled: see why, then `rtarm clear-fault`, which enables it where it stands.",
        )


def settle_mark(host: Host, joint: int, proof: bool, mark: str | None) -> bool:
    """Give a drive its mark for the next silence; whether it has proven, by the one of before, that it had power.

    One that was silent and proves nothing gets its mark when the joint is referenced: it speaks for the time since, not
    for that in which the angle was lost.
    """
    if host.was_silent[joint] and not proof:
        host.marks.give_once_referenced(joint, mark)
    else:
        host.marks[joint] = mark
    return proof


class ReferencingHost(PowerHost, Protocol):
    """The referencing that a drive's dialogue is part of."""

    again: str
    """How a person tries once more, in sentences."""

    def tell(self, sentence: str) -> None:
        """Say something to people."""

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Tell the cycle a decision."""

    def keep_lost(self, joint: int, reason: Unreferenced | None) -> None:
        """Remember for later processes why the angle is not known, or (None) that it is; raises DialogueFailed."""

    def run_begins(self, joint: int) -> None:
        """From now on the drive's count means no angle; raises DialogueFailed where that cannot be remembered."""

    def require_place(self, joint: int, stopped: float) -> None:
        """Raise DialogueFailed where the run has not stopped (reading) about where the joint's stop is known to be."""

    def count_as_read(self, joint: int, angle_rad: float) -> None:
        """Take the joint's last reading for an angle, or with NaN for what it says; raises DialogueFailed."""

    def count_from(
        self,
        joint: int,
        zero_rad: float,
        position_rad: float,
        reason: Unreferenced = Unreferenced.REFERENCED,
        *,
        flag_stays: bool = False,
    ) -> None:
        """Tell the cycle what the joint's count means, and that it stands there, where its limits allow that.

        `flag_stays`: the drive's flag for lost power is set, and means nothing any more.
        """


class Homes(Protocol):
    """What such a file has besides where its drives can find a stop by themselves."""

    def home(self, host: ReferencingHost, joint: int) -> Part[float]:
        """Let the drive find its stop, and see that it counts from there; raises DialogueFailed.

        The host is told when the run begins (`run_begins`) and, by the count of before, where it stopped
        (`require_place`).

        Returns:
            The drive's own target, as it counts now.
        """

    def end_homing(self, host: ReferencingHost, joint: int) -> Dialogue:
        """End the run, if there is one, and see that the drive stands; raises DialogueFailed."""


class Places(Protocol):
    """What such a file has besides where a person's word for an angle needs more than the joint's last reading."""

    def place(self, host: ReferencingHost, joint: int, angle_rad: float) -> Dialogue:
        """Take a person's word for where the joint stands, or NaN for what it reads; raises DialogueFailed."""


class Reports(Protocol):
    """What such a file has besides where its drives can send their positions by themselves."""

    def end_reports(self, arm: ArmConfig, joint: int) -> Dialogue:
        """Tell the drive to cease; raises nothing."""


def setup_of(drive: Drive) -> Setup:
    """The file of a drive's family."""
    return cast(Setup, importlib.import_module(f"rtloop.drives.{drive.family}_setup"))


def power_proof_of(drive: Drive) -> PowerProof | None:
    """The file of a drive's family, if its drives can prove that they had power."""
    found = setup_of(drive)
    return cast(PowerProof, found) if hasattr(found, "kept_power") else None


def must_prove_power(drive: Drive) -> bool:
    """Whether an arm goes on by itself only where the drive proves its power: its angle, or its hold, rests on it."""
    return not drive.knows_its_angle or hasattr(setup_of(drive), "ENABLED_BY_A_TARGET")


def homing_of(drive: Drive) -> Homes | None:
    """The file of a drive's family, if its drives can find a stop by themselves."""
    found = setup_of(drive)
    return cast(Homes, found) if hasattr(found, "home") else None


def placing_of(drive: Drive) -> Places | None:
    """The file of a drive's family, if a person's word needs more of its drives than their last reading."""
    found = setup_of(drive)
    return cast(Places, found) if hasattr(found, "place") else None


def reporting_of(drive: Drive) -> Reports | None:
    """The file of a drive's family, if its drives can send their positions by themselves."""
    found = setup_of(drive)
    return cast(Reports, found) if hasattr(found, "end_reports") else None


def homes_by_a_run(drive: Drive) -> bool:
    """Whether its drives find a stop when they are homed."""
    return bool(drive.identifiers) and homing_of(drive) is not None


def joints_on_the_bus(arm: ArmConfig) -> list[int]:
    """The joints whose drives are spoken to."""
    return [number for number, joint in enumerate(arm.joints) if joint.drive.identifiers]
