"""The snapshot's seqlock and CRC, for jitted code."""

import numpy as np

from compilation.jit import jit
from shm.atomics import fence_acquire, fence_release, load_relaxed, store_relaxed


def _slicing_table() -> np.ndarray:
    """Table for CRC-32 (polynomial 0xEDB88320, as zlib) of a 64-bit word by its half bytes, shape (16, 16).

    Row k says what the word's k-th half byte, the lowest first, does to the sum. A table of whole bytes would take
    eight times the memory for half the look-ups, and after a sleep the cache lines are what costs. The entries are half
    as wide as jitted code's words; the sign bit goes once they are summed up.
    """
    table = np.zeros((16, 16), np.int64)
    for k in range(15, -1, -1):
        for value in range(16):
            crc = value if k == 15 else table[k + 1, value]
            for _ in range(4):
                crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
            table[k, value] = crc
    return table.astype(np.uint32).view(np.int32)


_TABLE = _slicing_table()

READ_TRIES = 1000


@jit
def crc32_at(address: int, words: int, before: int = 0) -> int:
    """CRC-32 of the given number of 64-bit words at an address; equal to zlib.crc32 of the same bytes.

    `before` is the CRC of what stands before them.
    """
    crc = before ^ 0xFFFFFFFF
    for i in range(words):
        word = load_relaxed(address + 8 * i) ^ crc
        crc = 0
        for k in range(15, -1, -1):  # the upper half first, which need not wait for the word before
            crc ^= int(_TABLE[k, (word >> (4 * k)) & 15])
        crc &= 0xFFFFFFFF
    return crc ^ 0xFFFFFFFF


@jit
def copy_words(target_address: int, source_address: int, words: int) -> None:
    """Copy words that another process may be changing; the caller judges the copy by its CRC."""
    for i in range(words):
        store_relaxed(target_address + 8 * i, load_relaxed(source_address + 8 * i))


@jit
def publish(sequence_address: int, target_address: int, source_address: int, words: int, standing: int = 0) -> None:
    """Write a snapshot under the seqlock. One writer only; allocates nothing, waits for nobody.

    So many `standing` words behind the first, which is the CRC, are known to be there already and are left alone.
    """
    sequence = load_relaxed(sequence_address)
    store_relaxed(sequence_address, sequence + 1)
    # pairs with the second fence of `read`: whoever read a new word sees at least the odd count
    fence_release()
    copy_words(target_address, source_address, 1)
    skipped = 1 + standing
    copy_words(target_address + 8 * skipped, source_address + 8 * skipped, words - skipped)
    # pairs with the first fence of `read`: whoever read the even count sees all its words; `StateReader` has the CRC
    fence_release()
    store_relaxed(sequence_address, sequence + 2)


@jit
def read(sequence_address: int, source_address: int, target_address: int, words: int) -> bool:
    """Copy a consistent snapshot; False after a bounded number of tries."""
    for _ in range(READ_TRIES):
        before = load_relaxed(sequence_address)
        # pairs with the second fence of `publish`
        fence_acquire()
        if before & 1 == 0:
            copy_words(target_address, source_address, words)
            # pairs with the first fence of `publish`
            fence_acquire()
            if load_relaxed(sequence_address) == before:
                return True
    return False
