"""Those who carry the bytes of pseudo-terminals come first while tests run, and are what they were after them."""

import os
import subprocess
import sys
import time

import pytest
from carriers import Hurried, carriers

NAMED = """
from pathlib import Path
Path("/proc/self/comm").write_text("kworker/u7:0")
print("ready", flush=True)
input()
"""


def test_carriers_are_known_by_their_name() -> None:
    with subprocess.Popen([sys.executable, "-c", NAMED], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as named:
        assert named.stdout is not None and named.stdout.readline() == b"ready\n"
        assert named.pid in carriers()
        assert os.getpid() not in carriers()
        named.communicate(b"\n")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give another process real time")
def test_a_carrier_is_hurried_and_no_longer_when_the_tests_are_over() -> None:
    found: list[int] = []
    hurried = Hurried(lambda: found)
    with subprocess.Popen(["sleep", "60"]) as carrier:
        found.append(carrier.pid)  # one that the kernel has made since
        deadline = time.monotonic() + 10.0
        while os.sched_getscheduler(carrier.pid) != os.SCHED_FIFO:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        hurried.close()
        assert os.sched_getscheduler(carrier.pid) == os.SCHED_OTHER
        carrier.terminate()
