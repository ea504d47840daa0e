"""The snapshot's seqlock and CRC, for jitted code."""

import numpy as np

from shm.atomics import fence_acquire, fence_release, load_relaxed, store_relaxed
from shm.jit import jit


def _slicing_tables() -> np.ndarray:
    """Tables for CRC-32 (polynomial 0xEDB88320, as zlib) over eight bytes at a time, shape (8, 256)."""
    first = np.zeros(256, np.int64)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
        first[byte] = crc
    tables = np.zeros((8, 256), np.int64)
    tables[0] = first
    for k in range(1, 8):
        tables[k] = (tables[k - 1] >> 8) ^ first[tables[k - 1] & 255]
    return tables


_TABLES = _slicing_tables()

READ_TRIES = 1000


@jit
def crc32_at(address: int, words: int) -> int:
    """CRC-32 of the given number of 64-bit words at an address; equal to zlib.crc32 of the same bytes."""
    crc = 0xFFFFFFFF
    for i in range(words):
        word = load_relaxed(address + 8 * i)
        low = (word & 0xFFFFFFFF) ^ crc
        high = (word >> 32) & 0xFFFFFFFF
        crc = (
            _TABLES[7, low & 255]
            ^ _TABLES[6, (low >> 8) & 255]
            ^ _TABLES[5, (low >> 16) & 255]
            ^ _TABLES[4, (low >> 24) & 255]
            ^ _TABLES[3, high & 255]
            ^ _TABLES[2, (high >> 8) & 255]
            ^ _TABLES[1, (high >> 16) & 255]
            ^ _TABLES[0, (high >> 24) & 255]
        )
    return crc ^ 0xFFFFFFFF


@jit
def copy_words(target_address: int, source_address: int, words: int) -> None:
    """Copy words that another process may be changing; the caller judges the copy by its CRC."""
    for i in range(words):
        store_relaxed(target_address + 8 * i, load_relaxed(source_address + 8 * i))


@jit
def publish(sequence_address: int, target_address: int, source_address: int, words: int) -> None:
    """Write a snapshot under the seqlock. One writer only; allocates nothing, waits for nobody."""
    sequence = load_relaxed(sequence_address)
    store_relaxed(sequence_address, sequence + 1)
    fence_release()
    copy_words(target_address, source_address, words)
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
