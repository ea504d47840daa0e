"""Families of drives, as the cycle sees them: a family's file has these functions for its own drives.

Each of them becomes one function for all families, which looks at the joint's; what `config.joint.FAMILIES` names is
found here by its name. A mock drive says nothing and hears nothing.
"""

import importlib
from collections.abc import Callable
from typing import Any

from compilation.jit import jit
from config.joint import FAMILIES
from rtloop.drives import mock
from rtloop.memory.axis import FAMILY_MOCK
from rtloop.memory.state import Loop

AT_ONCE = 4
"""Families that one function chooses among: each more function costs compiling, each more family in one does not."""


def _by_family(name: str) -> Any:
    """The function of this name for a joint of any family; its arguments begin with the loop and the joint."""
    chosen: Callable[..., Any] = getattr(mock, name)
    others = [number for number in range(len(FAMILIES)) if number != FAMILY_MOCK]
    for first in range(others[0], len(FAMILIES), AT_ONCE):
        modules = [importlib.import_module(f"rtloop.drives.{family}") for family in FAMILIES[first : first + AT_ONCE]]
        chosen = _among(first, [getattr(module, name) for module in modules], chosen)
    return chosen


def _among(first: int, does: list[Callable[..., Any]], otherwise: Callable[..., Any]) -> Callable[..., Any]:
    one, two, three, four = (*does, *[otherwise] * (AT_ONCE - len(does)))

    @jit
    def choose(loop: Loop, joint: int, *rest: Any) -> Any:
        family = loop.joints[joint].family - first
        if family == 0:
            return one(loop, joint, *rest)
        if family == 1:
            return two(loop, joint, *rest)
        if family == 2:
            return three(loop, joint, *rest)
        if family == 3:
            return four(loop, joint, *rest)
        return otherwise(loop, joint, *rest)

    return choose


@jit
def is_on_the_bus(loop: Loop, joint: int) -> bool:
    """Whether the joint's drive is one that can be asked."""
    return bool(loop.joints[joint].family != FAMILY_MOCK)


lead = _by_family("lead")
"""(loop, joint, shared) → None: send what leads the drive through the coming period."""
stop = _by_family("stop")
"""(loop, joint, shared) → bool: tell the drive to stop where it is; False when there is no room for that."""
ask_position = _by_family("ask_position")
"""(loop, joint, shared) → None: ask the drive where it is, unless leading it has done so in this cycle."""
ask_status = _by_family("ask_status")
"""(loop, joint, shared) → None: ask the drive how it is."""
is_stop = _by_family("is_stop")
"""(loop, joint, frame_id, data) → bool: whether a frame to the drive is the stop command."""
note_what_was_said = _by_family("note_what_was_said")
"""(loop, joint, frame_id, data) → None: a conversation has told the drive something among the cycle's frames."""
receive = _by_family("receive")
"""(loop, joint, shared, frame_id, kind, length, data, time_ns) → None: take what the drive says."""
