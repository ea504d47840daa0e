"""The program around a node: it does not go on without one of its threads."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

import rclpy

from rosfront import program

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """
import sys, threading
from config.loader import load_arm
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
        if sys.argv[1] == "thread of the node":
            threading.Thread(target=bytearray, args=(1 << 62,)).start()

    def finish(self, end):
        assert False, "what must move nothing any more is asked to"

    def close(self, patience_s):
        assert patience_s == ARM.patience.goals_s
        ended.set()

ended = threading.Event()
ARM = load_arm("mock", overrides={"limits": {"braking_factor": 1.0}})
serve(lambda executor: Served(), [], ARM, EndSignal())
"""


@pytest.mark.parametrize("thread", ["executor", "thread of the node"])
def test_a_thread_that_fails_ends_the_program_in_order(thread: str) -> None:
    command = [sys.executable, "-c", PROGRAM, thread]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30.0, check=False)
    assert (result.returncode, result.stdout) == (1, "destroyed\n")
    assert result.stderr.rstrip().endswith("MemoryError")


FULL = os.statvfs_result((4096, 4096, 16384, 1023, 1023, 1000, 1000, 1000, 0, 255))
WITHOUT_LIMIT = os.statvfs_result((4096, 4096, 0, 0, 0, 0, 0, 0, 0, 255))
"""What tmpfs with size=0 and ramfs say."""


@pytest.fixture
def shares_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULT")


@pytest.mark.usefixtures("shares_memory")
def test_no_room_in_shared_memory_is_a_sentence_and_no_bus_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program.os, "statvfs", lambda path: FULL)
    with pytest.raises(program.CannotServe, match=r"/dev/shm has 4092 KiB left, and ROS needs 4096 KiB: free"):
        program.start_ros([])


def missing(path: str) -> os.statvfs_result:
    raise FileNotFoundError(path)


@pytest.mark.parametrize("statvfs", [lambda path: WITHOUT_LIMIT, missing], ids=["no limit", "no /dev/shm"])
@pytest.mark.usefixtures("shares_memory")
def test_room_in_shared_memory_is_asked_for_only_where_it_can_run_out(
    statvfs: Callable[[str], os.statvfs_result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program.os, "statvfs", statvfs)
    context = rclpy.Context()
    program.start_ros([], context)
    context.shutdown()


def test_by_udp_no_room_in_shared_memory_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program.os, "statvfs", lambda path: FULL)
    context = rclpy.Context()
    program.start_ros([], context)
    context.shutdown()
