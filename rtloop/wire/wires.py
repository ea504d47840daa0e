"""Wires, as the cycle sees them: each function here calls the one of the arm's wire.

The file of a wire has `encode_frame` and `next_frame` for its own bytes.
"""

from compilation.jit import jit
from rtloop.memory.link import WIRE_AT, WIRE_SEEED, WIRE_SLCAN, Bus
from rtloop.wire import at_frames, can_frame, seeed, slcan
from rtloop.wire.found import NOTHING
from shm.layout import StateFile


@jit
def encode_frame(bus: Bus, frame_id: int, kind: int, length: int, data: int) -> bool:
    """Append a frame to the transmit buffer in the form of this arm's wire; False if there is no room.

    `kind` is bits of `frame_words`; `data` holds the bytes, the first lowest.
    """
    wire = bus.interface
    if wire == WIRE_SLCAN:
        return bool(slcan.encode_frame(bus, frame_id, kind, length, data))
    if can_frame.is_carried_by(wire):
        return bool(can_frame.encode_frame(bus, frame_id, kind, length, data))
    if wire == WIRE_SEEED:
        return bool(seeed.encode_frame(bus, frame_id, kind, length, data))
    if wire == WIRE_AT:
        return bool(at_frames.encode_frame(bus, frame_id, kind, length, data))
    return False


@jit
def next_frame(bus: Bus, shared: StateFile, end: int) -> tuple[int, int, int, int, int]:
    """(found.…, id, kind, length, data) of the next frame in the receive ring up to `end`; invalid bytes are counted.

    NOTHING once all bytes up to `end` are consumed; the beginning of an incomplete frame is kept for the next call.
    """
    wire = bus.interface
    if wire == WIRE_SLCAN:
        return slcan.next_frame(bus, shared, end)
    if can_frame.is_carried_by(wire):
        return can_frame.next_frame(bus, shared, end)
    if wire == WIRE_SEEED:
        return seeed.next_frame(bus, shared, end)
    if wire == WIRE_AT:
        return at_frames.next_frame(bus, shared, end)
    return NOTHING, 0, 0, 0, 0


@jit
def forget_half_frames(bus: Bus) -> None:
    """Drop the beginning of an incomplete frame: the bytes that come now do not continue it."""
    parser = bus.parser
    parser.line_length = parser.line_spoilt = parser.line_needed = 0
