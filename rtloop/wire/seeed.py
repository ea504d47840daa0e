"""Frames of a Seeed or Waveshare USB-CAN-A adapter in its variable-length framing, in the cycle.

`AA`, then C0 | extended << 5 | remote << 4 | length, the identifier (2 or 4 bytes, the lowest first), the data, `55`
(facts/can-adapters.md, section 2). `AA 55` begins a message of 20 bytes with a check sum instead: a status, or a frame
of the fixed framing that an adapter uses before it is set up. A remote frame has no data; if an adapter sends as many
bytes as are requested, they are skipped.
"""

from compilation.jit import jit
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.link import TX_BYTES, Bus
from rtloop.wire import framed
from rtloop.wire.counted import count_wire_error
from rtloop.wire.found import FRAME, NOTHING
from shm.layout import StateFile

START, END = 0xAA, 0x55
LONGEST_FRAME_BYTES = 15
SHORTEST_FRAME_BYTES = 5
FIXED_BYTES = 20
"""Length of a message that begins with `AA 55`; its last byte is the sum of the bytes in between."""
LONGEST_DATA = 8
_KIND = 0xC0
_EXTENDED_BIT, _REMOTE_BIT = 0x20, 0x10
_LENGTH_BITS = 0x0F


@jit
def encode_frame(bus: Bus, frame_id: int, kind: int, length: int, data: int) -> bool:
    """Append a frame to the transmit buffer; `data` holds the bytes, the first lowest. False if the buffer is full.

    `kind` is bits of `rtloop.memory.frame_words`.
    """
    tx = bus.outgoing.bytes
    at = bus.outgoing.length
    if at + LONGEST_FRAME_BYTES > TX_BYTES:
        return False
    tx[at] = START
    tx[at + 1] = _KIND | (_EXTENDED_BIT if kind & EXTENDED else 0) | (_REMOTE_BIT if kind & REMOTE else 0) | length
    at += 2
    for i in range(4 if kind & EXTENDED else 2):
        tx[at] = (frame_id >> (8 * i)) & 255
        at += 1
    for i in range(0 if kind & REMOTE else length):
        tx[at] = (data >> (8 * i)) & 255
        at += 1
    tx[at] = END
    bus.outgoing.length = at + 1
    return True


@jit
def next_frame(bus: Bus, shared: StateFile, end: int) -> tuple[int, int, int, int, int]:
    """(FRAME, id, kind, length, data) of the next data frame in the receive ring up to `end`, or NOTHING.

    The bytes up to the end of the frame are consumed; bytes that belong to no frame are counted as a wire error. Remote
    frames are ignored.
    """
    while framed.collect(bus, end):
        found, frame_id, kind, length, data = look(bus)
        if found == framed.SOUND:
            return FRAME, frame_id, kind, length, data
        if found == framed.WRONG:
            count_wire_error(shared, bus)
    return NOTHING, 0, 0, 0, 0


@jit
def look(bus: Bus) -> tuple[int, int, int, int, int]:
    """(framed.…, id, kind, length, data) of the frame at the beginning of the collected bytes.

    It is removed from them, unless it takes MORE bytes to tell.
    """
    parser, line = bus.parser, bus.parser.line
    head = int(line[1])
    if parser.line_length < SHORTEST_FRAME_BYTES:
        return framed.wait_for(bus, SHORTEST_FRAME_BYTES), 0, 0, 0, 0
    if line[0] == START and head == END:
        return look_at_fixed(bus), 0, 0, 0, 0
    length = head & _LENGTH_BITS
    if line[0] != START or head & _KIND != _KIND or length > LONGEST_DATA:
        return framed.resynchronise(bus, START, SHORTEST_FRAME_BYTES), 0, 0, 0, 0
    kind = EXTENDED if head & _EXTENDED_BIT else STANDARD
    begin = 6 if kind == EXTENDED else 4
    end = begin
    if head & _REMOTE_BIT == 0 or (parser.line_length > end and line[end] != END):
        end += length
    if parser.line_length <= end:
        return framed.wait_for(bus, end + 1), 0, 0, 0, 0
    frame_id = 0
    for i in range(2, begin):
        frame_id |= int(line[i]) << (8 * (i - 2))
    if line[end] != END or frame_id > (0x1FFFFFFF if kind == EXTENDED else 0x7FF):
        return framed.resynchronise(bus, START, SHORTEST_FRAME_BYTES), 0, 0, 0, 0
    data = 0
    if head & _REMOTE_BIT == 0:
        for i in range(length):
            data |= int(line[begin + i]) << (8 * i)
    framed.found_sound(bus, end + 1, SHORTEST_FRAME_BYTES)
    if head & _REMOTE_BIT:
        return framed.OTHER, 0, 0, 0, 0
    return framed.SOUND, frame_id, kind, length, data


@jit
def look_at_fixed(bus: Bus) -> int:
    """framed.… of a message that begins with `AA 55`: a complete, sound one is skipped."""
    line = bus.parser.line
    if bus.parser.line_length < FIXED_BYTES:
        return framed.wait_for(bus, FIXED_BYTES)
    total = 0
    for i in range(2, FIXED_BYTES - 1):
        total += int(line[i])
    if total & 255 != line[FIXED_BYTES - 1]:
        return framed.resynchronise(bus, START, SHORTEST_FRAME_BYTES)
    framed.found_sound(bus, FIXED_BYTES, SHORTEST_FRAME_BYTES)
    return framed.OTHER
