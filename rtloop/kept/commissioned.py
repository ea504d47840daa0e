"""The stored results of bench tests (`rtarm commission`) of an arm's drives; a file with anything else is refused.

One small file an arm, `rtarm/commissioned/<arm>.json` under $XDG_STATE_HOME (~/.local/state): a record for each channel
and joint. A record is valid for one drive alone: same joint, same channel, same family and number. Whoever exchanges a
drive, or gives it other firmware, must test it again: nothing here notices that. Nothing is stored of simulated arms at
a pseudo-terminal.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, TypeAdapter

from config.drives.drive import Drive
from config.schema import ArmConfig
from rtloop.drives.power import Marks
from rtloop.drives.setup import joints_on_the_bus
from rtloop.kept.reference_store import (
    NotSaved,
    channel_of,
    is_simulated,
    keep_power_marks,
    path_of,
    power_marks,
    replace_file,
)


class PowerProof(StrEnum):
    """How a drive that was silent proves that it has kept its power."""

    FLAG = "flag"
    """Its lost-power flag is 1 after a loss of power and, once it was cleared, stays 0 otherwise."""
    CANARY = "canary"
    """A value that was written to it, or that it counts, is a different one after a loss of power."""
    ABSOLUTE = "absolute"
    """No proof is needed: its encoder knows the joint's angle with or without power."""
    NONE = "none"


def _known_proof(word: object) -> object:
    """A word that only another version of rtarm knows counts as no proof."""
    return word if not isinstance(word, str) or word in set(PowerProof) else PowerProof.NONE


class NotReadable(Exception):
    """The file exists but cannot be read, or is none of this module's; the text is the message for the operator."""


@dataclass(frozen=True)
class Commissioned:
    """The test results of one drive; None for what was not tested."""

    channel: str
    family: str
    number: int
    firmware: str
    """As the drive reports it, such as 2.0.0; empty if it reports none."""
    when: str
    """UTC, such as 2026-01-31T12:00:00Z."""
    power_proof: Annotated[PowerProof | None, BeforeValidator(_known_proof)] = None
    power: str = ""
    """What the test of the power proof saw, such as "flag seen 1 after the power cycle, cleared, read 0"."""
    fast_targets: bool | None = None
    """Whether the drive takes `FC` targets as absolute."""
    reports: bool | None = None
    """Whether the drive, when commanded to, sends its position unasked and at the commanded rate."""
    retargets: bool | None = None
    """Whether the drive accepts a new target while it moves, and the motion goes on."""
    brakes_in_silence: bool | None = None
    """Whether the drive, when it receives nothing more, brakes with the commanded ramp and then stands."""

    @property
    def heals(self) -> bool:
        """Whether this drive allows automatic recovery after a silence of all drives.

        It brakes in such a silence, proves its power, and was not found to refuse a new target in motion.
        """
        proves = self.power_proof not in (None, PowerProof.NONE)
        return proves and self.brakes_in_silence is True and self.retargets is not False

    @property
    def tells(self) -> bool:
        """Whether anything that rtarm relies on was tested."""
        return any(getattr(self, name) is not None for name in ("power_proof", *_TRUTHS))

    def after(self, before: Commissioned | None) -> Commissioned:
        """These results, completed by those of an earlier test of the same drive and firmware.

        A drive that was found to prove nothing still proves nothing with other firmware, until that is tested again.
        """
        if before is None:
            return self
        if not self.firmware or before.firmware != self.firmware:
            if self.power_proof is None and before.power_proof is PowerProof.NONE:
                return replace(self, power_proof=before.power_proof, power=before.power)
            return self
        values = asdict(self)
        kept = {name: value for name, value in asdict(before).items() if values[name] in (None, "")}
        return Commissioned(**{**values, **kept})


_TRUTHS = ("fast_targets", "reports", "retargets", "brakes_in_silence")
_KEPT = TypeAdapter(dict[str, dict[str, Commissioned]], config=ConfigDict(strict=True))
"""The file: channel → name of a joint → test results, of which another version of rtarm may store more or fewer."""


def load(arm: ArmConfig) -> dict[int, Commissioned]:
    """Joint number → test results of the drive that the arm file gives it; empty if nothing was tested.

    Raises:
        NotReadable: the file cannot be read, or holds something else.
    """
    known = _read(arm).get(channel_of(arm), {})
    numbers = {joint.name: number for number, joint in enumerate(arm.joints)}
    return {
        numbers[name]: found
        for name, found in known.items()
        if name in numbers and _is_of(found, arm.joints[numbers[name]].drive)
    }


