"""Frames that a cycle sends, in the form of the wire, one after the other in the transmit buffer of their bus.

The buffer records where each frame ends and which frames belong to one command. A wire may take only a part of it. The
frames that it did not take are dropped and not sent late: the next cycle makes newer ones, and a drive may have lost
its reference meanwhile. Two things are still sent, before the frames of the next cycle: the rest of a frame that was
sent in part, and the rest of a command of which the drive has received the first packet.
"""

from compilation.jit import jit
from config.frames import unchecked_frame_bits
from rtloop.memory.buses import bus_of
from rtloop.memory.frame_words import EXTENDED, REMOTE
from rtloop.memory.link import CAN_FRAME_BYTES, SLCAN_LONGEST_LINE, TX_BYTES, TX_FRAMES, WIRE_PYTHON_CAN, Bus
from rtloop.memory.recorder import SENT, marks_of, record_frame
from rtloop.memory.state import Loop
from rtloop.memory.updates import stop_came_back
from rtloop.wire import can_frame, wires
from rtloop.wire.can_words import JOINED, STOP
from rtloop.wire.counted import count_sent, count_unsent
from shm.layout import StateFile

LONGEST_FRAME_BYTES = SLCAN_LONGEST_LINE
"""Bytes of a frame that no wire exceeds."""


_data_frame_bits = jit(unchecked_frame_bits)


@jit
def frame_bits(kind: int, length: int) -> int:
    """Bits of a frame on the bus, with worst-case stuffing and the three bits of interframe space."""
    return int(_data_frame_bits(kind & EXTENDED != 0, 0 if kind & REMOTE else length))


@jit
def send(
    loop: Loop,
    shared: StateFile,
    joint: int,
    frame_id: int,
    kind: int,
    length: int,
    data: int,
    joined: int = 0,
    stops: int = -1,
) -> bool:
    """Append a frame to the transmit buffer of a joint's bus (see `put`), and count it as sent; False without room.

    If the wire does not take it, the counters are corrected later.
    """
    # plain ints: for constants numba would compile separate versions, down to the wire's codec
    bus, made_ms = bus_of(loop, joint), loop.timing.now_ns // 1_000_000
    if not put(bus, made_ms, int(frame_id), int(kind), int(length), int(data), int(joined), int(stops)):
        return False
    bits = frame_bits(kind, length)
    bus.outgoing.bits += bits
    count_sent(shared, bus, 1, bits)
    bus.unheard_frames += 1
    return True


@jit
def put(bus: Bus, made_ms: int, frame_id: int, kind: int, length: int, data: int, joined: int, stops: int = -1) -> bool:
    """Append a frame to the transmit buffer in the form of this bus' wire; False if there is no room.

    `made_ms` is the time of the cycle (CLOCK_MONOTONIC, ms).
    `kind` is bits of `frame_words`; `data` holds the bytes, the first lowest; `joined` is 1 if the next frame belongs
    to the same command; `stops` is the joint whose stop command it is, -1 for none.
    """
    outgoing = bus.outgoing
    if not has_room(bus, 1) or not wires.encode_frame(bus, frame_id, kind, length, data):
        return False
    if bus.interface == WIRE_PYTHON_CAN:
        can_frame.mark(bus, (STOP if stops >= 0 else 0) | (JOINED if joined else 0), made_ms)
    outgoing.ends[outgoing.frames] = outgoing.length
    outgoing.joined[outgoing.frames] = joined
    outgoing.ids[outgoing.frames] = frame_id
    outgoing.kinds[outgoing.frames] = kind
    outgoing.stops[outgoing.frames] = stops
    outgoing.sizes[outgoing.frames] = length
    outgoing.payloads[outgoing.frames] = data
    outgoing.frames += 1
    return True


@jit
def has_room(bus: Bus, frames: int) -> bool:
    """Whether `frames` more frames fit into the transmit buffer, however long they are."""
    outgoing = bus.outgoing
    return outgoing.frames + frames <= TX_FRAMES and outgoing.length + frames * LONGEST_FRAME_BYTES <= TX_BYTES


