"""What the file `<family>_setup.py` of a drive family offers to ordinary Python: parameters, bring-up and disabling.

`Setup` is what each of these files has; the other protocols are optional.
"""

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
"""Two readings of a joint at rest differ by less than this."""


class Found(NamedTuple):
    """What bring-up has found out about a drive, which is then commanded to stay where it is."""

    reading: float
    """Measured position, in the unit in which the drive reports it."""
    target: float
    """Position that the drive holds, or would hold, in the same unit; it becomes the joint's commanded position."""
    reason: Unreferenced = Unreferenced.REFERENCED
    """Why the drive's count is not known to mean an angle."""
    kept_power: bool = False
    """Whether the drive proves that it has had power since an earlier bring-up (`rtloop.drives.power`)."""


ERROR_AT_START = "then start again with `rtarm up … --clear-fault`, which clears it"
"""Remedy for an error that a drive already has when its control process starts."""
CLEAR_OR_START = "then `rtarm clear-fault`, or `rtarm up` where it has ended"
"""The way back after a bring-up that has failed: of a control process that runs, or of one that it has ended."""


class Host(Protocol):
    """The bring-up of an arm, as the dialogue with one drive sees it."""

    arm: ArmConfig
    port: ServicePort
    now_ns: int
    clears_protection: bool
    """Whether a person has asked that errors be cleared (or drives enabled): a drive's latched error may be."""
    heals: bool
    """Whether this bring-up began without a request (`rtloop.dialogues.healing`), so that no drive may be enabled."""
    marks: Marks
    was_silent: list[bool]
    """For each joint: its reference was lost because its drive was silent, and is valid again if that cost nothing."""
    unasked_before: list[int]
    """For each joint: how many unrequested positions its drive had sent when this bring-up began."""

    def tell(self, sentence: str) -> None:
        """Show a sentence to the operator."""

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Send an order (`rtloop.service.port`) to the cycle."""


class Setup(Protocol):
    """The functions that every `<family>_setup.py` has."""

    def fill(self, row: np.void, joint: JointConfig, arm: ArmConfig) -> None:
        """Write the family's parameters into a row of `memory.axis.JointParams`; the common ones are there already.

        `arm` is the part of the arm (`ArmConfig.parts`) that is on the bus of the joint's drive.
        """

    def bring_up(self, host: Host, joint: int) -> Part[Found]:
        """Check that the drive answers, matches the arm file and holds its position; raises DialogueFailed.

        Nothing moves: a moving drive is stopped, a disabled one is enabled where it stands.
        """

    def disable(self, arm: ArmConfig, joint: int) -> Dialogue:
        """Switch the drive's torque off, and check that it is off; raises DialogueFailed."""


class PowerHost(Protocol):
    """The conversation that asks a drive to prove that it kept its power."""

    arm: ArmConfig
    port: ServicePort
    now_ns: int
    marks: Marks


class PowerProof(Protocol):
    """Optional function of a family whose drives can prove that they kept their power (`rtloop.drives.power`)."""

    def kept_power(self, host: PowerHost, joint: int) -> Part[bool]:
        """Whether the drive has had power since it got its mark; changes nothing, raises nothing."""


def require_may_enable(host: Host, joint: int) -> None:
    """Raise DialogueFailed if this bring-up, which has to enable a drive, began without a request (`Host.heals`)."""
    if host.heals:
        raise DialogueFailed(
            joint,
            f"The drive of {host.arm.joints[joint].name} holds nothing any more, and nobody has asked for its being "
            "enabled: see why, then `rtarm clear-fault`, which enables it where it stands.",
        )


def settle_mark(host: Host, joint: int, proof: bool, mark: str | None) -> bool:
    """Record a drive's mark for the next silence.

    If the drive was silent and its old mark proves nothing, the new mark is recorded only when the joint is referenced:
    it covers the time since then, not the time in which the angle was lost.

    Returns:
        `proof`: whether the drive has proven by its old mark that it had power.
    """
    if host.was_silent[joint] and not proof:
        host.marks.give_once_referenced(joint, mark)
    else:
        host.marks[joint] = mark
    return proof


