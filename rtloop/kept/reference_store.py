"""What is known of the drives' counts beyond the life of a control process.

Three small files an arm, in `rtarm/positions` under $XDG_STATE_HOME (~/.local/state). `<arm>.json`: where the drives
counted when rtarm was last ended in order, to notice what happened to the arm since. It is there until a start has
compared all of them: after a crash nothing is compared, since nothing is known. `<arm>.unreferenced`: which joints have
lost their reference and why, until they are given one. `<arm>.power`: by what their drives prove that they have kept
their power (`rtloop.drives.power`). Simulated arms at a pseudo-terminal begin wherever they are told
to, so nothing is kept of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from config.schema import ArmConfig
from shm.words import Unreferenced

PSEUDO_TERMINALS = "/dev/pts/"
ANY_COUNT = 1 << 53
"""Drives count in 32 bits; anything beyond this is no number that a float holds."""
OUTLIVES_THE_PROCESS = frozenset(
    {
        Unreferenced.POWER_LOST,
        Unreferenced.POSITION_JUMP,
        Unreferenced.SILENT,
        Unreferenced.NOT_HOMED,
        Unreferenced.MOVED,
    }
)
"""What a bring-up of the next process need not find out by itself: what no clearing of a fault forgives either."""
COUNTS_FROM_NOWHERE = frozenset({Unreferenced.POWER_LOST, Unreferenced.NOT_HOMED})
"""No look at the joint says that it stands where it reads; until it is homed no weaker reason takes their place."""


class NotSaved(Exception):
    """What should be kept could not be written; the text is the sentence people read."""


def path_of(arm: str, kind: str = "positions") -> Path:
    """The file with the counts of an arm, or with what else is kept of it.

    Raises:
        NotSaved: for a user without a home.
    """
    base = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "state") / "rtarm" / kind / f"{arm}.json"
    except RuntimeError:
        raise NotSaved(
            "This user has no home, so where the arm stands and what is not known of it cannot be kept for the next "
            "start: set XDG_STATE_HOME to a folder that stays."
        ) from None


def save(arm: ArmConfig, counts: Mapping[int, int]) -> None:
    """Keep the counts (encoder counts as the drives told them) of the joints given by their numbers.

    Raises:
        NotSaved: with the sentence for people.
    """
    if is_simulated(arm):
        return
    path = path_of(arm.name)
    text = json.dumps(
        {"channel": channel_of(arm), "counts": {arm.joints[joint].name: n for joint, n in counts.items()}}
    )
    try:
        replace_file(path, text)
    except OSError as problem:
        raise NotSaved(
            f"Where the arm stands could not be kept in {path} ({problem.strerror}), so the next start cannot tell "
            "whether it was moved meanwhile: see that the file can be written."
        ) from problem


def counts_before(arm: ArmConfig) -> dict[int, int]:
    """Joint number → count that was kept of this arm at this channel.

    Empty where nothing is known. What cannot be read says nothing, since anybody may have written it.
    """
    if is_simulated(arm):
        return {}
    try:
        path = path_of(arm.name)
    except NotSaved:
        return {}
    try:
        kept = _read(path)
        known = dict(kept["counts"]) if kept["channel"] == channel_of(arm) else {}
    except (OSError, ValueError, TypeError, KeyError):
        return {}
    counts = {joint: known.get(config.name) for joint, config in enumerate(arm.joints)}
    return {joint: count for joint, count in counts.items() if isinstance(count, int) and abs(count) < ANY_COUNT}


def forget_counts(arm: ArmConfig) -> None:
    """The joints were compared with their counts of before, and may move from here on."""
    if not is_simulated(arm):
        with contextlib.suppress(OSError, NotSaved):
            path_of(arm.name).unlink(missing_ok=True)


def lost_references(arm: ArmConfig, tell: Callable[[str], object] = lambda _: None) -> dict[int, Unreferenced]:
    """Joint number → why its angle is not known, as it was last kept.

    A file that is there and cannot be read may say so of every joint, and is taken to; `tell` gets the sentence.
    """
    if is_simulated(arm):
        return {}
    try:
        return _read_lost(arm)
    except NotSaved:
        return {}  # there is no place where anything could have been kept
    except (OSError, ValueError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else "it says something else"
        tell(
            f"Which joints have lost their reference could not be read in {_lost_path(arm)} ({why}), so each counts as "
            "one that was not homed: see that the file can be read and written, then home the joints or say where they "
            "stand with `rtarm reference`."
        )
        return dict.fromkeys(range(len(arm.joints)), Unreferenced.NOT_HOMED)


def keep_lost_reference(arm: ArmConfig, joint: int, reason: Unreferenced | None) -> None:
    """The same of one joint."""
    keep_lost_references(arm, {joint: reason})


def keep_lost_references(arm: ArmConfig, reasons: Mapping[int, Unreferenced | None]) -> None:
    """Remember beyond this process why joints' angles are not known, or (None) that they are; one write for all.

    A count from nowhere stays one whatever else befalls the joint: a process that was told its angle may lose that.

    Raises:
        NotSaved: with the sentence for people.
    """
    if is_simulated(arm):
        return
    path = _lost_path(arm)
    lost = lost_references(arm)
    for joint, reason in reasons.items():
        if reason is None:
            lost.pop(joint, None)
        elif lost.get(joint) not in COUNTS_FROM_NOWHERE or reason in COUNTS_FROM_NOWHERE:
            lost[joint] = reason
    try:
        if lost:
            replace_file(path, json.dumps({arm.joints[n].name: why.name for n, why in sorted(lost.items())}))
        else:
            path.unlink(missing_ok=True)
    except OSError as problem:
        names = ", ".join(arm.joints[joint].name for joint in reasons)
        raise NotSaved(
            f"What is known of the reference of {names} could not be kept in {path} ({problem.strerror}), so the next "
            "start would believe what is not true: see that the file can be written."
        ) from problem


def forgive_silence(arm: ArmConfig, joint: int) -> None:
    """The joint's drive had power while it was silent; what else is known against its angle stays.

    Raises:
        NotSaved: with the sentence for people.
    """
    if lost_references(arm).get(joint) == Unreferenced.SILENT:
        keep_lost_reference(arm, joint, None)


def power_marks(arm: ArmConfig) -> dict[int, str]:
    """Joint number → its drive's mark (`rtloop.drives.power`) at this channel; what cannot be read proves nothing."""
    if is_simulated(arm):
        return {}
    try:
        kept = _read(_power_path(arm))
        marks = dict(kept["marks"]) if kept["channel"] == channel_of(arm) else {}
    except (OSError, ValueError, TypeError, KeyError, NotSaved):
        return {}
    found = {joint: marks.get(config.name) for joint, config in enumerate(arm.joints)}
    return {joint: mark for joint, mark in found.items() if isinstance(mark, str)}


