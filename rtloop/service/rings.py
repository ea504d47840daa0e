"""The cycle's end of the in-process rings to ordinary Python; the other end is `rtloop.service.port`."""

from compilation.jit import jit
from rtloop.memory.link import SERVICE_SLOTS
from rtloop.memory.state import Loop
from rtloop.service.port import IN, OUT, SEND, TAKEN, WRITTEN
from shm.atomics import load_acquire, load_relaxed, store_release


@jit
def waiting(loop: Loop, ring_at: int) -> int:
    """Number of records that can be taken."""
    base = loop.params.address + ring_at
    # pairs with `ServicePort`'s `store_word` of WRITTEN: a record is read after the count that announces it
    return load_acquire(base + WRITTEN) - load_relaxed(base + TAKEN)


@jit
def room(loop: Loop, ring_at: int) -> bool:
    """Whether a ring has room for another record."""
    base = loop.params.address + ring_at
    # pairs with `ServicePort`'s `store_word` of TAKEN: a slot is written after it was read
    return load_relaxed(base + WRITTEN) - load_acquire(base + TAKEN) < SERVICE_SLOTS


@jit
def next_slot(loop: Loop, ring_at: int, word: int) -> int:
    """Index of the slot to which a ring's writing or taking word points."""
    return load_relaxed(loop.params.address + ring_at + word) & (SERVICE_SLOTS - 1)


@jit
def pass_on(loop: Loop, ring_at: int, word: int) -> None:
    """Move a ring's writing or taking word by one, publishing what was done before."""
    address = loop.params.address + ring_at + word
    # pairs with `ServicePort`'s `load_word`: a record is whole before it is counted, and read before it is given back
    store_release(address, load_relaxed(address) + 1)


@jit
def hand_out(loop: Loop, joint: int, frame_id: int, kind: int, length: int, data: int, time_ns: int) -> None:
    """Cycle side: hand ordinary Python a frame of a joint's drive, or the gripper's; dropped when the ring is full."""
    if not room(loop, OUT):
        return
    record = loop.service_out.records[next_slot(loop, OUT, WRITTEN)]
    record.kind = SEND
    record.id = frame_id
    record.frame_kind = kind
    record.joint = joint
    record.length = length
    record.payload = data
    record.time_ns = time_ns
    pass_on(loop, OUT, WRITTEN)


@jit
def inbox(loop: Loop) -> int:
    """Cycle side: number of records that ordinary Python has put in."""
    return waiting(loop, IN)


@jit
def inbox_slot(loop: Loop) -> int:
    """Cycle side: index of the slot with the first record that ordinary Python has put in."""
    return next_slot(loop, IN, TAKEN)


@jit
def command_length(loop: Loop) -> int:
    """Cycle side: number of packets of the command at the front; 0 while its last packet is not in the ring.

    Ordinary Python puts packets in one by one and may be interrupted between two of them, but a drive needs
    all packets of a command without another frame in between.
    """
    first = inbox_slot(loop)
    for i in range(inbox(loop)):
        if loop.service_in.records[(first + i) & (SERVICE_SLOTS - 1)].joined == 0:
            return i + 1
    return 0


@jit
def inbox_done(loop: Loop) -> None:
    """Cycle side: take the first record out of the ring."""
    pass_on(loop, IN, TAKEN)
