"""What adapters with binary frames have in common: bytes are collected until a frame can be judged.

Nothing is escaped in such frames, so a frame is parsed by its length and accepted for its trailer. If the bytes are no
frame, the first is dropped, and parsing resumes at the next byte that could begin a frame: a truncated frame, or a
surplus byte, costs that frame alone. A loss counts once until the next sound frame, however many bytes it takes.
"""

from compilation.jit import jit
from rtloop.memory.link import RX_BYTES, Bus

MORE = 0
SOUND = 1
OTHER = 2
WRONG = 3


@jit
def collect(bus: Bus, end: int) -> bool:
    """Move bytes from the receive ring up to `end` into the line; True once there are as many as `wait_for` has set."""
    parser, ring, line = bus.parser, bus.received.bytes, bus.parser.line
    needed = max(parser.line_needed, 1)
    have, at = parser.line_length, parser.bytes_taken
    while have < needed and at < end:
        line[have] = ring[at & (RX_BYTES - 1)]
        have += 1
        at += 1
    parser.line_length, parser.bytes_taken = have, at
    return bool(have >= needed)


@jit
def wait_for(bus: Bus, count: int) -> int:
    """Set how many bytes must be collected before the next attempt to parse, LINE_BYTES at most; MORE."""
    bus.parser.line_needed = count
    return MORE


@jit
def take_out(bus: Bus, count: int, shortest: int) -> None:
    """Remove the first `count` bytes of the line; the next frame has at least `shortest` bytes."""
    parser, line = bus.parser, bus.parser.line
    left = parser.line_length - count
    for i in range(left):
        line[i] = line[count + i]
    parser.line_length = left
    parser.line_needed = shortest


@jit
def found_sound(bus: Bus, count: int, shortest: int) -> None:
    """Remove the first `count` bytes of the line, which were a sound frame."""
    take_out(bus, count, shortest)
    bus.parser.line_spoilt = 0


@jit
def resynchronise(bus: Bus, start: int, shortest: int) -> int:
    """Remove the first byte, which begins no frame, and all up to the next `start`.

    WRONG the first time since a sound frame, then OTHER.
    """
    parser, line = bus.parser, bus.parser.line
    at = 1
    while at < parser.line_length and line[at] != start:
        at += 1
    take_out(bus, at, shortest)
    before = parser.line_spoilt
    parser.line_spoilt = 1
    return OTHER if before == 1 else WRONG
