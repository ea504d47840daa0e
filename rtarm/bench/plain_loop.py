"""`python -m rtarm.bench.plain_loop ARM RATE_HZ [CHANNEL] [--set …]`: a loop with loop-rate-limiters and python-can.

No ROS. Prints `ready`; `run GOAL` plays a goal (JSON) in a loop that goes on until `rest`, `begin` and `end` enclose
what is measured. The rate limiter plans each deadline from the moment the last cycle woke up, so late cycles move all
later ones; lateness is against the deadline that it planned itself, which is in its favour.
"""

from __future__ import annotations

import argparse
import gc
import json
import queue
import sys
import threading
import time

from config.loader import load_arm, parse_overrides
from rtarm.bench.measured import Recording, obey
from rtarm.bench.python_arm import Path, PythonArm
from rtarm.processes import READY


def loop(path: Path, rate_hz: float, drives: PythonArm, recording: Recording, resting: threading.Event) -> None:
    """Play the path, hold its end, until `resting` is set."""
    from loop_rate_limiters import RateLimiter

    limiter = RateLimiter(rate_hz, warn=False)
    began_s = time.perf_counter()
    while not resting.is_set():
        due_s = limiter.next_tick
        limiter.sleep()
        now_s = time.perf_counter()
        recording.add(round((now_s - due_s) * 1e9))
        drives.cycle(path.at(now_s - began_s))


def main() -> int:
    """The process, until its standard input is closed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("arm")
    parser.add_argument("rate_hz", type=float)
    parser.add_argument("channel", nargs="?")
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    drives = PythonArm(load_arm(options.arm, overrides=parse_overrides(options.set)), options.channel)
    recording, resting = Recording(), threading.Event()
    goals: queue.SimpleQueue[Path | None] = queue.SimpleQueue()

    def listen() -> None:
        obey(
            {
                "run": lambda goal: goals.put(Path(json.loads(goal))),
                "begin": lambda _: recording.begin(),
                "end": lambda _: recording.end(),
                "rest": lambda _: resting.set(),
            }
        )
        resting.set()
        goals.put(None)

    gc.collect()
    gc.freeze()
    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    print(READY, flush=True)
    while (path := goals.get()) is not None:
        resting.clear()
        drives.listen()
        loop(path, options.rate_hz, drives, recording, resting)
        drives.rest()
    drives.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
