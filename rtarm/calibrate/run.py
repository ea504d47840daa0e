"""`rtarm calibrate`: whoever turns the drives, the person, and the arm file, brought together.

ZDT drives are turned by a control process that brings nothing up (`python -m rtloop.offline.calibration`). A drive of
another family is brought up alone and led by the control process of every day. Nothing else opens the bus. Either
process stops what moves when this one interrupts it or ends, however that happens.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate.arm_file import ArmFile, in_words
from rtarm.calibrate.drives import Drive, OfflineDrives
from rtarm.calibrate.guide import Guide
from rtarm.calibrate.led import LedDrive, by_its_motor
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.console.person import Person, Quit, agrees
from rtarm.drives.settings import OfflineProcess, offline_process
from rtarm.led.joint import Led
from rtarm.led.process import BRING_UP, LedProcess, led_alone, require_at_rest, with_unseen
from rtloop.offline import families
from rtloop.offline.calibration.talk import Found
from sentences.told import unreferenced_sentence
from shm.errors import NotRunning, SharedMemoryError
from shm.words import Unreferenced

FIELDS = ("direction", "ratio", "zero_deg", "lower_deg", "upper_deg")
"""What may be written of a joint."""
INTRODUCTION = (
    "One drive moves at a time, by small angles, slowly, and only after your y; the others stay as they are. Keep a "
    "hand on the switch in the power line and everything else out of the arm's reach. Ctrl-C or q stops what moves and "
    "ends this at any time; nothing is written that you have not seen and agreed to."
)


def chosen_joints(arm: ArmConfig, names: Sequence[str]) -> list[int]:
    """Numbers of the joints to be calibrated, all without names, in the arm file's order."""
    known = [joint.name for joint in arm.joints]
    for name in names:
        if name not in known:
            raise Refusal(f"Arm {arm.name} has no joint {name!r}; it has {', '.join(known)}.")
    return [joint for joint, name in enumerate(known) if name in names or not names]


def calibrate(
    argument: str, names: Sequence[str], output: Path | None, overrides: Mapping[str, Any], person: Person
) -> None:
    """Guide a person through the joints and write what they agree to.

    Raises:
        Refusal: it cannot begin, a drive did not do as it was told, or the person ended it; the arm stands then.
    """
    arm = load_arm(argument, overrides=overrides)
    if arm.bus.interface == "mock":
        raise Refusal(f"Arm {arm.name} has mock drives and no bus, so there is nothing to calibrate.")
    joints = chosen_joints(arm, names)
    file = ArmFile(argument, output)
    for joint in joints:
        file.require_own_values(joint, FIELDS)
    require_at_rest(arm, "Joints are calibrated")
    calibration = Calibration(arm, argument, overrides, person, file)
    try:
        with signals_raise():
            calibration.go(joints)
    except (Quit, Interrupted) as ended:
        if unseen := calibration.unseen:
            unseen = with_unseen("", unseen) if calibration.leads else unseen
            raise Refusal(f"{unseen} {calibration.what_was_written()}", ExitCode.LOOP_REFUSED) from None
        raise Refusal(f"Ended ({ended}); the arm stands. {calibration.what_was_written()}") from None
    except (Refusal, SharedMemoryError) as refused:
        if not calibration.leads:
            raise
        code = refused.code if isinstance(refused, Refusal) else ExitCode.REFUSED
        code = ExitCode.LOOP_DIED if isinstance(refused, NotRunning) else code
        unseen = calibration.unseen
        raise Refusal(with_unseen(str(refused), unseen) if unseen else str(refused), code) from None
    if not calibration.written:
        person.tell(calibration.what_was_written())


