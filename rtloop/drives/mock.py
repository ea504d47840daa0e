"""No drive: nothing is sent and nothing heard; `rtloop.bus.frames.mirror` measures what is commanded."""

from compilation.jit import jit
from rtloop.memory.state import Loop, Shared


@jit
def lead(loop: Loop, joint: int, shared: Shared) -> None:
    """Nobody is led."""


@jit
def stop(loop: Loop, joint: int, shared: Shared) -> bool:
    """It stands."""
    return True


@jit
def ask_position(loop: Loop, joint: int, shared: Shared) -> None:
    """Nobody answers."""


@jit
def ask_status(loop: Loop, joint: int, shared: Shared) -> None:
    """Nobody answers."""


@jit
def is_stop(loop: Loop, joint: int, frame_id: int, data: int) -> bool:
    """Nothing is said to it."""
    return False


@jit
def note_what_was_said(loop: Loop, joint: int, frame_id: int, data: int) -> None:
    """Nothing was."""


@jit
def receive(
    loop: Loop, joint: int, shared: Shared, frame_id: int, kind: int, length: int, data: int, time_ns: int
) -> None:
    """It says nothing."""
