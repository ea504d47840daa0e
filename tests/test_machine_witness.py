"""The witness tells the machine's lateness from the tests' own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from machine_witness import PROCESSORS, OwnProcesses, Stalls, Witness, is_starved, machine_share_ns

PATIENCE_S = 60.0
SECOND_NS = 1_000_000_000


@pytest.fixture
def witness() -> Iterator[Witness]:
    witness = Witness("RTARM_WITNESSED=yes")
    yield witness
    witness.close()


def spinning(marked: bool) -> subprocess.Popen[bytes]:
    """A program that never waits."""
    environment = os.environ | ({"RTARM_WITNESSED": "yes"} if marked else {})
    return subprocess.Popen([sys.executable, "-c", "while True: pass"], env=environment)


@given(st.integers(0, SECOND_NS), st.integers(0, 8 * SECOND_NS), st.integers(1, 8))
def test_a_lateness_is_the_machines_but_for_what_the_tests_ran(late_ns: int, own_ns: int, processors: int) -> None:
    share_ns = machine_share_ns(late_ns, own_ns, processors)
    assert 0 <= share_ns <= max(late_ns, 0)
    assert machine_share_ns(late_ns, 0, processors) == late_ns
    assert machine_share_ns(late_ns, processors * late_ns, processors) == 0


@pytest.mark.parametrize(
    ("idle_s", "own_s", "starved"),
    [(0.0, 0.0, True), (0.0, 1.4, True), (0.0, 1.6, False), (0.0, 2.0, False), (0.3, 0.0, False), (2.0, 0.0, False)],
)
def test_tests_are_starved_where_others_fill_the_processors(idle_s: float, own_s: float, starved: bool) -> None:
    assert is_starved(SECOND_NS, round(idle_s * SECOND_NS), round(own_s * SECOND_NS), 2) == starved


def test_only_what_bears_the_marker_is_the_tests_own() -> None:
    with spinning(True) as own, spinning(False) as other:
        try:
            counted = OwnProcesses(b"RTARM_WITNESSED=yes", own.pid)
            found = OwnProcesses(b"RTARM_WITNESSED=yes", os.getpid())
            deadline = time.monotonic() + PATIENCE_S
            while found.spent_ns() < time.process_time_ns() + 10_000_000:  # besides this process, which is its first
                assert time.monotonic() < deadline
                found.scan(time.monotonic_ns())
            assert other.pid not in found._spent_ns and counted.spent_ns() > 0
        finally:
            own.kill()
            other.kill()
    before_ns = found.spent_ns()
    assert found.spent_ns() >= before_ns > 0  # what an ended one has used stays


def test_a_witness_that_did_not_run_tells_of_it(witness: Witness) -> None:
    start_ns = time.monotonic_ns()
    witness._process.send_signal(signal.SIGSTOP)
    time.sleep(0.2)  # the very subject: as if the machine had stood still
    witness._process.send_signal(signal.SIGCONT)
    assert 0.1 < witness.since(start_ns).longest_s < PATIENCE_S
    assert witness.since(time.monotonic_ns()) == Stalls(0.0, 0.0)


def test_programs_of_others_that_fill_the_processors_are_told(witness: Witness) -> None:
    start_ns = time.monotonic_ns()
    others = [spinning(False) for _ in range(2 * PROCESSORS)]
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not witness.since(start_ns).starved_s:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        for other in others:
            other.kill()
            other.wait()
