"""Where recordings are kept, what they are called, and how many of them."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

from rtarm.console.errors import Refusal
from rtarm.recording.mcap_writer import ASIDE_PREFIX, ASIDE_SUFFIX

KEPT = 20
"""Newest recordings that are kept of an arm."""
KEPT_IN_ALL = 100
"""And of all arms together: each demo's has a name of its own."""
KEPT_BYTES = 1 << 30
"""And so much at most: one of a large, quick arm has a hundred times the size of a small one's."""
SUFFIX = ".mcap"
OWN_NAME = re.compile(r"[^-]+-\d{8}T\d{6}Z-\w+(-\d+)?" + re.escape(SUFFIX))
"""What `new_path` makes: the name of an arm has no hyphen."""
_NAME = re.compile(r"[a-z0-9_]+")
"""Of an arm."""
LONG = "long"
"""What a recording that went on is named after: somebody asked for it, so it is never removed to make room."""
ABANDONED_S = 600.0
"""A writer adds to its file every few seconds."""


def folder() -> Path:
    """The folder of this user's recordings; it may not be there yet.

    Raises:
        Refusal: the user has no home.
    """
    base = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".local" / "state") / "rtarm" / "recordings"
    except RuntimeError:
        raise Refusal(
            f"The user {os.getuid()} has no home folder, so there is no place for recordings: set HOME or "
            "XDG_STATE_HOME to a folder that may be written to."
        ) from None


def new_path(arm: str, why: str) -> Path:
    """A name of its own for a recording that is written now; `why` is a word such as `following_error`."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    path = folder() / f"{arm}-{stamp}-{why}{SUFFIX}"
    number = 1
    while path.exists():
        number += 1
        path = folder() / f"{arm}-{stamp}-{why}-{number}{SUFFIX}"
    return path


def remove_old(arm: str) -> None:
    """Remove all but the newest recordings of an arm, and of all, and what killed writers have left."""
    mine = [path for _, path in _removable() if path.name.startswith(f"{arm}-")]
    everybodys = [path for _, path in _removable()]
    for path in {*mine[KEPT:], *everybodys[KEPT_IN_ALL:], *_beyond_room(), *_abandoned()}:
        with contextlib.suppress(OSError):
            path.unlink()


def _removable() -> list[tuple[int, Path]]:
    """Bytes and path of each recording that makes room for others, the newest first."""
    return [(size, path) for _, size, path in _found() if f"-{LONG}" not in path.name]


def _beyond_room() -> Iterator[Path]:
    """The recordings that have no room beside newer ones; the newest always has."""
    used = 0
    for size, path in _removable():
        beyond = used > 0 and used + size > KEPT_BYTES
        used += size
        if beyond:
            yield path


def _abandoned() -> Iterator[Path]:
    """Files that nobody has gone on writing."""
    for path in folder().glob(f"{ASIDE_PREFIX}*{ASIDE_SUFFIX}"):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime > ABANDONED_S:
                yield path


def recordings(arm: str | None = None) -> list[Path]:
    """The recordings of an arm, or of all, the newest first; not what else lies in their folder."""
    return [path for _, _, path in _found() if arm is None or path.name.startswith(f"{arm}-")]


def _found() -> list[tuple[int, int, Path]]:
    """When each file that bears a name of ours was written (ns), its bytes, and its path; the newest first."""
    found = []
    for path in folder().glob(f"*{SUFFIX}"):
        if OWN_NAME.fullmatch(path.name):
            with contextlib.suppress(OSError):
                status = path.lstat()
                found.append((status.st_mtime_ns, status.st_size, path))
    return sorted(found, reverse=True)


def is_another_being_written() -> bool:
    """Whether one more will be here soon, such as that of an arm which has died just now."""
    return bool(set(folder().glob(f"{ASIDE_PREFIX}*{ASIDE_SUFFIX}")) - set(_abandoned()))


def newest(arm: str | None = None) -> Path:
    """The newest recording, of an arm or of all.

    Raises:
        Refusal: there is none.
    """
    found = recordings(arm)
    if not found:
        of_it = "" if arm is None else f" of an arm '{arm}'"
        raise Refusal(
            f"There is no recording{of_it} in {folder()}: `rtarm record` makes one of a running arm, and `rtarm up` "
            "one after each latched fault."
        )
    return found[0]


def chosen(given: str | None) -> Path:
    """The recording that a person means: a file, the newest of the arm of that name, or else the newest.

    Raises:
        Refusal: there is none of that arm, or none at all.
    """
    if given is None or (_NAME.fullmatch(given) and not Path(given).is_file()):
        return newest(given)
    return Path(given)
