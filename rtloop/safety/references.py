"""Whether what a drive counts means an angle: how a joint loses its reference, and what gives it back."""

from compilation.jit import jit
from rtloop.memory.events import record_event
from rtloop.memory.state import Loop
from rtloop.memory.updates import owe_no_stop, owe_stop
from rtloop.safety.absolute_encoder import absolute_makes_good
from shm.layout import StateFile
from shm.words import Event, Unreferenced

_absolute_makes_good = jit(absolute_makes_good)


@jit
def outlives_a_clear(loop: Loop, joint: int) -> bool:
    """Whether a joint stays unreferenced although the drive looks sound again: clearing a fault never references."""
    reason = loop.axes[joint].reference.unreferenced_reason
    if reason == Unreferenced.POSITION_JUMP or reason == Unreferenced.NOT_HOMED or reason == Unreferenced.INCREMENTAL:
        return True
    return bool(_absolute_makes_good(reason) and loop.joints[joint].knows_its_angle == 0)


@jit
def lose_reference(loop: Loop, shared: StateFile, joint: int, reason: int) -> None:
    """The drive's count means nothing any more: stop command, then no motion frame until it is referenced."""
    axis = loop.axes[joint]
    reference = axis.reference
    if reference.referenced == 1:
        record_event(loop, shared, Event.REFERENCE, joint, reason, 0.0, 0.0)
        reference.lost_at_rad = axis.measured.position_rad
    reference.referenced = reference.power_loss_known = axis.sent.fast_ready = 0
    reference.unreferenced_reason = reason
    owe_stop(axis)


@jit
def await_bring_up(loop: Loop, joint: int) -> None:
    """No joint is led while drives are brought up; a reason that outlives a clear is not forgotten."""
    reference = loop.axes[joint].reference
    reference.referenced = 0
    if not outlives_a_clear(loop, joint):
        reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP


@jit
def forgive_silence(loop: Loop, joint: int) -> None:
    """A drive that had power all along went on counting: its silence costs no angle."""
    reference = loop.axes[joint].reference
    if reference.unreferenced_reason == Unreferenced.SILENT:
        reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP


@jit
def forget_count(loop: Loop, joint: int) -> None:
    """The drive sets its count anew, at a place of its own choice; an earlier loss of power still counts."""
    reference = loop.axes[joint].reference
    reference.referenced = reference.power_loss_known = 0
    if reference.unreferenced_reason != Unreferenced.POWER_LOST:
        reference.unreferenced_reason = Unreferenced.NOT_HOMED


@jit
def take_count(loop: Loop, joint: int, power_loss_known: int) -> None:
    """The joint's count means an angle again; it is referenced once its position is set."""
    reference = loop.axes[joint].reference
    reference.power_loss_known = power_loss_known
    reference.referenced = 0
    reference.unreferenced_reason = Unreferenced.NOT_BROUGHT_UP


@jit
def refer(loop: Loop, joint: int, reason: int) -> None:
    """The joint's position is set: it is referenced, unless there is a reason why its angle is not known."""
    axis = loop.axes[joint]
    reference = axis.reference
    if reason == Unreferenced.POWER_LOST or not outlives_a_clear(loop, joint):
        reference.unreferenced_reason = reason
    reference.referenced = 1 if reference.unreferenced_reason == Unreferenced.REFERENCED else 0
    if reference.referenced == 1:  # any other is stopped before it is led again
        owe_no_stop(axis)
