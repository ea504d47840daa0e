"""Who keeps off the cycle's processor, each time in a process of its own."""

import os
import subprocess
import sys

import pytest

ALLOWED = os.sched_getaffinity(0)
CPU = max(ALLOWED)
PROGRAM = """
import os, sys, threading
from config.processors import leave_to_cycle

allowed, cpu = (eval(argument) for argument in sys.argv[1:])
os.sched_setaffinity(0, allowed)
ended = threading.Event()
older = threading.Thread(target=ended.wait)
older.start()
leave_to_cycle(cpu)
younger = threading.Thread(target=ended.wait)
younger.start()
print({frozenset(os.sched_getaffinity(thread.native_id)) for thread in (threading.main_thread(), older, younger)})
ended.set()
"""


@pytest.mark.parametrize(
    ("allowed", "cpu", "left"),
    [
        pytest.param(ALLOWED, CPU, ALLOWED - {CPU} or ALLOWED, id="of all"),
        pytest.param({CPU}, CPU, {CPU}, id="the only one"),
        pytest.param(ALLOWED, max(ALLOWED) + 1, ALLOWED, id="not allowed anyway"),
        pytest.param(ALLOWED, None, ALLOWED, id="none"),
    ],
)
def test_every_thread_keeps_off_the_cycles_processor_if_there_is_another(allowed, cpu, left) -> None:
    command = [sys.executable, "-c", PROGRAM, repr(allowed), repr(cpu)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    assert (result.stdout, result.stderr) == (f"{ {frozenset(left)} }\n", "")
