"""The ring through which bytes from the wire reach the cycle, with the time at which each chunk came.

Single producer (the reader thread, or a test), single consumer (the cycle). A full ring drops the newest
bytes and counts them; the SLCAN parser finds the next line by itself.
"""

from typing import Any

from rtloop.state import LOOP, RX_BYTES, RX_CHUNKS, offset_of
from shm.atomics import load_acquire, load_relaxed, store_release
from shm.jit import jit

Loop = Any

_BASE = offset_of(LOOP, "received")
_WRITTEN = _BASE + offset_of(LOOP["received"], "written")
_CHUNKS_WRITTEN = _BASE + offset_of(LOOP["received"], "chunks_written")
_TAKEN = _BASE + offset_of(LOOP["received"], "taken")
_LOST = _BASE + offset_of(LOOP["received"], "lost")
_CLOSED = _BASE + offset_of(LOOP["received"], "closed")


@jit
def push(loop: Loop, time_ns: int, source: Any, count: int) -> None:
    """Producer: append `count` bytes of the uint8 array `source`, received at time_ns."""
    base = loop.params.address
    written = load_relaxed(base + _WRITTEN)
    chunks = load_relaxed(base + _CHUNKS_WRITTEN)
    room = RX_BYTES - (written - load_acquire(base + _TAKEN))
    taken_chunks = loop.core.rx_chunks_taken  # only ever grows, so an old value is on the safe side
    if chunks - taken_chunks >= RX_CHUNKS - 1:
        room = 0
    kept = min(count, room)
    ring = loop.received.bytes
    for i in range(kept):
        ring[(written + i) & (RX_BYTES - 1)] = source[i]
    if kept < count:
        store_release(base + _LOST, load_relaxed(base + _LOST) + count - kept)
    if kept > 0:
        loop.received.chunk_time_ns[chunks & (RX_CHUNKS - 1)] = time_ns
        loop.received.chunk_end[chunks & (RX_CHUNKS - 1)] = written + kept
        store_release(base + _WRITTEN, written + kept)
        store_release(base + _CHUNKS_WRITTEN, chunks + 1)


@jit
def close(loop: Loop, error: int) -> None:
    """Producer: the wire is gone; `error` is the errno."""
    store_release(loop.params.address + _CLOSED, error + 1)


@jit
def chunks_waiting(loop: Loop) -> int:
    """Consumer: number of chunks ever written (compare with core.rx_chunks_taken)."""
    return load_acquire(loop.params.address + _CHUNKS_WRITTEN)


@jit
def taken(loop: Loop, count: int) -> None:
    """Consumer: bytes up to `count` may be overwritten."""
    store_release(loop.params.address + _TAKEN, count)


@jit
def lost(loop: Loop) -> int:
    return load_acquire(loop.params.address + _LOST)


@jit
def closed(loop: Loop) -> int:
    """errno + 1 once the wire is gone, else 0."""
    return load_acquire(loop.params.address + _CLOSED)
