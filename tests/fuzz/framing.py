"""Frames on a serial adapter of any kind, spelt and read by the fuzzers themselves: all compiled."""

import numpy as np

from compilation.jit import jit
from rtloop.memory.link import WIRE_AT, WIRE_SEEED
from rtloop.memory.state import Loop

CR, LF = 13, 10
_HEX = np.frombuffer(b"0123456789ABCDEF", np.uint8)


@jit
def put_byte(out: np.ndarray, at: int, byte: int) -> int:
    """Append a byte; where the next one goes."""
    if at < len(out):
        out[at] = byte
        return at + 1
    return at


@jit
def put_hex(out: np.ndarray, at: int, value: int, digits: int) -> int:
    for i in range(digits):
        digit = _HEX[(value >> (4 * (digits - 1 - i))) & 15]
        if digit > 60 and np.random.random() < 0.02:
            digit += 32  # lower case, which is as good
        at = put_byte(out, at, digit)
    return at


@jit
def put_frame(loop: Loop, out: np.ndarray, at: int, frame_id: int, length: int, data: int) -> int:
    """An extended frame as the arm's adapter spells it, of any length and identifier."""
    if loop.buses[0].interface == WIRE_SEEED:
        return put_seeed(out, at, frame_id, length, data)
    if loop.buses[0].interface == WIRE_AT:
        return put_at(out, at, frame_id, length, data)
    return put_line(out, at, frame_id, length, data)


@jit
def put_line(out: np.ndarray, at: int, frame_id: int, length: int, data: int) -> int:
    at = put_byte(out, at, 84)
    at = put_hex(out, at, frame_id, 8)
    at = put_hex(out, at, length, 1)
    for i in range(min(length, 8)):
        at = put_hex(out, at, (data >> (8 * i)) & 255, 2)
    if np.random.random() < 0.05:
        at = put_hex(out, at, np.random.randint(0, 60_000), 4)  # a time stamp
    return put_byte(out, at, CR)


@jit
def put_seeed(out: np.ndarray, at: int, frame_id: int, length: int, data: int) -> int:
    at = put_byte(out, at, 0xAA)
    at = put_byte(out, at, 0xE0 | length)
    for i in range(4):
        at = put_byte(out, at, (frame_id >> (8 * i)) & 255)
    for i in range(min(length, 8)):
        at = put_byte(out, at, (data >> (8 * i)) & 255)
    return put_byte(out, at, 0x55)


@jit
def put_at(out: np.ndarray, at: int, frame_id: int, length: int, data: int) -> int:
    at = put_byte(out, put_byte(out, at, 0x41), 0x54)
    word = frame_id << 3 | 4
    for i in range(4):
        at = put_byte(out, at, (word >> (8 * (3 - i))) & 255)
    at = put_byte(out, at, length)
    for i in range(min(length, 8)):
        at = put_byte(out, at, (data >> (8 * i)) & 255)
    return put_byte(out, put_byte(out, at, CR), LF)


@jit
def hex_at(tx: np.ndarray, at: int, digits: int) -> int:
    """A number in upper-case digits, -1 if it is none."""
    value = 0
    for i in range(at, at + digits):
        code = tx[i]
        if 48 <= code <= 57:
            value = (value << 4) | (code - 48)
        elif 65 <= code <= 70:
            value = (value << 4) | (code - 55)
        else:
            return -1
    return value


@jit
def read_frame(loop: Loop, at: int, count: int) -> tuple[int, int, int]:
    """The frame that is sent at a byte of the transmit buffer: where the next one begins, identifier, data.

    -1 for what is no extended data frame, or is not whole within `count` bytes.
    """
    if loop.buses[0].interface == WIRE_SEEED:
        return read_seeed(loop.buses[0].outgoing.bytes, at, count)
    if loop.buses[0].interface == WIRE_AT:
        return read_at(loop.buses[0].outgoing.bytes, at, count)
    return read_line(loop.buses[0].outgoing.bytes, at, count)


@jit
def read_line(tx: np.ndarray, at: int, count: int) -> tuple[int, int, int]:
    if tx[at] != 84 or at + 10 > count:
        return -1, 0, 0
    frame_id, length = hex_at(tx, at + 1, 8), tx[at + 9] - 48
    if frame_id < 0 or length < 0 or length > 8 or at + 10 + 2 * length >= count or tx[at + 10 + 2 * length] != CR:
        return -1, 0, 0
    data = 0
    for i in range(length):
        byte = hex_at(tx, at + 10 + 2 * i, 2)
        if byte < 0:
            return -1, 0, 0
        data |= byte << (8 * i)
    return at + 11 + 2 * length, frame_id, data


@jit
def read_seeed(tx: np.ndarray, at: int, count: int) -> tuple[int, int, int]:
    length = tx[at + 1] - 0xE0
    end = at + 6 + length
    if tx[at] != 0xAA or length < 0 or length > 8 or end >= count or tx[end] != 0x55:
        return -1, 0, 0
    frame_id = data = 0
    for i in range(4):
        frame_id |= int(tx[at + 2 + i]) << (8 * i)
    for i in range(length):
        data |= int(tx[at + 6 + i]) << (8 * i)
    return end + 1, frame_id, data


@jit
def read_at(tx: np.ndarray, at: int, count: int) -> tuple[int, int, int]:
    length = tx[at + 6]
    end = at + 7 + length
    if tx[at] != 0x41 or tx[at + 1] != 0x54 or length > 8 or end + 1 >= count or tx[end] != CR or tx[end + 1] != LF:
        return -1, 0, 0
    word = data = 0
    for i in range(4):
        word = word << 8 | int(tx[at + 2 + i])
    for i in range(length):
        data |= int(tx[at + 7 + i]) << (8 * i)
    return (end + 2, word >> 3, data) if word & 7 == 4 else (-1, 0, 0)
