"""Frames of the CH340 adapters that speak AT (docs/hardware/adapters.md), in the cycle.

`41 54` ("AT"), identifier << 3 | 4 as 32 bits, the highest first, the length, the data, `0D 0A` (facts/can-adapters.md,
section 3). The low three bits give the kind of the frame, and 4 is extended; no other kind is known to work, so others
are neither sent nor accepted.
"""

from compilation.jit import jit
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.link import TX_BYTES, Bus
from rtloop.wire import framed
from rtloop.wire.counted import count_wire_error
from rtloop.wire.found import FRAME, NOTHING
from shm.layout import StateFile

LONGEST_FRAME_BYTES = 17
SHORTEST_FRAME_BYTES = 9
LONGEST_DATA = 8
_A, _T, _CR, _LF = 0x41, 0x54, 0x0D, 0x0A
_DATA_AT = 7
_KIND_BITS = 7
_EXTENDED = 4


@jit
def encode_frame(bus: Bus, frame_id: int, kind: int, length: int, data: int) -> bool:
    """Append a frame to the transmit buffer; `data` holds the bytes, the first lowest.

    `kind` is bits of `rtloop.memory.frame_words`. False if the buffer is full, and for any kind but EXTENDED.
    """
    tx = bus.outgoing.bytes
    at = bus.outgoing.length
    if at + LONGEST_FRAME_BYTES > TX_BYTES or kind != EXTENDED:
        return False
    word = frame_id << 3 | _EXTENDED
    tx[at] = _A
    tx[at + 1] = _T
    for i in range(4):
        tx[at + 2 + i] = (word >> (8 * (3 - i))) & 255
    tx[at + 6] = length
    at += _DATA_AT
    for i in range(length):
        tx[at] = (data >> (8 * i)) & 255
        at += 1
    tx[at] = _CR
    tx[at + 1] = _LF
    bus.outgoing.length = at + 2
    return True


@jit
def next_frame(bus: Bus, shared: StateFile, end: int) -> tuple[int, int, int, int, int]:
    """(FRAME, id, kind, length, data) of the next extended data frame in the receive ring up to `end`, or NOTHING.

    The bytes up to the end of the frame are consumed; bytes that belong to no frame are counted as a wire error.
    """
    while framed.collect(bus, end):
        found, frame_id, length, data = look(bus)
        if found == framed.SOUND:
            return FRAME, frame_id, EXTENDED, length, data
        if found == framed.WRONG:
            count_wire_error(shared, bus)
    return NOTHING, 0, 0, 0, 0


@jit
def look(bus: Bus) -> tuple[int, int, int, int]:
    """(framed.…, id, length, data) of the frame at the beginning of the collected bytes.

    It is removed from them, unless it takes MORE bytes to tell.
    """
    line = bus.parser.line
    if bus.parser.line_length < SHORTEST_FRAME_BYTES:
        return framed.wait_for(bus, SHORTEST_FRAME_BYTES), 0, 0, 0
    length = int(line[_DATA_AT - 1])
    if line[0] != _A or line[1] != _T or length > LONGEST_DATA:
        return framed.resynchronise(bus, _A, SHORTEST_FRAME_BYTES), 0, 0, 0
    end = _DATA_AT + length
    if bus.parser.line_length < end + 2:
        return framed.wait_for(bus, end + 2), 0, 0, 0
    if line[end] != _CR or line[end + 1] != _LF:
        return framed.resynchronise(bus, _A, SHORTEST_FRAME_BYTES), 0, 0, 0
    word = 0
    for i in range(4):
        word = word << 8 | int(line[2 + i])
    data = 0
    for i in range(length):
        data |= int(line[_DATA_AT + i]) << (8 * i)
    framed.found_sound(bus, end + 2, SHORTEST_FRAME_BYTES)
    if word & _KIND_BITS != _EXTENDED:
        return framed.OTHER, 0, 0, 0
    return framed.SOUND, word >> 3, length, data
