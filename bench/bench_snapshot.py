"""Reading the snapshot of a six-joint arm, from compiled code and from plain Python."""

import numpy as np
import pytest
from virtual import VirtualArm

from compilation.jit import jit
from shm import layout
from shm.record import offset_of
from shm.seqlock import read

READS = 10_000
SEQUENCE = offset_of(layout.StateFile, "snapshot_sequence")
SNAPSHOT = offset_of(layout.StateFile, "snapshot")
CYCLE = offset_of(layout.Snapshot, "cycle")


@pytest.fixture
def holding():
    arm = VirtualArm("mock")
    assert arm.bring_up().failure is None
    yield arm
    arm.close()


@jit
def read_many(sequence: int, source: int, target: int, words: int, reads: int) -> int:
    good = 0
    for _ in range(reads):
        good += read(sequence, source, target, words)
    return good


def test_compiled_read(benchmark, holding, report):
    words = layout.used_bytes(layout.Snapshot, 6) // 8
    target = np.zeros(words, np.int64)
    state = holding.state.address
    arguments = (state + SEQUENCE, state + SNAPSHOT, target.ctypes.data, words, READS)
    assert benchmark(read_many, *arguments) == READS
    assert target[CYCLE // 8] == holding.memory["timing"]["cycle"]
    each_ns = benchmark.stats.stats.median / READS * 1e9
    benchmark.extra_info["read_ns"] = each_ns
    report("snapshot of 6 joints read by compiled code (aim ≤ 200 ns)", f"{each_ns:.0f} ns")


def test_python_read(benchmark, holding, report):
    record = benchmark(holding.reader.snapshot)
    assert record["cycle"] == holding.memory["timing"]["cycle"]
    each_us = benchmark.stats.stats.median * 1e6
    report("snapshot of 6 joints read by plain Python (aim ≤ 10 µs)", f"{each_us:.2f} µs")
