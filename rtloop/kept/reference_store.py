"""What is stored about the drives' counts beyond the life of a control process.

Three small files an arm, in `rtarm/positions` under $XDG_STATE_HOME (~/.local/state):

- `<arm>.json`: the drives' counts when rtarm was last ended in order, to detect what happened to the arm since. The
  file exists until a start has compared all of them. After a crash nothing is compared, since nothing is known.
- `<arm>.unreferenced`: the joints that have lost their reference, and why, until they get a new one.
- `<arm>.power`: the marks by which their drives prove that they have kept their power (`rtloop.drives.power`).

Simulated arms at a pseudo-terminal begin wherever they are told to, so nothing is stored of them.
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
"""Bound of stored counts. Drives count in 32 bits; a float does not hold every integer beyond this bound."""
OUTLIVES_THE_PROCESS = frozenset(
    {
        Unreferenced.POWER_LOST,
        Unreferenced.POSITION_JUMP,
        Unreferenced.SILENT,
        Unreferenced.NOT_HOMED,
        Unreferenced.MOVED,
    }
)
"""Reasons to store: the next process' bring-up might miss them, and clearing a fault does not forgive them either."""
COUNTS_FROM_NOWHERE = frozenset({Unreferenced.POWER_LOST, Unreferenced.NOT_HOMED})
"""Reasons for which inspecting the joint cannot confirm its reading; no weaker one replaces them until the joint is
homed or an operator states its angle."""


class NotSaved(Exception):
    """Something could not be stored; the text is the message for the operator."""


def path_of(arm: str, kind: str = "positions") -> Path:
    """Path of the file with the counts of an arm, or with what else (`kind`) is stored of it.

    Raises:
        NotSaved: XDG_STATE_HOME is not set and the user has no home.
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
    """Store counts (encoder counts as the drives report them), given by joint number.

    Raises:
        NotSaved: it cannot be stored.
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
    """Joint number → stored count, for this arm at this channel.

    Empty if nothing is known. A file that cannot be read counts as nothing known, since anybody may have written it.
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
    """Remove the stored counts: the joints were compared with them, and may move from here on."""
    if not is_simulated(arm):
        with contextlib.suppress(OSError, NotSaved):
            path_of(arm.name).unlink(missing_ok=True)


def lost_references(arm: ArmConfig, tell: Callable[[str], object] = lambda _: None) -> dict[int, Unreferenced]:
    """Joint number → why its angle is not known, as last stored.

    If the file exists but cannot be read, every joint counts as not homed, since the file may name any of them; `tell`
    gets the message.
    """
    if is_simulated(arm):
        return {}
    try:
        return _read_lost(arm)
    except NotSaved:
        return {}  # there is no place where anything could have been stored
    except (OSError, ValueError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else "it says something else"
        tell(
            f"Which joints have lost their reference could not be read in {_lost_path(arm)} ({why}), so each counts as "
            "one that was not homed: see that the file can be read and written, then home the joints or say where they "
            "stand with `rtarm reference`."
        )
        return dict.fromkeys(range(len(arm.joints)), Unreferenced.NOT_HOMED)


def keep_lost_reference(arm: ArmConfig, joint: int, reason: Unreferenced | None) -> None:
    """`keep_lost_references` for one joint."""
    keep_lost_references(arm, {joint: reason})


def keep_lost_references(arm: ArmConfig, reasons: Mapping[int, Unreferenced | None]) -> None:
    """Store for later processes why joints' angles are not known, or (None) that they are; one write for all.

    No weaker reason replaces one of COUNTS_FROM_NOWHERE: a process to which an operator has stated the joint's angle
    may lose that angle again.

    Raises:
        NotSaved: it cannot be stored.
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
    """Remove a stored reason SILENT: the joint's drive had power while it was silent. Any other reason stays.

    Raises:
        NotSaved: it cannot be stored.
    """
    if lost_references(arm).get(joint) == Unreferenced.SILENT:
        keep_lost_reference(arm, joint, None)


def power_marks(arm: ArmConfig) -> dict[int, str]:
    """Joint number → its drive's mark (`rtloop.drives.power`) at this channel; empty if the file cannot be read."""
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
    """Store all marks for the next process.

    Raises:
        NotSaved: it cannot be stored.
    """
    if is_simulated(arm):
        return
    path = _power_path(arm)
    named = {arm.joints[joint].name: mark for joint, mark in sorted(marks.items())}
    try:
        replace_file(path, json.dumps({"channel": channel_of(arm), "marks": named}))
    except OSError as problem:
        with contextlib.suppress(OSError):  # an old mark in it would speak against a drive with a new one
            path.unlink()
        raise NotSaved(
            f"By what the drives prove that they keep their power could not be kept in {path} ({problem.strerror}), so "
            "a drive that falls silent while rtarm dies must be referenced again: see that the file can be written."
        ) from problem


def _power_path(arm: ArmConfig) -> Path:
    return path_of(arm.name).with_suffix(".power")


def _read(path: Path) -> Any:
    """What one of these files holds; raises OSError (it cannot be read) and ValueError (it is no JSON)."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError(f"{path} is nested without end") from None


def _read_lost(arm: ArmConfig) -> dict[int, Unreferenced]:
    """Joint number → stored reason; raises NotSaved, OSError (cannot be read) and ValueError (holds something else)."""
    try:
        kept = _read(_lost_path(arm))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    reasons = [reason.name for reason in OUTLIVES_THE_PROCESS]  # a list: what was read may not even be hashable
    if not isinstance(kept, dict) or not all(reason in reasons for reason in kept.values()):
        raise ValueError(kept)
    numbers = {config.name: joint for joint, config in enumerate(arm.joints)}
    return {numbers[name]: Unreferenced[reason] for name, reason in kept.items() if name in numbers}


def _lost_path(arm: ArmConfig) -> Path:
    return path_of(arm.name).with_suffix(".unreferenced")


def replace_file(path: Path, text: str) -> None:
    """Write a file whole or not at all; once written, it survives a loss of power."""
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
        os.fsync(folder)  # the new name is part of the folder
    finally:
        os.close(folder)


def channel_of(arm: ArmConfig) -> str:
    """Interface and channel of the arm's drives: what is stored of the drives is valid there alone.

    With several buses each names its joints, since a drive of the same number may be on another one.
    """
    places = {f"{part.bus.interface}:{part.bus.resolved_channel}": part.joints for part in arm.parts}
    if len(places) == 1:
        return next(iter(places))
    return ", ".join(f"{place} ({' '.join(joint.name for joint in joints)})" for place, joints in places.items())


def is_simulated(arm: ArmConfig) -> bool:
    """Whether the arm is simulated: its drives begin wherever they are told to, so nothing is stored of them."""
    return all(bus.interface == "mock" or bus.resolved_channel.startswith(PSEUDO_TERMINALS) for bus in arm.buses)
