"""`rtarm calibrate`: the process that turns the drives, the person, and the arm file, brought together.

A control process of its own turns the drives (`python -m rtloop.offline.calibration`): nothing else opens the bus. It
stops whatever moves when this process interrupts it or ends, however that happens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from config.loader import load_arm
from config.schema import ArmConfig
from rtarm.calibrate.arm_file import ArmFile, in_words
from rtarm.calibrate.guide import Guide
from rtarm.console.errors import ExitCode, Refusal
from rtarm.console.interrupt import Interrupted, signals_raise
from rtarm.console.person import Person, Quit, agrees
from rtarm.drives.settings import OfflineProcess, offline_process
from rtarm.drives.zdt_joints import other_drives, zdt_joints
from rtloop.offline.calibration.session import DriveState, NotDone
from rtloop.offline.calibration.talk import Found

FIELDS = ("direction", "ratio", "zero_deg", "lower_deg", "upper_deg")
"""What may be written of a joint."""
OTHER_FAMILIES = "Only ZDT drives can be turned by a small angle here."
BY_HAND = (
    "With the drives of {drives}: write direction, ratio and zero_deg into the arm file by hand, start the arm, let it "
    "go with `rtarm free`, lead a joint with your hand and see in `rtarm top` whether it counts the right way and as "
    "far as it turns; `rtarm reference` says where it stands."
)
INTRODUCTION = (
    "One drive moves at a time, by small angles, slowly, and only after your y; the others stay as they are. Keep a "
    "hand on the switch in the power line and everything else out of the arm's reach. Ctrl-C or q stops what moves and "
    "ends this at any time; nothing is written that you have not seen and agreed to."
)


class ProcessDrives:
    """The drives, through the process that turns them."""

    def __init__(self, process: OfflineProcess, person: Person) -> None:
        self._process = process
        self._person = person
        drives = process.answer("ready", person.tell)["drives"]
        self.found = {int(joint): Found(**found) for joint, found in drives.items()}

    def look(self, joint: int) -> DriveState:
        return self._order(f"look {joint}")

    def turn(self, joint: int, by_counts: int, rpm: int) -> DriveState:
        return self._order(f"turn {joint} {by_counts} {rpm}")

    def let_go(self, joint: int) -> DriveState:
        return self._order(f"release {joint}")

    def hold(self, joint: int) -> DriveState:
        return self._order(f"hold {joint}")

    def home(self, joint: int) -> DriveState:
        return self._order(f"home {joint}")

    def _order(self, line: str) -> DriveState:
        self._process.order(line)
        state = self._process.answer("state", self._person.tell)
        if "not_done" in state:
            raise NotDone(state["not_done"])
        return DriveState(**state)


def chosen_joints(arm: ArmConfig, names: Sequence[str]) -> list[int]:
    """Numbers of the joints to be calibrated, all that can be without names, in the arm file's order."""
    known = [joint.name for joint in arm.joints]
    for name in names:
        if name not in known:
            raise Refusal(f"Arm {arm.name} has no joint {name!r}; it has {', '.join(known)}.")
    can_be = zdt_joints(arm)
    asked = [joint for joint, name in enumerate(known) if name in names]
    beyond = other_drives(arm, asked if names else [] if can_be else range(len(known)))
    if beyond:
        raise Refusal(f"{OTHER_FAMILIES} {BY_HAND.format(drives=beyond)}")
    return asked if names else can_be


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
    written: list[str] = []
    beside: list[OfflineProcess] = []
    try:
        with signals_raise(), offline_process("rtloop.offline.calibration", argument, overrides) as process:
            beside.append(process)
            drives = ProcessDrives(process, person)
            problems = [problem for joint in joints for problem in drives.found[joint].problems]
            if problems:
                raise Refusal("\n".join(problems), ExitCode.LOOP_REFUSED)
            person.tell(INTRODUCTION)
            person.tell(_others(arm, joints, drives.found))
            beyond = other_drives(arm, range(len(arm.joints)))
            if beyond:
                person.tell(f"{OTHER_FAMILIES} {BY_HAND.format(drives=beyond)}")
            for joint in joints:
                _one_joint(arm, joint, drives, person, file, written)
    except (Quit, Interrupted) as ended:
        if beside and beside[0].refused:
            raise Refusal(f"{beside[0].refused} {_what_was_written(file, written)}", ExitCode.LOOP_REFUSED) from None
        raise Refusal(f"Ended ({ended}); the arm stands. {_what_was_written(file, written)}") from None
    if not written:
        person.tell(_what_was_written(file, written))


def _one_joint(
    arm: ArmConfig, joint: int, drives: ProcessDrives, person: Person, file: ArmFile, written: list[str]
) -> None:
    guide = Guide(arm, joint, drives.found[joint], drives, person, lambda changes: file.require_valid(joint, changes))
    guide.go()
    changes = guide.changes
    if not changes:
        person.tell(f"{arm.joints[joint].name}: nothing to write.")
        return
    person.tell(file.difference(joint, changes))
    if agrees(person, f"Write this to {file.path}?"):
        file.write(joint, changes)
        written.append(f"{arm.joints[joint].name} ({in_words(changes)})")
        person.tell(_what_was_written(file, written[-1:]))
    else:
        person.tell(f"{arm.joints[joint].name}: nothing was written.")


def _others(arm: ArmConfig, joints: Sequence[int], found: Mapping[int, Found]) -> str:
    """What the joints do that are not being calibrated, and how those are that will be."""
    held = [drive.joint for drive in found.values() if drive.enabled]
    limp = [drive.joint for drive in found.values() if not drive.enabled and not drive.problems]
    silent = [drive.joint for joint, drive in found.items() if drive.problems and joint not in joints]
    parts = [f"{word}: {', '.join(names)}" for word, names in (("held", held), ("limp", limp)) if names]
    if silent:
        parts.append(f"not understood: {', '.join(silent)}")
    return f"{arm.name}: {'; '.join(parts)}."


def _what_was_written(file: ArmFile, written: Sequence[str]) -> str:
    if not written:
        return "Nothing was written."
    return f"Written to {file.path}: {'; '.join(written)}."
