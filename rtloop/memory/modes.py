"""The modes of the control process and the one table of allowed changes.

offline → bringing_up → holding ⇄ executing → stopping → holding
holding → disabled ⇄ free → bringing_up (being enabled brings the drives up again)
holding ⇄ referencing
any of them → fault → bringing_up (an explicit clear does too)
"""

from compilation.jit import jit
from rtloop.memory.events import record_event
from rtloop.memory.state import Loop
from shm.layout import StateFile
from shm.words import Event, Mode

ALLOWED = {
    Mode.OFFLINE: (Mode.BRINGING_UP, Mode.FAULT),
    Mode.BRINGING_UP: (Mode.HOLDING, Mode.FAULT),
    Mode.HOLDING: (Mode.EXECUTING, Mode.DISABLED, Mode.FREE, Mode.REFERENCING, Mode.FAULT),
    Mode.EXECUTING: (Mode.STOPPING, Mode.HOLDING, Mode.FAULT),
    Mode.STOPPING: (Mode.HOLDING, Mode.EXECUTING, Mode.FAULT),
    Mode.FAULT: (Mode.BRINGING_UP,),
    Mode.DISABLED: (Mode.FREE, Mode.BRINGING_UP, Mode.FAULT),
    Mode.FREE: (Mode.DISABLED, Mode.BRINGING_UP, Mode.FAULT),
    Mode.REFERENCING: (Mode.HOLDING, Mode.FAULT),
}

_ALLOWED_BITS = tuple(sum(1 << int(to) for to in ALLOWED[mode]) for mode in Mode)


@jit
def is_disabled(mode: int) -> bool:
    """Whether the drives were let go."""
    return mode == Mode.DISABLED or mode == Mode.FREE


@jit
def change_mode(loop: Loop, shared: StateFile, mode: int) -> bool:
    """Go to a mode if the table allows it; says whether it did."""
    if (_ALLOWED_BITS[loop.mode] >> mode) & 1 == 0:
        return False
    loop.mode = mode
    if mode != Mode.REFERENCING and mode != Mode.HOLDING:
        loop.dialogue.pose_due_ns = 0
    record_event(loop, shared, Event.MODE, -1, mode, 0.0, 0.0)
    return True
