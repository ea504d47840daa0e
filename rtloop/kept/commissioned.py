"""What bench tests (`rtarm commission`) have found of an arm's drives: kept, and refused where it is not what was kept.

One small file an arm, `rtarm/commissioned/<arm>.json` under $XDG_STATE_HOME (~/.local/state): a record for each channel
and joint. What it says of a drive holds for that drive alone: same joint, same channel, same family and number. One
that was exchanged, or given other firmware, must be tested again. Simulated arms at a pseudo-terminal are not kept.
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
    """Its flag for lost power is 1 after a loss of power, and stays 0 otherwise once it was cleared."""
    CANARY = "canary"
    """What it was told, or counts, is another one after a loss of power."""
    ABSOLUTE = "absolute"
    """None is needed: its encoder knows the joint's angle with or without power."""
    NONE = "none"


def _known_proof(word: object) -> object:
    """A word of another version's proves nothing to this one."""
    return word if not isinstance(word, str) or word in set(PowerProof) else PowerProof.NONE


class NotReadable(Exception):
    """The file is there and is none that was kept here; the text is the sentence people read."""


@dataclass(frozen=True)
class Commissioned:
    """One drive; None for what was not tried."""

    channel: str
    family: str
    number: int
    firmware: str
    """As the drive tells it, such as 2.0.0; empty where it tells none."""
    when: str
    """UTC, such as 2026-01-31T12:00:00Z."""
    power_proof: Annotated[PowerProof | None, BeforeValidator(_known_proof)] = None
    power: str = ""
    """What was found of that, such as "flag seen 1 after the power cycle, cleared, read 0"."""
    fast_targets: bool | None = None
    """Whether targets of `FC` are absolute to it."""
    reports: bool | None = None
    """Whether it sends its position by itself when told, at the rate it was told."""
    retargets: bool | None = None
    """Whether a new target in motion is taken, and the motion goes on."""
    brakes_in_silence: bool | None = None
    """Whether it brakes with the ramp it was told, and stands, though it hears nothing more."""

    @property
    def heals(self) -> bool:
        """Whether the arm may go on by itself after a silence of all drives.

        It brakes in one, proves its power, and was not found to refuse a new target in motion.
        """
        proves = self.power_proof not in (None, PowerProof.NONE)
        return proves and self.brakes_in_silence is True and self.retargets is not False

    @property
    def tells(self) -> bool:
        """Whether anything that is relied on was tried."""
        return any(getattr(self, name) is not None for name in ("power_proof", *_TRUTHS))

    def after(self, before: Commissioned | None) -> Commissioned:
        """This with what an earlier test of the same drive and firmware has found and this one did not try.

        One that was found to prove nothing does so, whatever its firmware, until that is tried again.
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
"""The file: channel → name of a joint → what was found there; another version of rtarm may say more of it, or less."""


def load(arm: ArmConfig) -> dict[int, Commissioned]:
    """Joint number → what was found of the drive that the arm file gives it; empty where nothing was tried.

    Raises:
        NotReadable: the file cannot be read, or says something else.
    """
    known = _read(arm).get(channel_of(arm), {})
    numbers = {joint.name: number for number, joint in enumerate(arm.joints)}
    return {
        numbers[name]: found
        for name, found in known.items()
        if name in numbers and _is_of(found, arm.joints[numbers[name]].drive)
    }


def unproven(arm: ArmConfig, tell: Callable[[str], object]) -> set[int]:
    """Joints whose drive was found to prove no power; all of them where `tell` gets why that cannot be read."""
    try:
        return {joint for joint, found in load(arm).items() if found.power_proof is PowerProof.NONE}
    except NotReadable as damaged:
        tell(str(damaged))
        return set(range(len(arm.joints)))


def marks(arm: ArmConfig, tell: Callable[[str], object]) -> Marks:
    """What the arm's drives have that proves their power, kept for the next process; `tell` gets what is not kept."""

    def keep(changed: Mapping[int, str]) -> None:
        try:
            keep_power_marks(arm, changed)
        except NotSaved as problem:
            tell(str(problem))

    return Marks(power_marks(arm), keep, unproven(arm, tell))


def withheld(arm: ArmConfig) -> str:
    """Why the arm must not start: its file relies on what a drive was found not to do; empty where it does not."""
    try:
        known = load(arm)
    except NotReadable:  # which `unproven` tells
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
    """Whether each drive of the arm was found to do what going on after a stall relies on (`dialogues.healing`)."""
    try:
        found = load(arm)
    except NotReadable:  # which `unproven` tells
        return False
    return all(joint in found and found[joint].heals for joint in joints_on_the_bus(arm))


def save(arm: ArmConfig, joint: int, found: Commissioned) -> None:
    """Keep what was found of one drive, in the place of what was known of it and beside what is of the others.

    Raises:
        NotReadable: what is there is none that was kept here, and stays.
        NotSaved: it cannot be written.
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
    """Channel → name of a joint → what was found there; raises NotReadable."""
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
