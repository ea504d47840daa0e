"""The program around a node: it does not go on without one of its threads."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from rosfront import program

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """
import sys, threading
from rosfront.program import EndSignal, serve

class Node:
    def destroy_node(self):
        print("destroyed")

class Served:
    node = Node()

    def spin(self):
        if sys.argv[1] == "executor":
            raise MemoryError
        ended.wait()

    def announce(self):
        if sys.argv[1] == "announcer":
            raise MemoryError
        if sys.argv[1] == "publisher":
            threading.Thread(target=bytearray, args=(1 << 62,)).start()

    def close(self, patience_s):
        ended.set()

ended = threading.Event()
serve(lambda executor: Served(), [], "localhost", EndSignal())
"""


@pytest.mark.parametrize("thread", ["executor", "announcer", "publisher"])
def test_a_thread_that_fails_ends_the_program_in_order(thread: str) -> None:
    command = [sys.executable, "-c", PROGRAM, thread]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30.0, check=False)
    assert (result.returncode, result.stdout) == (1, "destroyed\n")
    assert result.stderr.rstrip().endswith("MemoryError")


def test_no_room_in_shared_memory_is_a_sentence_and_no_bus_error(monkeypatch: pytest.MonkeyPatch) -> None:
    found = os.statvfs_result((4096, 4096, 16384, 1023, 1023, 1000, 1000, 1000, 0, 255))
    monkeypatch.setattr(program.os, "statvfs", lambda path: found)
    with pytest.raises(program.CannotServe, match=r"/dev/shm has 4092 KiB left, and ROS needs 4096 KiB: free"):
        program.start_ros([])
