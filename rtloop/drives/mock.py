"""No drive: nothing is sent or received; `rtloop.bus.frames.mirror` makes the commanded position the measured one."""

from compilation.jit import jit
from rtloop.memory.state import Loop
from shm.layout import StateFile


@jit
def lead(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing."""


@jit
def stop(loop: Loop, joint: int, shared: StateFile) -> bool:
    """Send nothing: a mock joint is where it is commanded to be."""
    return True


@jit
def ask_position(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing."""


@jit
def ask_status(loop: Loop, joint: int, shared: StateFile) -> None:
    """Send nothing."""


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """No frame is sent to a mock drive."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Do nothing: no frame is sent to a mock drive."""


@jit
def receive(
    loop: Loop, joint: int, shared: StateFile, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """Do nothing: a mock drive sends no frames."""
