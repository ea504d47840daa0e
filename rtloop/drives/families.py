"""Families of drives, as the cycle sees them: one line a family in each of these functions.

A family's file has these functions for its own drives. A mock drive says nothing and hears nothing.
"""

from typing import Any

from rtloop.drives import zdt
from rtloop.state import FAMILY_MOCK, FAMILY_ZDT
from shm.jit import jit

Loop = Any  # record of dtype rtloop.state.LOOP
Shared = Any  # record of dtype shm.layout.STATE


@jit
def is_on_the_bus(loop: Loop, joint: int) -> bool:
    """Whether the joint's drive is one that can be asked."""
    return bool(loop.joints[joint].family != FAMILY_MOCK)


@jit
def lead(loop: Loop, shared: Shared, joint: int) -> None:
    """Send what leads a drive through the coming period."""
    if loop.joints[joint].family == FAMILY_ZDT:
        zdt.lead(loop, shared, joint)


@jit
def stop(loop: Loop, shared: Shared, joint: int) -> bool:
    """Tell a drive to stop where it is; False when there is no room for that."""
    if loop.joints[joint].family == FAMILY_ZDT:
        return bool(zdt.stop(loop, shared, joint))
    return True


@jit
def ask_position(loop: Loop, shared: Shared, joint: int) -> None:
    """Ask a drive where it is."""
    if loop.joints[joint].family == FAMILY_ZDT:
        zdt.ask_position(loop, shared, joint)


@jit
def ask_status(loop: Loop, shared: Shared, joint: int) -> None:
    """Ask a drive how it is."""
    if loop.joints[joint].family == FAMILY_ZDT:
        zdt.ask_status(loop, shared, joint)


@jit
def is_stop(loop: Loop, joint: int, data: int) -> bool:
    """Whether a frame to the joint's drive is the stop command."""
    return bool(loop.joints[joint].family == FAMILY_ZDT and zdt.is_stop(data))


@jit
def note_what_was_said(loop: Loop, joint: int, data: int) -> None:
    """A conversation has told a drive something among the cycle's frames."""
    if loop.joints[joint].family == FAMILY_ZDT:
        zdt.note_what_was_said(loop, joint, data)


@jit
def hear(loop: Loop, shared: Shared, joint: int, frame_id: int, length: int, data: int, time_ns: int) -> None:
    """Take what a drive says."""
    if loop.joints[joint].family == FAMILY_ZDT:
        zdt.hear(loop, shared, joint, frame_id, length, data, time_ns)
