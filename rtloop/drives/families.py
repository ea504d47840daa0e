"""Families of drives, as the cycle sees them: each family's file has the functions below for its own drives.

Here each of them becomes one function for all families, which calls that of the joint's family. The families are those
that `config.joint.FAMILIES` names; their modules are found by these names. A mock drive sends and receives nothing.
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
"""Families that one function chooses among: another function costs compile time, another family in one does not."""


def _by_family(name: str) -> Any:
    """The function `name` for a joint of any family; its first arguments are the loop and the joint."""
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
    """Whether the joint has a drive on the bus, which is so for all but mock drives."""
    return bool(loop.joints[joint].family != FAMILY_MOCK)


lead = _by_family("lead")
"""(loop, joint, shared) → None: send the motion command for the coming period."""
stop = _by_family("stop")
"""(loop, joint, shared) → bool: command the drive to stop where it is; False if the transmit buffer has no room."""
ask_position = _by_family("ask_position")
"""(loop, joint, shared) → None: ask the drive for its position, unless a motion command of this cycle does so."""
ask_status = _by_family("ask_status")
"""(loop, joint, shared) → None: ask the drive for its status."""
is_stop = _by_family("is_stop")
"""(loop, joint, frame_id, data) → bool: whether a frame to the drive is the stop command."""
note_what_was_said = _by_family("note_what_was_said")
"""(loop, joint, frame_id, data) → None: take note of a service dialogue's frame, sent among those of the cycle."""
receive = _by_family("receive")
"""(loop, joint, shared, frame_id, kind, length, data, time_ns) → None: decode and store a frame of the drive."""
