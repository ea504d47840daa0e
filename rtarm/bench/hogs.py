"""`python -m rtarm.bench.hogs cpu|memory|disk FOLDER`: one greedy process, where stress-ng is not installed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

MEMORY_BYTES = 64 << 20
FILE_BYTES = 16 << 20
CHUNK = bytes(1 << 20)


def cpu() -> None:
    """Compute without end."""
    number = 1
    while True:
        number = (number * 1_103_515_245 + 12_345) & 0x7FFFFFFF


def memory() -> None:
    """Copy more than any cache holds, back and forth."""
    there, here = np.zeros(MEMORY_BYTES, np.uint8), np.ones(MEMORY_BYTES, np.uint8)
    while True:
        there[:] = here
        here[:] = there[::-1]


def disk(folder: Path) -> None:
    """Write a file again and again, and wait each time until it is on the disk."""
    path = folder / f"hog.{os.getpid()}"
    while True:
        with open(path, "wb") as file:
            for _ in range(FILE_BYTES // len(CHUNK)):
                file.write(CHUNK)
            os.fsync(file.fileno())


def main() -> None:
    """Never returns; SIGTERM ends it."""
    kind, folder = sys.argv[1], Path(sys.argv[2])
    print("ready", flush=True)
    match kind:
        case "cpu":
            cpu()
        case "memory":
            memory()
        case _:
            disk(folder)


if __name__ == "__main__":
    main()