class ReferencingHost(PowerHost, Protocol):
    """The referencing of an arm, as the dialogue with one drive sees it."""

    again: str
    """How the operator tries again; part of sentences."""

    def tell(self, sentence: str) -> None:
        """Show a sentence to the operator."""

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Send an order (`rtloop.service.port`) to the cycle."""

    def keep_lost(self, joint: int, reason: Unreferenced | None) -> None:
        """Store for later processes why the angle is not known, or (None) that it is; raises DialogueFailed."""

    def run_begins(self, joint: int) -> None:
        """Declare that the drive's count means no angle from now on; raises DialogueFailed if that cannot be stored."""

    def require_place(self, joint: int, stopped: float) -> None:
        """Raise DialogueFailed if the run stopped (`stopped`, a reading) away from the joint's stop as it is known."""

    def count_as_read(self, joint: int, angle_rad: float) -> None:
        """Take the joint's last reading to mean `angle_rad`, or with NaN what it says; raises DialogueFailed."""

    def count_from(
        self,
        joint: int,
        zero_rad: float,
        position_rad: float,
        reason: Unreferenced = Unreferenced.REFERENCED,
        *,
        flag_stays: bool = False,
    ) -> None:
        """Tell the cycle the joint's zero and position, which is a valid reference only within the joint's limits.

        `flag_stays`: the drive's flag for lost power remains set, and means nothing any more.
        """


class Homes(Protocol):
    """Optional functions of a family whose drives have a homing run of their own."""

    def home(self, host: ReferencingHost, joint: int) -> Part[float]:
        """Start the drive's homing run, and check that it counts from its stop afterwards; raises DialogueFailed.

        It calls `run_begins` of the host when the run begins, and `require_place` with the position, in the count from
        before the run, at which the run stopped.

        Returns:
            The drive's own target, in its new count.
        """

    def end_homing(self, host: ReferencingHost, joint: int) -> Dialogue:
        """End the homing run, if there is one, and check that the drive stands; raises DialogueFailed."""


class Places(Protocol):
    """Optional function of a family for which an angle given by a person takes more than the joint's last reading."""

    def place(self, host: ReferencingHost, joint: int, angle_rad: float) -> Dialogue:
        """Reference the joint at an angle that a person gives, or (NaN) at what it reads; raises DialogueFailed."""


class Reports(Protocol):
    """Optional function of a family whose drives can send their positions unrequested."""

    def end_reports(self, arm: ArmConfig, joint: int) -> Dialogue:
        """Tell the drive to stop sending them; raises nothing."""


def setup_of(drive: Drive) -> Setup:
    """The setup file of a drive's family."""
    return cast(Setup, importlib.import_module(f"rtloop.drives.{drive.family}_setup"))


def power_proof_of(drive: Drive) -> PowerProof | None:
    """The setup file of a drive's family if its drives can prove that they kept their power, else None."""
    found = setup_of(drive)
    return cast(PowerProof, found) if hasattr(found, "kept_power") else None


def must_prove_power(drive: Drive) -> bool:
    """Whether an arm may resume by itself only if this drive proves that it kept its power.

    That is so where the drive's angle depends on its power, or where a target would enable it.
    """
    return not drive.knows_its_angle or hasattr(setup_of(drive), "ENABLED_BY_A_TARGET")


def homing_of(drive: Drive) -> Homes | None:
    """The setup file of a drive's family if its drives have a homing run, else None."""
    found = setup_of(drive)
    return cast(Homes, found) if hasattr(found, "home") else None


def placing_of(drive: Drive) -> Places | None:
    """The setup file of a drive's family if it references a joint at a given angle in its own way, else None."""
    found = setup_of(drive)
    return cast(Places, found) if hasattr(found, "place") else None


def reporting_of(drive: Drive) -> Reports | None:
    """The setup file of a drive's family if its drives can send their positions unrequested, else None."""
    found = setup_of(drive)
    return cast(Reports, found) if hasattr(found, "end_reports") else None


def homes_by_a_run(drive: Drive) -> bool:
    """Whether the drive is on the bus and is homed by a run to its stop."""
    return bool(drive.identifiers) and homing_of(drive) is not None


def joints_on_the_bus(arm: ArmConfig) -> list[int]:
    """Numbers of the joints whose drives are on the bus."""
    return [number for number, joint in enumerate(arm.joints) if joint.drive.identifiers]
