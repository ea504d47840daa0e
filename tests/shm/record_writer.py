"""A process that records cycles and frames as fast as it can, for the stress of `test_recording.py`.

`python record_writer.py ARM`: prints "ready" when it writes. All words of a record that it can choose are the record's
own number.
"""

import sys
import threading
from typing import Any

from compilation.jit import jit
from config.loader import load_arm
from rtloop.memory.recorder import record_cycle, record_frame
from rtloop.memory.state import Loop
from rtloop.process.initial_state import new_loop
from shm import files, layout
from shm.atomics import store_relaxed
from shm.record import offset_of
from shm.seqlock import crc32_at

PERIOD_NS = 200_000_000
"""So long that the rings are small and soon full."""
SNAPSHOT = offset_of(Loop, "snapshot")
DECISIONS = offset_of(layout.Snapshot, "cycle") - 8


@jit
def record_one(loop: Any, shared: Any, number: int, words: int) -> None:
    """A cycle all of whose snapshot's words are `number`, with the CRCs that `show` would give it, and a frame."""
    source = loop.params.address + SNAPSHOT
    for word in range(1, words):
        store_relaxed(source + 8 * word, number)
    loop.published.decisions_crc = crc32_at(source + 8, DECISIONS // 8)
    loop.snapshot.crc = crc32_at(source + 8, words - 1)
    loop.timing.lateness_ns = loop.timing.cycle_time_ns = number
    record_cycle(loop, shared)
    record_frame(loop, shared, 0, number, number & 0x1FFFFFFF, 0, number & 7, number)


@jit
def record_without_end(loop: Any, shared: Any, words: int) -> None:
    number = 0
    while True:
        record_one(loop, shared, number, words)
        number += 1


def main(arm_name: str) -> None:
    arm = load_arm("mock")
    identity = files.Identity(
        arm_name, tuple(joint.name for joint in arm.joints), 1, PERIOD_NS, (files.Bus("", 500_000),)
    )
    pair = files.create(identity)
    loop = new_loop(arm, pair.state.address, pair.command.address)
    words = layout.used_bytes(layout.Snapshot, len(arm.joints)) // 8
    record_one(loop[0], pair.state.array[0], 0, words)  # compiled before it is said to be ready
    pair.state.record["records_written"][0] = pair.state.record["frames_written"][0] = 0
    arguments = (loop[0], pair.state.array[0], words)
    threading.Thread(target=record_without_end, args=arguments, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.readline()


if __name__ == "__main__":
    main(*sys.argv[1:])
