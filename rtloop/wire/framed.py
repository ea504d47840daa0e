"""What adapters with binary frames have in common: bytes are collected until a frame can be judged.

Nothing is escaped in such frames, so one is parsed by its length and believed for its trailer. What is none loses its
first byte, and the rest is looked at again from the next byte that could begin one: a frame that was cut, or a byte too
many, costs that frame alone. Loss is counted once until the next sound frame, however many bytes it takes.
"""

from compilation.jit import jit
from rtloop.memory.link import RX_BYTES
from rtloop.memory.state import Loop

MORE = 0
SOUND = 1
OTHER = 2
WRONG = 3


@jit
def collect(loop: Loop, end: int) -> bool:
    """Take bytes of the receive ring up to `end`; True when there are enough to look at (`wait_for` says how many)."""
    parser, ring, line = loop.parser, loop.received.bytes, loop.parser.line
    needed = max(parser.line_needed, 1)
    have, at = parser.line_length, parser.bytes_taken
    while have < needed and at < end:
        line[have] = ring[at & (RX_BYTES - 1)]
        have += 1
        at += 1
    parser.line_length, parser.bytes_taken = have, at
    return bool(have >= needed)


@jit
def wait_for(loop: Loop, count: int) -> int:
    """No look before so many bytes are there, LINE_BYTES at most."""
    loop.parser.line_needed = count
    return MORE


@jit
def take_out(loop: Loop, count: int, shortest: int) -> None:
    """Forget the first bytes; the next frame has `shortest` bytes at the least."""
    parser, line = loop.parser, loop.parser.line
    left = parser.line_length - count
    for i in range(left):
        line[i] = line[count + i]
    parser.line_length = left
    parser.line_needed = shortest


@jit
def found_sound(loop: Loop, count: int, shortest: int) -> None:
    """The first bytes were a frame."""
    take_out(loop, count, shortest)
    loop.parser.line_spoilt = 0


@jit
def resynchronise(loop: Loop, start: int, shortest: int) -> int:
    """The first byte begins no frame: forget it, and all up to the next `start`. WRONG the first time, then OTHER."""
    parser, line = loop.parser, loop.parser.line
    at = 1
    while at < parser.line_length and line[at] != start:
        at += 1
    take_out(loop, at, shortest)
    before = parser.line_spoilt
    parser.line_spoilt = 1
    return OTHER if before == 1 else WRONG
