"""The command line, the launcher, and `rtarm.connect`, by which a Python program moves a running arm."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rtarm.arm import Arm, State, Stream, connect
    from rtarm.console.errors import GoalFailed, Refusal
    from rtarm.running.limits import Limits
    from shm.errors import NotRunning

_HOMES = {
    "rtarm.arm": ("Arm", "State", "Stream", "connect"),
    "rtarm.console.errors": ("GoalFailed", "Refusal"),
    "rtarm.running.limits": ("Limits",),
    "shm.errors": ("NotRunning",),
}
"""Where each name is, which is imported when it is first used: the command line must start quickly."""


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(module), name)
    raise AttributeError(f"module 'rtarm' has no attribute {name!r}")


__all__ = ["Arm", "GoalFailed", "Limits", "NotRunning", "Refusal", "State", "Stream", "connect"]