def keep_power_marks(arm: ArmConfig, marks: Mapping[int, str]) -> None:
    """Keep all of them for the next process.

    Raises:
        NotSaved: with the sentence for people.
    """
    if is_simulated(arm):
        return
    path = _power_path(arm)
    named = {arm.joints[joint].name: mark for joint, mark in sorted(marks.items())}
    try:
        replace_file(path, json.dumps({"channel": channel_of(arm), "marks": named}))
    except OSError as problem:
        with contextlib.suppress(OSError):  # what it says of before would speak against a drive that has another one
            path.unlink()
        raise NotSaved(
            f"By what the drives prove that they keep their power could not be kept in {path} ({problem.strerror}), so "
            "a drive that falls silent while rtarm dies must be referenced again: see that the file can be written."
        ) from problem


def _power_path(arm: ArmConfig) -> Path:
    return path_of(arm.name).with_suffix(".power")


def _read(path: Path) -> Any:
    """What a file of ours holds; raises OSError (it cannot be read) and ValueError (it is no JSON)."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError(f"{path} is nested without end") from None


def _read_lost(arm: ArmConfig) -> dict[int, Unreferenced]:
    """Raises NotSaved, OSError (it cannot be read) and ValueError (it says something else)."""
    try:
        kept = _read(_lost_path(arm))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    reasons = [reason.name for reason in OUTLIVES_THE_PROCESS]  # what was read may not even be hashable
    if not isinstance(kept, dict) or not all(reason in reasons for reason in kept.values()):
        raise ValueError(kept)
    numbers = {config.name: joint for joint, config in enumerate(arm.joints)}
    return {numbers[name]: Unreferenced[reason] for name, reason in kept.items() if name in numbers}


def _lost_path(arm: ArmConfig) -> Path:
    return path_of(arm.name).with_suffix(".unreferenced")


def replace_file(path: Path, text: str) -> None:
    """Write a file whole or not at all, so that it is there even when the power goes."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=".")
    try:
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)  # its new name is a matter of the folder's
    finally:
        os.close(folder)


def channel_of(arm: ArmConfig) -> str:
    """How the arm's drives are reached: what is kept of them is of these drives alone."""
    return f"{arm.bus.interface}:{arm.bus.resolved_channel}"


def is_simulated(arm: ArmConfig) -> bool:
    """Whether nothing is kept of the arm: its drives begin wherever they are told to."""
    return arm.bus.interface == "mock" or str(arm.bus.resolved_channel).startswith(PSEUDO_TERMINALS)
