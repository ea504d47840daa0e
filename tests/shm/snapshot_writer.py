"""A process that publishes snapshots as fast as it can, for the stress of `test_seqlock.py`.

`python snapshot_writer.py ARM forever|killed-in-mid-write`: prints "ready" when it writes, or when it has
begun a snapshot that it will never finish.
"""

import os
import signal
import sys
import threading

import numpy as np

from compilation.jit import jit
from shm import files, layout
from shm.atomics import fence_release, load_relaxed, store_relaxed
from shm.record import offset_of
from shm.seqlock import copy_words, crc32_at, publish

JOINTS = 6
WORDS = layout.used_bytes(layout.Snapshot, JOINTS) // 8
SEQUENCE = offset_of(layout.StateFile, "snapshot_sequence")
SNAPSHOT = offset_of(layout.StateFile, "snapshot")


@jit
def fill(source: int, words: int, number: int) -> None:
    """A snapshot all of whose words are `number`, with its CRC."""
    for word in range(1, words):
        store_relaxed(source + 8 * word, number)
    store_relaxed(source, crc32_at(source + 8, words - 1))


@jit
def publish_without_end(sequence: int, target: int, source: int, words: int) -> None:
    number = 1
    while True:
        fill(source, words, number)
        publish(sequence, target, source, words)
        number += 1


@jit
def publish_half(sequence: int, target: int, source: int, words: int) -> None:
    """What is there when the writer dies amid a snapshot."""
    fill(source, words, 2)
    store_relaxed(sequence, load_relaxed(sequence) + 1)
    fence_release()
    copy_words(target, source, words // 2)


def main(arm: str, behaviour: str) -> None:
    pair = files.create(files.Identity(arm, tuple("abcdef"), 1, 10_000_000))
    scratch = np.zeros(WORDS, np.int64)
    sequence, target, source = (
        pair.state.address + SEQUENCE,
        pair.state.address + SNAPSHOT,
        scratch.ctypes.data,
    )
    fill(source, WORDS, 1)
    publish(sequence, target, source, WORDS)
    if behaviour == "forever":
        threading.Thread(target=publish_without_end, args=(sequence, target, source, WORDS), daemon=True).start()
    else:
        publish_half(sequence, target, source, WORDS)
    print("ready", flush=True)
    sys.stdin.readline()
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    main(*sys.argv[1:])
