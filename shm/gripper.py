"""The gripper's record in the state file, from both sides of the border; plain Python on both."""

from __future__ import annotations

import time
import zlib

import numpy as np

from shm import layout
from shm.files import MemoryFile
from shm.record import offset_of

READ_TRIES = 5
_AT = offset_of(layout.StateFile, "gripper")


def show_gripper(state: np.ndarray, values: np.ndarray) -> None:
    """Write the record (layout.Gripper, no dimensions, its crc ignored) into a mapped state file, shape (1,)."""
    body = values.tobytes()[8:]
    target = state.view(np.uint8)[_AT : _AT + layout.Gripper.dtype.itemsize]
    target[:8] = 0  # a reader that comes amid this finds a sum that fits nothing
    target[8:] = np.frombuffer(body, np.uint8)
    target[:8] = np.frombuffer(zlib.crc32(body).to_bytes(8, "little"), np.uint8)


def read_gripper(memory: MemoryFile) -> np.ndarray | None:
    """The gripper on an arm's bus as the control process showed it last, an array of no dimensions.

    None where there is none, and where its writer is amid writing for longer than a few looks take.
    """
    for attempt in range(READ_TRIES):
        copy = bytes(memory.map[_AT : _AT + layout.Gripper.dtype.itemsize])
        if int.from_bytes(copy[:8], "little") == zlib.crc32(memoryview(copy)[8:]):
            found = np.ndarray((), layout.Gripper.dtype, bytearray(copy))
            return found if int(found["written"]) else None
        if not any(copy):
            return None
        if attempt:
            time.sleep(0)
    return None
