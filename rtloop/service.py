"""The in-process rings between the cycle and ordinary Python: how bring-up speaks on the bus.

The cycle alone uses the bus. A conversation (bring-up, clearing a fault …) puts frames and decisions into
`service_in`; the cycle sends the frames in bus time that is left over and hands every frame that a drive
sends meanwhile to `service_out`.
"""

from typing import Any, NamedTuple

import numpy as np

from rtloop.state import LOOP, SERVICE_SLOTS, offset_of
from shm.atomics import load_acquire, load_relaxed, store_release
from shm.jit import jit

Loop = Any

SEND = 1  # send a CAN frame
ADOPT = 2  # joint stands at `value`; code = Unreferenced reason (0: referenced)
BRING_UP_BEGINS = 3
BRING_UP_DONE = 4
BRING_UP_FAILED = 5  # joint, code = shm.words.Fault

_IN = offset_of(LOOP, "service_in")
_OUT = offset_of(LOOP, "service_out")
_WRITTEN = 0
_TAKEN = 16 * 8


@jit
def waiting(loop: Loop, ring_at: int) -> int:
    """Records that can be taken."""
    base = loop.params.address + ring_at
    return load_acquire(base + _WRITTEN) - load_relaxed(base + _TAKEN)


@jit
def room(loop: Loop, ring_at: int) -> bool:
    base = loop.params.address + ring_at
    return load_relaxed(base + _WRITTEN) - load_acquire(base + _TAKEN) < SERVICE_SLOTS


@jit
def next_slot(loop: Loop, ring_at: int, word: int) -> int:
    return load_relaxed(loop.params.address + ring_at + word) & (SERVICE_SLOTS - 1)


@jit
def pass_on(loop: Loop, ring_at: int, word: int) -> None:
    """Move a ring's writing or taking word by one, publishing what was done before."""
    address = loop.params.address + ring_at + word
    store_release(address, load_relaxed(address) + 1)


@jit
def hand_out(loop: Loop, frame_id: int, length: int, data: int, time_ns: int) -> None:
    """Cycle side: give a received frame to ordinary Python; dropped when it does not listen."""
    if not room(loop, _OUT):
        return
    record = loop.service_out.records[next_slot(loop, _OUT, _WRITTEN)]
    record.kind = SEND
    record.id = frame_id
    record.length = length
    record.data = data
    record.time_ns = time_ns
    pass_on(loop, _OUT, _WRITTEN)


@jit
def inbox(loop: Loop) -> int:
    """Cycle side: records that ordinary Python has put in."""
    return waiting(loop, _IN)


@jit
def inbox_slot(loop: Loop) -> int:
    return next_slot(loop, _IN, _TAKEN)


@jit
def command_length(loop: Loop) -> int:
    """Cycle side: number of packets of the command at the front; 0 while its last packet is not in the ring.

    Ordinary Python puts packets in one by one and may be interrupted between two of them, but a drive wants
    all packets of a command without another frame in between.
    """
    first = inbox_slot(loop)
    for i in range(inbox(loop)):
        if loop.service_in.records[(first + i) & (SERVICE_SLOTS - 1)].joined == 0:
            return i + 1
    return 0


@jit
def inbox_done(loop: Loop) -> None:
    pass_on(loop, _IN, _TAKEN)


class Frame(NamedTuple):
    """A CAN frame as ordinary Python sees it."""

    id: int
    data: bytes
    time_ns: int = 0


class ServicePort:
    """Ordinary Python's end of the rings; one conversation at a time, from one thread."""

    def __init__(self, loop: np.ndarray) -> None:
        self._loop = loop
        self._record = loop[0]

    def post(
        self,
        kind: int,
        *,
        frame: Frame | None = None,
        joined: bool = False,
        joint: int = -1,
        value: float = 0.0,
        code: int = 0,
    ) -> bool:
        """Put a record in; False when the ring is full."""
        if not room(self._record, _IN):
            return False
        record = self._record["service_in"]["records"][next_slot(self._record, _IN, _WRITTEN)]
        record["kind"] = kind
        record["joint"] = joint
        record["value"] = value
        record["code"] = code
        record["joined"] = int(joined)
        if frame is not None:
            record["id"] = frame.id
            record["length"] = len(frame.data)
            record["data"] = int.from_bytes(frame.data.ljust(8, b"\0"), "little", signed=True)
        pass_on(self._record, _IN, _WRITTEN)
        return True

    def received(self) -> list[Frame]:
        """Every frame handed out since the last call."""
        frames = []
        while waiting(self._record, _OUT) > 0:
            record = self._record["service_out"]["records"][next_slot(self._record, _OUT, _TAKEN)]
            data = int(record["data"]).to_bytes(8, "little", signed=True)[: int(record["length"])]
            frames.append(Frame(int(record["id"]), data, int(record["time_ns"])))
            pass_on(self._record, _OUT, _TAKEN)
        return frames