@jit
def begin(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """Make room for a cycle's frames: of the frames left over, only those that are owed to a drive stay."""
    outgoing = bus.outgoing
    outgoing.bits = 0
    if outgoing.length == 0:  # a caller that took all bytes may just have set the length to 0
        outgoing.frames = 0
    keep(loop, shared, bus, 0, 0, min(outgoing.owed, outgoing.frames))


@jit
def took(loop: Loop, shared: StateFile, bus: Bus, sent: int) -> None:
    """Remove the first `sent` bytes, which the wire has taken, and drop the rest except the frames that are owed.

    Those are sent before the frames of the next cycle.
    """
    outgoing = bus.outgoing
    ends, joined = outgoing.ends, outgoing.joined
    shared.counters.bytes_sent += sent
    gone = 0
    while gone < outgoing.frames and ends[gone] <= sent:
        gone += 1
    owed = max(outgoing.owed, gone)
    begins = ends[gone - 1] if gone > 0 else 0
    if gone < outgoing.frames and (sent > begins or (gone > 0 and joined[gone - 1] == 1)):
        last = gone
        while joined[last] == 1 and last + 1 < outgoing.frames:
            last += 1
        owed = max(owed, last + 1)
    keep(loop, shared, bus, sent, gone, owed)


@jit
def keep(loop: Loop, shared: StateFile, bus: Bus, sent: int, first: int, end: int) -> None:
    """Keep the frames from `first` up to, not including, `end`, and remove the first `sent` bytes.

    The frames before `first` were sent: they are recorded in the flight recorder. The frames from `end` on are dropped:
    they are counted, and a stop command among them is due again.
    """
    outgoing = bus.outgoing
    ends = outgoing.ends
    left = ends[end - 1] - sent if end > first else 0
    count_unsent(shared, bus, outgoing.length - sent - left)
    bus.unheard_frames -= outgoing.frames - end
    for frame in range(first):
        marks = SENT | marks_of(outgoing.kinds[frame])
        record_frame(
            loop,
            shared,
            bus.number,
            loop.timing.now_ns,
            outgoing.ids[frame],
            marks,
            outgoing.sizes[frame],
            outgoing.payloads[frame],
        )
    for frame in range(end, outgoing.frames):
        count_sent(shared, bus, -1, -frame_bits(outgoing.kinds[frame], outgoing.sizes[frame]))
        if outgoing.stops[frame] >= 0:
            stop_came_back(loop.axes[outgoing.stops[frame]])
    if sent > 0:
        for i in range(left):
            outgoing.bytes[i] = outgoing.bytes[sent + i]
        for frame in range(first, end):
            ends[frame - first] = ends[frame] - sent
            outgoing.joined[frame - first] = outgoing.joined[frame]
            outgoing.ids[frame - first] = outgoing.ids[frame]
            outgoing.kinds[frame - first] = outgoing.kinds[frame]
            outgoing.stops[frame - first] = outgoing.stops[frame]
            outgoing.sizes[frame - first] = outgoing.sizes[frame]
            outgoing.payloads[frame - first] = outgoing.payloads[frame]
    outgoing.length = left
    outgoing.frames = outgoing.owed = end - first


@jit
def take_back(shared: StateFile, bus: Bus, unsent: int) -> None:
    """Correct the counters for bytes that the wire took and did not send after all.

    `unsent` is their number since the start, a whole number of CAN frames.
    """
    more = unsent - bus.outgoing.unsent_taken_back
    bus.outgoing.unsent_taken_back = unsent
    count_unsent(shared, bus, more)
    shared.counters.bytes_sent -= more
    count_sent(shared, bus, -(more // CAN_FRAME_BYTES), 0)


@jit
def forget(loop: Loop, shared: StateFile, bus: Bus) -> None:
    """Drop all frames, owed ones too, because the wire is gone or is another one."""
    bus.outgoing.owed = 0
    begin(loop, shared, bus)
    bus.unheard_frames = 0
