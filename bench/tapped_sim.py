"""`python -m bench.tapped_sim FILE …`: the simulated arm, which keeps what motion commands reached its adapter.

At the end FILE gets an array (n, 3) of int64: CLOCK_MONOTONIC ns at which the adapter had read the command's last
character, the drive's address, and the target in pulses.
"""

import re
import sys

import numpy as np

from sim.__main__ import main
from sim.arm import SimulatedArm

# Both packets of FD: the address, then direction and the upper three bytes of the pulses, or the lowest one.
_HEAD = re.compile(rb"T([0-9A-F]{6})008FD([0-9A-F]{2})[0-9A-F]{6}([0-9A-F]{6})")
_TAIL = re.compile(rb"T([0-9A-F]{6})015FD([0-9A-F]{2})")


def commands_in(chunks: list[tuple[int, bytes]]) -> np.ndarray:
    """The position commands in what was read."""
    found = []
    head: re.Match[bytes] | None = None
    rest = b""
    for now_ns, data in chunks:
        *lines, rest = (rest + data).split(b"\r")
        for line in lines:
            if match := _HEAD.match(line):
                head = match
            elif (match := _TAIL.match(line)) and head is not None and match[1] == head[1]:
                pulses = int(head[3] + match[2], 16)
                found.append((now_ns, int(head[1], 16), -pulses if head[2] != b"00" else pulses))
    return np.array(found, np.int64).reshape(-1, 3)


if __name__ == "__main__":
    chunks: list[tuple[int, bytes]] = []
    feed = SimulatedArm.feed

    def tapped(arm: SimulatedArm, now_ns: int, data: bytes) -> None:
        chunks.append((now_ns, data))
        feed(arm, now_ns, data)

    SimulatedArm.feed = tapped  # type: ignore[method-assign]
    code = main(sys.argv[2:])
    np.save(sys.argv[1], commands_in(chunks))
    sys.exit(code)
