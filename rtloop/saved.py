"""What is known of the drives' counts beyond the life of a control process.

Where they counted when rtarm was last ended in order, to notice what happened to the arm since: one small file an arm,
`rtarm/positions/<arm>.json` under $XDG_STATE_HOME (~/.local/state). It is there only while rtarm is not running: after
a crash nothing is compared, since nothing is known. And beside it `<arm>.not_homed`, with the joints whose drives count
from nowhere, which is there until they are homed. Simulated arms at a pseudo-terminal begin wherever they are told to,
so nothing is kept of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from config.schema import ArmConfig

PSEUDO_TERMINALS = "/dev/pts/"


class NotSaved(Exception):
    """Positions could not be written; the text is the sentence people read."""


def path_of(arm: str) -> Path | None:
    """The file of an arm; None for a user without a home."""
    base = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "state") / "rtarm" / "positions" / f"{arm}.json"
    except RuntimeError:
        return None


def save(arm: ArmConfig, counts: Mapping[int, int]) -> None:
    """Keep the counts (encoder counts as the drives told them) of the joints given by their numbers.

    Raises:
        NotSaved: with the sentence for people.
    """
    path = path_of(arm.name)
    if path is None or _is_simulated(arm):
        return
    text = json.dumps({"channel": _channel(arm), "counts": {arm.joints[joint].name: n for joint, n in counts.items()}})
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=".", delete=False) as file:
            file.write(text)
        os.replace(file.name, path)
    except OSError as problem:
        raise NotSaved(
            f"Where the arm stands could not be kept in {path} ({problem.strerror}), so the next start cannot tell "
            "whether it was moved meanwhile: see that the file can be written."
        ) from problem


def doubtful(arm: ArmConfig) -> set[int]:
    """Numbers of the joints whose drives counted from nowhere when they were last spoken of, and not homed since."""
    path = _doubts_path(arm)
    if path is None:
        return set()
    try:
        names = set(path.read_text(encoding="utf-8").split())
    except (OSError, ValueError):
        return set()
    return {joint for joint, config in enumerate(arm.joints) if config.name in names}


def keep_doubt(arm: ArmConfig, joint: int, doubt: bool) -> None:
    """Remember beyond this process whether a joint's count means nothing.

    Raises:
        NotSaved: with the sentence for people.
    """
    path = _doubts_path(arm)
    if path is None:
        return
    before = doubtful(arm)
    after = before | {joint} if doubt else before - {joint}
    if after == before:
        return
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not after:
            path.unlink()
            return
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=".", delete=False) as file:
            file.write("\n".join(arm.joints[n].name for n in sorted(after)))
            file.flush()
            os.fsync(file.fileno())  # it must be there when the power goes
        os.replace(file.name, path)
    except OSError as problem:
        raise NotSaved(
            f"That {arm.joints[joint].name} counts from nowhere could not be kept in {path} ({problem.strerror}), so "
            "the next start would believe it: see that the file can be written, then ask again."
        ) from problem


def _doubts_path(arm: ArmConfig) -> Path | None:
    path = path_of(arm.name)
    return None if path is None or _is_simulated(arm) else path.with_suffix(".not_homed")


def take(arm: ArmConfig) -> dict[int, int]:
    """Joint number → count that was kept of this arm at this channel; the file is gone afterwards.

    Empty where nothing is known. What cannot be read says nothing, since anybody may have written it.
    """
    path = path_of(arm.name)
    if path is None or _is_simulated(arm):
        return {}
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        known = dict(kept["counts"]) if kept["channel"] == _channel(arm) else {}
    except (OSError, ValueError, TypeError, KeyError):
        known = {}
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
    counts = {joint: known.get(config.name) for joint, config in enumerate(arm.joints)}
    return {joint: count for joint, count in counts.items() if isinstance(count, int)}


def _channel(arm: ArmConfig) -> str:
    return f"{arm.bus.interface}:{arm.bus.resolved_channel}"


def _is_simulated(arm: ArmConfig) -> bool:
    return arm.bus.interface == "mock" or str(arm.bus.resolved_channel).startswith(PSEUDO_TERMINALS)
