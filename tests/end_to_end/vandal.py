"""A process of the arm's own user that writes over a live command file: `python vandal.py FILE SECONDS SEED`.

Prints "writing" when it begins. Whole runs of random bytes, words at random places, and above all the words that the
control process looks at in every cycle.
"""

import mmap
import sys
import time
from pathlib import Path

import numpy as np

from shm import layout
from shm.record import offset_of

HEADS = [
    offset_of(layout.CommandFile, name) // 8
    for name in ("heartbeat_ns", "announced_goal", "setpoints_written", "requests_written")
]


def main(path: str, seconds: str, seed: str) -> None:
    random = np.random.default_rng(int(seed))
    with Path(path).open("r+b") as file:
        words = np.frombuffer(mmap.mmap(file.fileno(), 0), np.int64)
    np.seterr(over="ignore")
    print("writing", flush=True)
    until = time.monotonic() + float(seconds)
    while time.monotonic() < until:
        at, count = int(random.integers(len(words))), int(random.choice([1, 1, 8, 104, 5000]))
        part = words[at : at + count]
        part[:] = random.integers(-(2**63), 2**63 - 1, len(part))
        head = HEADS[int(random.integers(len(HEADS)))]
        words[head] += random.integers(-70, 5000) if random.random() < 0.9 else random.integers(2**63)


if __name__ == "__main__":
    main(*sys.argv[1:])