def unproven(arm: ArmConfig, tell: Callable[[str], object]) -> set[int]:
    """Joints whose drive was found not to prove its power; all joints if the file cannot be read: `tell` gets why."""
    try:
        return {joint for joint, found in load(arm).items() if found.power_proof is PowerProof.NONE}
    except NotReadable as damaged:
        tell(str(damaged))
        return set(range(len(arm.joints)))


def marks(arm: ArmConfig, tell: Callable[[str], object]) -> Marks:
    """The marks by which the arm's drives prove their power; each change is stored for the next process.

    `tell` gets the message when that fails.
    """

    def keep(changed: Mapping[int, str]) -> None:
        try:
            keep_power_marks(arm, changed)
        except NotSaved as problem:
            tell(str(problem))

    return Marks(power_marks(arm), keep, unproven(arm, tell))


def withheld(arm: ArmConfig) -> str:
    """Why the arm must not start: its arm file relies on something that a drive was found not to do; else empty."""
    try:
        known = load(arm)
    except NotReadable:  # `unproven` reports it
        return ""
    relied_on = (_withheld_by(arm, joint, found) for joint, found in known.items())
    return next((sentence for sentence in relied_on if sentence), "")


def _withheld_by(arm: ArmConfig, joint: int, found: Commissioned) -> str:
    config = arm.joints[joint]
    bench = f"at the bench ({found.when}, firmware {found.firmware or 'not told'})"
    if config.drive.knows_its_angle and found.power_proof is PowerProof.NONE:
        return (
            f"The encoder of {config.name} is absolute in the arm file, but {bench} it was not ({found.power}), so its "
            "angle cannot be believed: mend `encoder` in the arm file, or test it again with `rtarm commission`."
        )
    for asked, does, what, instead in (
        (
            arm.bus.fast_targets,
            found.fast_targets,
            "take targets of FC for absolute ones",
            "bus.position_command to FD",
        ),
        (arm.bus.reported, found.reports, "report its position as it was told", "bus.positions to polled"),
    ):
        if asked and does is False:
            return (
                f"The drive of {config.name} was found {bench} not to {what}, and the arm file asks for that: set "
                f"{instead}, or test the drive again with `rtarm commission`."
            )
    return ""


def heals(arm: ArmConfig) -> bool:
    """Whether each drive of the arm was found to do what recovery after a stall relies on (`dialogues.healing`)."""
    try:
        found = load(arm)
    except NotReadable:  # `unproven` reports it
        return False
    return all(joint in found and found[joint].heals for joint in joints_on_the_bus(arm))


def save(arm: ArmConfig, joint: int, found: Commissioned) -> None:
    """Store the results of one drive in place of its earlier ones; those of other drives stay.

    Raises:
        NotReadable: the file is none of this module's, and stays as it is.
        NotSaved: it cannot be stored.
    """
    if is_simulated(arm):
        return
    known = _read(arm)
    known.setdefault(channel_of(arm), {})[arm.joints[joint].name] = found
    plain = {channel: {name: asdict(one) for name, one in joints.items()} for channel, joints in known.items()}
    path = path_of(arm.name, "commissioned")
    try:
        replace_file(path, json.dumps(plain, indent=1))
    except OSError as problem:
        raise NotSaved(
            f"What was found of {arm.joints[joint].name} could not be kept in {path} ({problem.strerror}), so nothing "
            "is unlocked by it: see that the file can be written, then run this again."
        ) from problem


def _read(arm: ArmConfig) -> dict[str, dict[str, Commissioned]]:
    """Channel → name of a joint → test results; raises NotReadable."""
    if is_simulated(arm):
        return {}
    try:
        path = path_of(arm.name, "commissioned")
    except NotSaved:
        return {}
    try:
        return _KEPT.validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else "it says something else"
        raise NotReadable(
            f"What was found of the drives of {arm.name} at the bench cannot be read in {path} ({why}), so none of it "
            "is believed: remove that file, then run `rtarm commission` for each of them again."
        ) from None


def _is_of(found: Commissioned, drive: Drive) -> bool:
    knows = drive.knows_its_angle or found.power_proof is not PowerProof.ABSOLUTE
    return knows and (found.family, found.number) == (drive.family, drive.number)
