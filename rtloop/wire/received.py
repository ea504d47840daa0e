"""The ring through which bytes from the wire reach the cycle, with the time at which each chunk arrived.

Single producer (the reader thread, or a test), single consumer (the cycle). A full ring drops the newest
bytes and counts them; the SLCAN parser finds the next line by itself, and CAN frames come and go whole.
"""

from typing import Any

from compilation.jit import jit
from rtloop.memory.link import RX_BYTES, RX_CHUNKS, Bus
from shm.atomics import load_acquire, load_relaxed, store_relaxed, store_release
from shm.record import offset_of

_ARRIVED = offset_of(Bus, "received", "arrived", "bytes")
_CHUNKS_ARRIVED = offset_of(Bus, "received", "arrived", "chunks")
_LOST = offset_of(Bus, "received", "arrived", "lost")
_DROPPED = offset_of(Bus, "received", "arrived", "dropped")
_UNSENT = offset_of(Bus, "received", "arrived", "unsent")
_WOKE = offset_of(Bus, "received", "arrived", "woke_ns")
_CLOSED = offset_of(Bus, "received", "arrived", "closed")
_TAKEN = offset_of(Bus, "received", "taken", "bytes")
_CHUNKS_TAKEN = offset_of(Bus, "received", "taken", "chunks")


@jit
def push(bus: Bus, time_ns: int, source: Any, count: int) -> None:
    """Producer: append `count` bytes of the uint8 array `source`, received at `time_ns`."""
    base = bus.address
    written = load_relaxed(base + _ARRIVED)
    chunks = load_relaxed(base + _CHUNKS_ARRIVED)
    # pairs with `taken`: bytes are overwritten after they were read
    room = RX_BYTES - (written - load_acquire(base + _TAKEN))
    # pairs with `taken`
    if chunks - load_acquire(base + _CHUNKS_TAKEN) >= RX_CHUNKS:
        room = 0
    kept = min(count, room)
    ring = bus.received.bytes
    for i in range(kept):
        ring[(written + i) & (RX_BYTES - 1)] = source[i]
    if kept < count:
        # pairs with `lost`; a count alone
        store_release(base + _LOST, load_relaxed(base + _LOST) + count - kept)
    if kept > 0:
        chunk = bus.received.chunks[chunks & (RX_CHUNKS - 1)]
        chunk.time_ns = time_ns
        chunk.end = written + kept
        store_relaxed(base + _ARRIVED, written + kept)  # for the producer alone
        # pairs with `chunks_arrived`: bytes and their time are there before they are counted
        store_release(base + _CHUNKS_ARRIVED, chunks + 1)


@jit
def close(bus: Bus, error: int) -> None:
    """Producer: the wire is gone; `error` is the errno."""
    # pairs with `closed`: what came before the end was counted before it
    store_release(bus.address + _CLOSED, error + 1)


@jit
def awake(bus: Bus, time_ns: int) -> None:
    """Producer: publish `time_ns`, at which the reader's thread went to look for bytes."""
    # pairs with `woke_ns`; a time alone
    store_release(bus.address + _WOKE, time_ns)


@jit
def woke_ns(bus: Bus) -> int:
    """Consumer: when the reader's thread last went to look for bytes, 0 if it never did."""
    # pairs with `awake`
    return load_acquire(bus.address + _WOKE)


@jit
def chunks_arrived(bus: Bus) -> int:
    """Consumer: number of chunks ever written (compare with bus.parser.chunks_taken)."""
    # pairs with `push`: bytes and their time are read after the count that announces them
    return load_acquire(bus.address + _CHUNKS_ARRIVED)


@jit
def taken(bus: Bus, count: int, chunks: int) -> None:
    """Consumer: bytes up to `count` and so many chunks may be overwritten."""
    # pairs with `push`: bytes are given back after they were read
    store_release(bus.address + _TAKEN, count)
    # pairs with `push`
    store_release(bus.address + _CHUNKS_TAKEN, chunks)


@jit
def lost(bus: Bus) -> int:
    """Bytes that found no room, here or in the system."""
    # pairs with `push`, and `store_word` of the ordinary thread; counts alone
    return load_acquire(bus.address + _LOST) + load_acquire(bus.address + _DROPPED)


@jit
def unsent(bus: Bus) -> int:
    """Bytes that the wire took and did not send after all."""
    # pairs with `store_word` of the ordinary thread; a count alone
    return load_acquire(bus.address + _UNSENT)


@jit
def closed(bus: Bus) -> int:
    """errno + 1 once the wire is gone, else 0."""
    # pairs with `close`, and `store_word` of the ordinary thread: a new descriptor is stored before this is cleared
    return load_acquire(bus.address + _CLOSED)
