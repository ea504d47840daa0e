"""SLCAN (LAWICEL) lines to and from CAN frames, in the cycle.

`T` + 8 hex digits of id + length digit + data (extended), `t` + 3 digits (standard), `R` and `r` the same without data
(remote frames); every line ends with CR; BEL (07) is the adapter's refusal. Transmit answers (`z`, `Z`), empty lines
and anything unknown are dropped: adapters differ in what they answer, so nothing here waits for an answer. A time stamp
after the data (`Z1`, `Z2`) is ignored, because the length digit says where the data end.
"""

from string import hexdigits

import numpy as np

from compilation.jit import jit
from rtloop.memory.frame_words import EXTENDED, REMOTE, STANDARD
from rtloop.memory.link import LINE_BYTES, RX_BYTES, SLCAN_LONGEST_LINE, TX_BYTES, Bus
from rtloop.wire.counted import count_wire_error
from rtloop.wire.found import FRAME, NOTHING
from shm.layout import StateFile

CR = 13
BEL = 7
_T_EXTENDED = ord("T")
_T_STANDARD = ord("t")
_R_EXTENDED = ord("R")
_R_STANDARD = ord("r")
_HEX_VALUES = np.array([int(chr(code), 16) if chr(code) in hexdigits else -1 for code in range(256)], np.int8)
"""A table without branches, because no branch predictor can guess whether the next digit is a letter."""


@jit
def hex_digit(value: int) -> int:
    """ASCII code of a nibble, upper case."""
    return 48 + value if value < 10 else 55 + value


@jit
def hex_value(code: int) -> int:
    """Value of an ASCII hex digit of either case, -1 for anything else."""
    return int(_HEX_VALUES[code])


@jit
def encode_frame(bus: Bus, frame_id: int, kind: int, length: int, data: int) -> bool:
    """Append a frame to the transmit buffer; `data` holds the bytes, the first lowest. False if the buffer is full.

    `kind` is bits of `rtloop.memory.frame_words`.
    """
    tx = bus.outgoing.bytes
    at = bus.outgoing.length
    if at + SLCAN_LONGEST_LINE > TX_BYTES:
        return False
    digits = 8 if kind & EXTENDED else 3
    if kind & REMOTE:
        tx[at] = _R_EXTENDED if kind & EXTENDED else _R_STANDARD
    else:
        tx[at] = _T_EXTENDED if kind & EXTENDED else _T_STANDARD
    at += 1
    for i in range(digits):
        tx[at] = hex_digit((frame_id >> (4 * (digits - 1 - i))) & 15)
        at += 1
    tx[at] = 48 + length
    at += 1
    for i in range(0 if kind & REMOTE else length):
        byte = (data >> (8 * i)) & 255
        tx[at] = hex_digit(byte >> 4)
        tx[at + 1] = hex_digit(byte & 15)
        at += 2
    tx[at] = CR
    bus.outgoing.length = at + 1
    return True


LINE_OTHER = 0
LINE_FRAME = 1
LINE_WRONG = 2


@jit
def decode_line(bus: Bus) -> tuple[int, int, int, int, int]:
    """(LINE_…, id, kind, length, data) of the line collected in `bus.parser.line`; remote frames are LINE_OTHER."""
    line, count = bus.parser.line, bus.parser.line_length
    if count == 0 or (line[0] != _T_EXTENDED and line[0] != _T_STANDARD):
        return LINE_OTHER, 0, 0, 0, 0
    kind = EXTENDED if line[0] == _T_EXTENDED else STANDARD
    digits = 8 if kind == EXTENDED else 3
    if count < digits + 2:
        return LINE_WRONG, 0, 0, 0, 0
    frame_id = 0
    for i in range(1, digits + 1):
        value = hex_value(line[i])
        if value < 0:
            return LINE_WRONG, 0, 0, 0, 0
        frame_id = (frame_id << 4) | value
    length = hex_value(line[digits + 1])
    highest_id = 0x1FFFFFFF if kind == EXTENDED else 0x7FF
    if length < 0 or length > 8 or count < digits + 2 + 2 * length or frame_id > highest_id:
        return LINE_WRONG, 0, 0, 0, 0
    data = 0
    for i in range(length):
        high = hex_value(line[digits + 2 + 2 * i])
        low = hex_value(line[digits + 3 + 2 * i])
        if high < 0 or low < 0:
            return LINE_WRONG, 0, 0, 0, 0
        data |= ((high << 4) | low) << (8 * i)
    return LINE_FRAME, frame_id, kind, length, data


@jit
def collect(bus: Bus, byte: int) -> bool:
    """Add a received byte to the line; True if it completes the line. An overlong line is marked as spoilt."""
    parser = bus.parser
    if byte == CR:
        return True
    if parser.line_length < LINE_BYTES:
        bus.parser.line[parser.line_length] = byte
        parser.line_length += 1
    else:
        parser.line_spoilt = 1
    return False


@jit
def next_frame(bus: Bus, shared: StateFile, end: int) -> tuple[int, int, int, int, int]:
    """(FRAME, id, kind, length, data) of the next data frame in the receive ring up to `end`, or NOTHING.

    The characters up to its end are consumed; refusals (BEL) and garbled lines are counted as wire errors.
    """
    parser, ring = bus.parser, bus.received.bytes
    for at in range(parser.bytes_taken, end):
        byte = ring[at & (RX_BYTES - 1)]
        if byte == BEL:
            count_wire_error(shared, bus)
            bus.quiet.adapter_words += 1
            parser.line_length = parser.line_spoilt = 0
        elif collect(bus, byte):
            line, frame_id, kind, length, data = decode_line(bus)
            if parser.line_spoilt == 1:
                line = LINE_WRONG
            parser.line_length = parser.line_spoilt = 0
            if line == LINE_FRAME:
                parser.bytes_taken = at + 1
                return FRAME, frame_id, kind, length, data
            if line == LINE_WRONG:
                count_wire_error(shared, bus)
            else:
                bus.quiet.adapter_words += 1
    parser.bytes_taken = end
    return NOTHING, 0, 0, 0, 0
