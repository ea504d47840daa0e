"""CAN frames in SocketCAN's form, in the cycle: `struct can_frame`, 16 bytes (linux/can.h).

u32 id with its flags in the machine's byte order (little-endian on all machines that run this), u8 length, 3 bytes
unused, 8 bytes of data. A frame with the error flag was made by the controller's driver: `rtloop.wire.can_errors`.
"""

from compilation.jit import jit
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.link import CAN_FRAME_BYTES, RX_BYTES, TX_BYTES, WIRE_PYTHON_CAN, WIRE_SOCKETCAN, Bus
from rtloop.wire.can_words import ERROR_FLAG, EXTENDED_FLAG, EXTENDED_MASK, REMOTE_FLAG, STANDARD_MASK
from rtloop.wire.counted import count_wire_error
from rtloop.wire.found import CONTROLLER_ERROR, FRAME, NOTHING
from shm.layout import StateFile

LONGEST_DATA = 8
_LENGTH_AT = 4
_MARKS_AT = 5
_MADE_AT = 6
_DATA_AT = 8

RECORD_OTHER = 0
RECORD_FRAME = 1
RECORD_WRONG = 2
RECORD_ERROR = 3


@jit
def is_carried_by(wire: int) -> bool:
    """Whether this wire sends and receives frames in this form."""
    return wire in (WIRE_SOCKETCAN, WIRE_PYTHON_CAN)


@jit
def encode_frame(bus: Bus, frame_id: int, kind: int, length: int, data: int) -> bool:
    """Append a frame to the transmit buffer; `data` holds the bytes, the first lowest. False if the buffer is full.

    `kind` is bits of `rtloop.memory.frame_words`.
    """
    tx = bus.outgoing.bytes
    at = bus.outgoing.length
    if at + CAN_FRAME_BYTES > TX_BYTES:
        return False
    word = frame_id | EXTENDED_FLAG if kind & EXTENDED else frame_id
    held = length
    if kind & REMOTE:
        word |= REMOTE_FLAG
        held = 0
    for i in range(_LENGTH_AT):
        tx[at + i] = (word >> (8 * i)) & 255
    for i in range(_LENGTH_AT, _DATA_AT):
        tx[at + i] = 0
    tx[at + _LENGTH_AT] = length
    for i in range(LONGEST_DATA):
        tx[at + _DATA_AT + i] = (data >> (8 * i)) & 255 if i < held else 0
    bus.outgoing.length = at + CAN_FRAME_BYTES
    return True


@jit
def mark(bus: Bus, marks: int, made_ms: int) -> None:
    """Write `marks` and the time of the cycle (ms, 16 bits) into the unused bytes of the last frame in the buffer.

    They are for `rtloop.wire.bridge`, which drops set-points that are too old.
    """
    at = bus.outgoing.length - CAN_FRAME_BYTES
    bus.outgoing.bytes[at + _MARKS_AT] = marks
    bus.outgoing.bytes[at + _MADE_AT] = made_ms & 255
    bus.outgoing.bytes[at + _MADE_AT + 1] = (made_ms >> 8) & 255


@jit
def decode_record(bus: Bus, at: int) -> tuple[int, int, int, int, int]:
    """(RECORD_…, id, kind, length, data) of the record at byte `at` of the receive ring.

    The ring holds whole records and is a whole number of them long, so no record wraps around its end. The id of an
    error frame is its class. Remote frames are ignored.
    """
    ring = bus.received.bytes
    start = at & (RX_BYTES - 1)
    word = 0
    for i in range(_LENGTH_AT):
        word |= int(ring[start + i]) << (8 * i)
    length = int(ring[start + _LENGTH_AT])
    if length > LONGEST_DATA:
        return RECORD_WRONG, 0, 0, 0, 0
    data = 0
    for i in range(length):
        data |= int(ring[start + _DATA_AT + i]) << (8 * i)
    if word & ERROR_FLAG:
        return RECORD_ERROR, word & EXTENDED_MASK, 0, length, data
    if word & REMOTE_FLAG:
        return RECORD_OTHER, 0, 0, 0, 0
    if word & EXTENDED_FLAG:
        return RECORD_FRAME, word & EXTENDED_MASK, EXTENDED, length, data
    if word > STANDARD_MASK:
        return RECORD_WRONG, 0, 0, 0, 0
    return RECORD_FRAME, word, STANDARD, length, data


@jit
def next_frame(bus: Bus, shared: StateFile, end: int) -> tuple[int, int, int, int, int]:
    """(FRAME or CONTROLLER_ERROR, id, kind, length, data) of the next one in the receive ring up to `end`, or NOTHING.

    The records up to it are consumed; invalid ones are counted as wire errors.
    """
    parser = bus.parser
    while parser.bytes_taken < end:
        record, frame_id, kind, length, data = decode_record(bus, parser.bytes_taken)
        parser.bytes_taken += CAN_FRAME_BYTES
        if record == RECORD_FRAME:
            return FRAME, frame_id, kind, length, data
        if record == RECORD_ERROR:
            return CONTROLLER_ERROR, frame_id, kind, length, data
        if record == RECORD_WRONG:
            count_wire_error(shared, bus)
    return NOTHING, 0, 0, 0, 0