class Calibration:
    """One calibration of an arm: its joints one after the other, and what was written of them."""

    def __init__(
        self, arm: ArmConfig, argument: str, overrides: Mapping[str, Any], person: Person, file: ArmFile
    ) -> None:
        self._arm, self._argument, self._overrides = arm, argument, overrides
        self._person, self._file = person, file
        self._introduced = False
        self._process: OfflineProcess | LedProcess | None = None
        """The one that turns the drives now, or did so last."""
        self.written: list[str] = []

    def go(self, joints: Sequence[int]) -> None:
        """Go through the joints."""
        for by_dialogues, together in groupby(joints, self._has_dialogues):
            if by_dialogues:
                self._by_dialogues(list(together))
            else:
                for joint in together:
                    self._led(joint)

    @property
    def leads(self) -> bool:
        """Whether the control process of every day has led a joint last."""
        return isinstance(self._process, LedProcess)

    @property
    def unseen(self) -> str:
        """Why a drive was not seen to stand at the end, a sentence; "" where it was."""
        return "" if self._process is None else self._process.refused or ""

    def what_was_written(self) -> str:
        return _written_to(self._file, self.written)

    def _has_dialogues(self, joint: int) -> bool:
        return families.knows("calibration", self._arm.joints[joint].drive)

    def _by_dialogues(self, joints: Sequence[int]) -> None:
        """Joints whose drives are turned by dialogues of their family."""
        with offline_process("rtloop.offline.calibration", self._argument, self._overrides) as process:
            self._process = process
            drives = OfflineDrives(process, self._person)
            problems = [problem for joint in joints for problem in drives.found[joint].problems]
            if problems:
                raise Refusal("\n".join(problems), ExitCode.LOOP_REFUSED)
            self._introduce()
            self._person.tell(_others(self._arm, joints, drives.found))
            for joint in joints:
                self._one_joint(joint, drives.drive(joint, self._arm.joints[joint].drive))

    def _led(self, joint: int) -> None:
        """A joint that is led alone."""
        name, person = self._arm.joints[joint].name, self._person
        self._introduce()
        if not agrees(person, BRING_UP.format(name=name)):
            person.tell(f"{name} is left out.")
            return
        with LedDrive(self._arm, joint, lambda: self._brought_up(joint)) as drive:
            self._one_joint(joint, drive)
        if self.unseen:
            raise Refusal(self.unseen, ExitCode.LOOP_REFUSED)

    @contextmanager
    def _brought_up(self, joint: int) -> Iterator[Led]:
        name = self._arm.joints[joint].name
        with led_alone(self._arm, joint, by_its_motor(self._arm, joint)) as (led, process):
            self._process = process
            if not process.brought_up():
                self._process = None  # nothing was led, and why is told
                raise Refusal("\n".join(process.told), ExitCode.LOOP_REFUSED)
            for sentence in process.told:
                if sentence != unreferenced_sentence(Unreferenced.INCREMENTAL, name):  # which is so on purpose
                    self._person.tell(sentence)
            yield led

    def _introduce(self) -> None:
        if not self._introduced:
            self._person.tell(INTRODUCTION)
        self._introduced = True

    def _one_joint(self, joint: int, drive: Drive) -> None:
        person, file, name = self._person, self._file, self._arm.joints[joint].name
        guide = Guide(self._arm, joint, drive, person, lambda changes: file.require_valid(joint, changes))
        guide.go()
        changes = guide.changes
        if not changes:
            person.tell(f"{name}: nothing to write.")
            return
        person.tell(file.difference(joint, changes))
        if agrees(person, f"Write this to {file.path}?"):
            file.write(joint, changes)
            self.written.append(f"{name} ({in_words(changes)})")
            person.tell(_written_to(file, self.written[-1:]))
        else:
            person.tell(f"{name}: nothing was written.")


def _others(arm: ArmConfig, joints: Sequence[int], found: Mapping[int, Found]) -> str:
    """What the joints do that are not being calibrated, and how those are that will be."""
    held = [drive.joint for drive in found.values() if drive.enabled]
    limp = [drive.joint for drive in found.values() if not drive.enabled and not drive.problems]
    silent = [drive.joint for joint, drive in found.items() if drive.problems and joint not in joints]
    parts = [f"{word}: {', '.join(names)}" for word, names in (("held", held), ("limp", limp)) if names]
    if silent:
        parts.append(f"not understood: {', '.join(silent)}")
    return f"{arm.name}: {'; '.join(parts)}."


def _written_to(file: ArmFile, written: Sequence[str]) -> str:
    if not written:
        return "Nothing was written."
    return f"Written to {file.path}: {'; '.join(written)}."
