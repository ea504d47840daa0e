"""The snapshot's seqlock and CRC, for jitted code."""

import numpy as np

from shm.atomics import fence_acquire, fence_release, load_relaxed, store_relaxed
from shm.jit import jit


def _slicing_tables() -> np.ndarray:
    """Tables for CRC-32 (polynomial 0xEDB88320, as zlib) over sixteen bytes at a time, shape (16, 256).

    Row k says what a byte with k more behind it does to the sum. Half as wide as the words of jitted code, so that
    they take half as many cache lines: the sign bit goes once it is summed up.
    """
    tables = np.zeros((16, 256), np.int64)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, len(tables)):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 255]
    return tables.astype(np.uint32).view(np.int32)


_TABLES = _slicing_tables()

READ_TRIES = 1000


@jit
def _of_four_bytes(word: int, row: int) -> int:
    """What the four lower bytes of a word do to the sum when `row` more stand behind the first of them."""
    return (_TABLES[row, word & 255] ^ _TABLES[row - 1, (word >> 8) & 255]) ^ (
        _TABLES[row - 2, (word >> 16) & 255] ^ _TABLES[row - 3, (word >> 24) & 255]
    )


@jit
def crc32_at(address: int, words: int, before: int = 0) -> int:
    """CRC-32 of the given number of 64-bit words at an address; equal to zlib.crc32 of the same bytes.

    `before` is the CRC of what stands before them. A step takes two words, and all but four bytes of them are
    looked up without waiting for the step before.
    """
    crc = before ^ 0xFFFFFFFF
    for i in range(0, words - 1, 2):
        first = load_relaxed(address + 8 * i)
        second = load_relaxed(address + 8 * i + 8)
        rest = _of_four_bytes(first >> 32, 11) ^ _of_four_bytes(second, 7) ^ _of_four_bytes(second >> 32, 3)
        crc = (rest ^ _of_four_bytes(first ^ crc, 15)) & 0xFFFFFFFF
    if words & 1:
        last = load_relaxed(address + 8 * words - 8)
        crc = (_of_four_bytes(last >> 32, 3) ^ _of_four_bytes(last ^ crc, 7)) & 0xFFFFFFFF
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
    fence_release()
    copy_words(target_address, source_address, 1)
    skipped = 1 + standing
    copy_words(target_address + 8 * skipped, source_address + 8 * skipped, words - skipped)
    fence_release()
    store_relaxed(sequence_address, sequence + 2)


@jit
def read(sequence_address: int, source_address: int, target_address: int, words: int) -> bool:
    """Copy a consistent snapshot; False after a bounded number of tries."""
    for _ in range(READ_TRIES):
        before = load_relaxed(sequence_address)
        fence_acquire()
        if before & 1 == 0:
            copy_words(target_address, source_address, words)
            fence_acquire()
            if load_relaxed(sequence_address) == before:
                return True
    return False
