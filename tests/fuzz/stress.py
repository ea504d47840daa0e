"""Two threads on one piece of memory, with the product's own functions, as often as one likes.

    PYTHONPATH=tests python -m fuzz.stress --operations 1000000000

An operation is one complete snapshot written or read, or one record put into or taken out of a ring; tries that found
nothing new are not counted. Both sides run compiled, without the GIL, in threads of one process, which share memory as
two processes do.
"""

import argparse
import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from compilation.jit import jit
from config.loader import load_arm
from rtloop.memory.events import record_event
from rtloop.memory.link import RX_BYTES, RX_CHUNKS, SERVICE_SLOTS, Bus
from rtloop.memory.state import Loop
from rtloop.process.initial_state import new_loop
from rtloop.service import rings
from rtloop.service.port import IN, TAKEN, WRITTEN
from rtloop.wire import received
from shm import layout
from shm.atomics import load_acquire, load_relaxed, store_relaxed, store_release
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words, publish, read

_EVENTS_WRITTEN = offset_of(layout.StateFile, "events_written")
_EVENTS = offset_of(layout.StateFile, "events")
_EVENT_BYTES = layout.Event.dtype.itemsize
MOST_EVENTS_BEHIND = layout.EVENT_SLOTS - 8


@jit
def fill(source: int, words: int, number: int) -> None:
    """A snapshot every word of which is a function of its number and its place."""
    for word in range(1, words):
        store_relaxed(source + 8 * word, number * 31 + word)
    store_relaxed(source, number)


@jit
def write_snapshots(table: int, shared: int, source: int, words: int) -> int:
    """Publish until told to stop; how many snapshots."""
    number = 0
    while load_relaxed(table) == 0:
        number += 1
        fill(source, words, number)
        publish(shared, shared + 128, source, words)
    return number


@jit
def read_snapshots(table: int, shared: int, target: int, words: int, count: int) -> int:
    """Read `count` complete snapshots; how many of them were torn or older than the one before."""
    wrong = last = done = 0
    while done < count:
        if not read(shared, shared + 128, target, words):
            continue
        number = load_relaxed(target)
        if number == 0:
            continue  # the other thread has not begun
        whole = number >= last
        for word in range(1, words):
            whole = whole and load_relaxed(target + 8 * word) == number * 31 + word
        wrong += 0 if whole else 1
        last = number
        done += 1
    store_relaxed(table, 1)
    return wrong


@jit
def push_bytes(table: int, loop: Loop, source: np.ndarray) -> int:
    """Push chunks of a known sequence of bytes until told to stop; how many bytes went in."""
    base = loop.params.address
    at, size, chunks = 0, 1, 0
    while load_relaxed(table) == 0:
        taken = load_acquire(base + _TAKEN_BYTES)
        room = RX_CHUNKS - (chunks - load_acquire(base + _TAKEN_CHUNKS))
        size = size % 61 + 1
        if at + size - taken > RX_BYTES or room <= 0:
            continue  # it would be dropped, and the sequence with it
        for i in range(size):
            source[i] = ((at + i) * 7) & 255
        received.push(loop.buses[0], at, source, size)
        at += size
        chunks += 1
    return at


_TAKEN_BYTES = offset_of(Loop, "buses") + offset_of(Bus, "received", "taken", "bytes")
_TAKEN_CHUNKS = offset_of(Loop, "buses") + offset_of(Bus, "received", "taken", "chunks")


@jit
def take_bytes(table: int, loop: Loop, count: int) -> int:
    """Take `count` chunks as the cycle does; how many bytes and stamps were wrong."""
    wrong = done = at = 0
    while done < count:
        chunks = received.chunks_arrived(loop.buses[0])
        while done < chunks:
            chunk = loop.buses[0].received.chunks[done & (RX_CHUNKS - 1)]
            wrong += 0 if chunk.time_ns == at else 1
            for i in range(at, chunk.end):
                wrong += 0 if loop.buses[0].received.bytes[i & (RX_BYTES - 1)] == (i * 7) & 255 else 1
            at = chunk.end
            done += 1
        received.taken(loop.buses[0], at, done)
    store_relaxed(table, 1)
    return wrong


