"""`python -m rtloop.warm`: compile the cycle ahead, so that no start has to wait for it.

Compiles by running: a mock arm in memory, a few cycles of a goal, a wire that is closed at once. What was
compiled lies in the cache directory of this very set of sources; older directories are removed.
"""

import shutil
import sys
import time
from collections.abc import Callable

import numpy as np

KEPT_S = 24 * 3600.0
"""Compiled code of other sources is removed when it is older than this."""


def compile_everything() -> None:
    """Run every function that the threads and the supervisor call, with the types they are called with."""
    from config.loader import load_arm
    from rtloop.process import set_word
    from rtloop.run import READ_BYTES, read_wire, run
    from rtloop.service import SEND, Frame, ServicePort
    from rtloop.state import new_loop, offset_of
    from rtloop.wire import received
    from shm import layout

    state = np.zeros(1, layout.STATE)
    command = np.zeros(1, layout.COMMAND)
    loop = new_loop(load_arm("episode1"), state.ctypes.data, command.ctypes.data)
    port = ServicePort(loop)
    port.post(SEND, frame=Frame(0x100, b"\x1f\x6b"))
    port.received()
    buffer = np.zeros(READ_BYTES, np.uint8)
    request = np.zeros(1, np.int64)
    received.push(loop[0], 0, buffer, 1)
    set_word(loop.ctypes.data + offset_of(loop.dtype, "stop"), 1)
    run(loop[0], state[0], -1)
    read_wire(loop[0], -1, buffer, buffer.ctypes.data, request.ctypes.data)


def main(tell: Callable[[str], None] = print) -> int:
    """Compile unless it was done for these very sources; `tell` gets the lines for people."""
    from shm.jit import use_cache

    directory = use_cache()
    mark = directory / "warm"
    if mark.exists():
        return 0
    tell("compiling the control cycle, once for this version: about half a minute …")
    started = time.monotonic()
    compile_everything()
    for old in directory.parent.glob("compiled-*"):
        if old != directory and time.time() - old.stat().st_mtime > KEPT_S:
            shutil.rmtree(old, ignore_errors=True)
    directory.mkdir(parents=True, exist_ok=True)
    mark.touch()
    tell(f"compiled in {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
