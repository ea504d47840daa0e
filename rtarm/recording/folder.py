"""Where recordings are kept, what they are called, and how many of them."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

from rtarm.errors import Refusal

KEPT = 20
"""Newest recordings that are kept of an arm."""
KEPT_IN_ALL = 100
"""And of all arms together: each demo's has a name of its own."""
SUFFIX = ".mcap"


def folder() -> Path:
    """The folder of this user's recordings; it may not be there yet."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "rtarm" / "recordings"


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
    """Remove all but the newest recordings of an arm, and of all."""
    for path in {*recordings(arm)[KEPT:], *recordings()[KEPT_IN_ALL:]}:
        with contextlib.suppress(OSError):
            path.unlink()


def recordings(arm: str | None = None) -> list[Path]:
    """The recordings of an arm, or of all, the newest first."""
    found = []
    for path in folder().glob(f"*{SUFFIX}"):
        if arm is None or path.name.startswith(f"{arm}-"):  # the name of an arm has no hyphen
            with contextlib.suppress(OSError):
                found.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(found, reverse=True)]


def newest() -> Path:
    """The newest recording.

    Raises:
        Refusal: there is none.
    """
    found = recordings()
    if not found:
        raise Refusal(
            f"There is no recording in {folder()}: `rtarm record` makes one of a running arm, and `rtarm up` one after "
            "each latched fault."
        )
    return found[0]