@jit
def post_orders(table: int, loop: Loop) -> int:
    """What ServicePort.post does, until told to stop."""
    base, number = loop.params.address + IN, 0
    while load_relaxed(table) == 0:
        if number - load_acquire(base + TAKEN) >= SERVICE_SLOTS:
            continue
        record = loop.service_in.records[number & (SERVICE_SLOTS - 1)]
        record.kind = number
        record.id = number * 3
        record.payload = number * 5
        record.code = number * 7
        number += 1
        store_release(base + WRITTEN, number)
    return number


@jit
def obey_orders(table: int, loop: Loop, count: int) -> int:
    """Take `count` orders as the cycle does; how many were wrong."""
    wrong = done = 0
    while done < count:
        if rings.inbox(loop) > 0:
            order = loop.service_in.records[rings.inbox_slot(loop)]
            right = order.kind == done and order.id == done * 3 and order.payload == done * 5 and order.code == done * 7
            wrong += 0 if right else 1
            rings.inbox_done(loop)
            done += 1
    store_relaxed(table, 1)
    return wrong


@jit
def write_events(table: int, loop: Loop, shared: StateFile) -> int:
    """Record events until told to stop; how many."""
    number = 0
    while load_relaxed(table) == 0:
        record_event(loop, shared, number, number, number, 0.0, 0.0)
        number += 1
    return number


