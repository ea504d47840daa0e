"""`python -m rtarm.recording FD ARM WORD`: write a recording of a state file that the launcher holds open.

Prints the file's path, or a sentence on standard error and exit code 1. A process of its own, so that neither its
computing nor a slow disk holds the launcher up, and of the lowest priority. It ends itself when it takes too long: the
launcher may have ended before it.
"""

import math
import os
import signal
import sys

from rtarm.console.errors import Refusal
from rtarm.console.niceness import MOST_NICE
from rtarm.recording.make import patience_s, record
from shm import files
from shm.errors import SharedMemoryError


def main(fd: str, arm: str, word: str) -> int:
    os.nice(MOST_NICE)
    signal.alarm(math.ceil(patience_s(int(fd))))
    try:
        print(record(files.inherited_state(int(fd), arm), word))
    except (Refusal, SharedMemoryError) as problem:
        print(problem, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