@jit
def read_events(table: int, state: int, count: int, target: int) -> int:
    """Read `count` events that cannot have been overwritten meanwhile; how many were torn or not the expected one."""
    wrong = done = number = 0
    words = _EVENT_BYTES // 8
    while done < count:
        written = load_acquire(state + _EVENTS_WRITTEN)
        if number >= written:
            continue
        number = max(number, written - layout.EVENT_SLOTS // 2)
        copy_words(target, state + _EVENTS + (number & (layout.EVENT_SLOTS - 1)) * _EVENT_BYTES, words)
        if load_acquire(state + _EVENTS_WRITTEN) - number < MOST_EVENTS_BEHIND:
            right = load_relaxed(target + 8) == load_relaxed(target + 24) == number
            wrong += 0 if right else 1
            done += 1
        number += 1
    store_relaxed(table, 1)
    return wrong


@jit
def seal_records(table: int, ring: int, slots: int, words: int) -> int:
    """A front's records with number and CRC, the words in any order, overwritten whether or not they were taken."""
    number = 0
    while load_relaxed(table) == 0:
        at = ring + 128 + (number % slots) * 8 * words
        for word in range(words - 1, 1, -1):
            store_relaxed(at + 8 * word, number * 31 + word)
        store_relaxed(at + 8, number)
        store_relaxed(at, crc_of(number, words))
        store_relaxed(ring, number + 1)
        number += 1
    return number


@jit
def crc_of(number: int, words: int) -> int:
    """A sum over what a record says, cheap enough to be made as often as it is looked at."""
    total = number
    for word in range(2, words):
        total = (total * 0x5DEECE66D + number * 31 + word) & 0xFFFFFFFFFFFF
    return total


@jit
def take_records(table: int, ring: int, slots: int, words: int, count: int, target: int) -> int:
    """Copy `count` records and then judge them, as `take_setpoints` does; how many believed ones were wrong."""
    wrong = done = 0
    while done < count:
        number = load_acquire(ring) - 1
        if number < 0:
            continue
        copy_words(target, ring + 128 + (number % slots) * 8 * words, words)
        said, total = load_relaxed(target + 8), load_relaxed(target + 8)
        for word in range(2, words):
            total = (total * 0x5DEECE66D + load_relaxed(target + 8 * word)) & 0xFFFFFFFFFFFF
        if total == load_relaxed(target):
            for word in range(2, words):
                if load_relaxed(target + 8 * word) != said * 31 + word:
                    wrong += 1
        done += 1
    store_relaxed(table, 1)
    return wrong


class Counted(NamedTuple):
    """What a pair of threads has done."""

    written: int
    read: int
    wrong: int


def pair(writer: Callable[[int], int], reader: Callable[[int], int], reads: int) -> Counted:
    """Run both until the reader has its `reads`; `table` is where it says so."""
    table = np.zeros(64, np.int64)
    written = [0]

    def write() -> None:
        written[0] = int(writer(table.ctypes.data))

    thread = threading.Thread(target=write)
    thread.start()
    wrong = int(reader(table.ctypes.data))
    thread.join()
    return Counted(written[0], reads, wrong)


def _aligned(words: int) -> np.ndarray:
    memory = np.zeros(words + 16, np.int64)
    return memory[(-memory.ctypes.data // 8) % 16 :][:words]


def snapshots(reads: int, words: int = 9) -> Counted:
    """The seqlock."""
    shared, source, target = _aligned(words + 32), _aligned(words), _aligned(words)
    at = [array.ctypes.data for array in (shared, source, target)]
    return pair(
        lambda table: write_snapshots(table, at[0], at[1], words),
        lambda table: read_snapshots(table, at[0], at[2], words, reads),
        reads,
    )


def chunks(reads: int) -> Counted:
    """The receive ring; written are bytes, read are chunks."""
    loop = new_loop(load_arm("mock"), 0, 0)
    source = np.zeros(64, np.uint8)
    return pair(
        lambda table: push_bytes(table, loop[0], source), lambda table: take_bytes(table, loop[0], reads), reads
    )


def orders(reads: int) -> Counted:
    """The ring through which conversations speak to the cycle."""
    loop = new_loop(load_arm("mock"), 0, 0)
    return pair(lambda table: post_orders(table, loop[0]), lambda table: obey_orders(table, loop[0], reads), reads)


def events(reads: int) -> Counted:
    """The event ring, which is overwritten from the oldest."""
    state = np.zeros(1, layout.StateFile.dtype)
    loop = new_loop(load_arm("mock"), state.ctypes.data, 0)
    target = np.zeros(16, np.int64)
    return pair(
        lambda table: write_events(table, loop[0], state[0]),
        lambda table: read_events(table, state.ctypes.data, reads, target.ctypes.data),
        reads,
    )


def records(reads: int, words: int = 8, slots: int = 4) -> Counted:
    """Records without any order but with a sum, which are overwritten while they are copied."""
    ring, target = _aligned(slots * words + 32), _aligned(words)
    at = [array.ctypes.data for array in (ring, target)]
    return pair(
        lambda table: seal_records(table, at[0], slots, words),
        lambda table: take_records(table, at[0], slots, words, reads, at[1]),
        reads,
    )


SCENARIOS: dict[str, tuple[Callable[[int], Counted], float]] = {
    "snapshots": (snapshots, 0.6),
    "orders": (orders, 0.004),
    "records": (records, 0.4),
    "events": (events, 0.2),
    "chunks": (chunks, 0.002),
}
"""By name, with what each gets of the operations asked for; the rings in which one waits for the other are slow."""


def main() -> int:
    """Run until that many operations are counted; 1 when anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.stress", description=__doc__.splitlines()[0])
    parser.add_argument("--operations", type=int, default=1_000_000_000)
    given = parser.parse_args()
    total, wrong = 0, 0
    for name, (scenario, share) in SCENARIOS.items():
        scenario(100)  # whatever is still to be compiled
        written = seen = mistakes = 0
        begun = time.monotonic()
        while written + seen < share * given.operations:
            counted = scenario(max(1000, int(share * given.operations) // 20))
            written, seen, mistakes = written + counted.written, seen + counted.read, mistakes + counted.wrong
        spent_s = time.monotonic() - begun
        print(f"{name:10} {written:14,} written {seen:14,} read {mistakes:4} wrong {spent_s:6.0f} s", flush=True)
        total, wrong = total + written + seen, wrong + mistakes
    print(f"{'in all':10} {total:14,} operations, {wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
