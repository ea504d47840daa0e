"""The snapshot's CRC and seqlock: equal to zlib, never torn, and never waiting for a dead writer."""

import contextlib
import zlib

import numpy as np
import pytest
import snapshot_writer
from hypothesis import given, settings
from hypothesis import strategies as st
from snapshot_writer import JOINTS, SEQUENCE, SNAPSHOT, WORDS
from waiting import ready_process

from compilation.jit import jit
from shm import files, layout
from shm.atomics import load_relaxed
from shm.client import StateReader
from shm.errors import TornRead
from shm.seqlock import copy_words, crc32_at, publish, read


@settings(deadline=None)  # the first call compiles
@given(st.binary(max_size=512).map(lambda data: data[: len(data) // 8 * 8]))
def test_crc_is_zlibs(data):
    words = np.frombuffer(data + bytes(8), np.int64)
    assert crc32_at(words.ctypes.data, len(data) // 8) == zlib.crc32(data)


def test_crc_of_a_known_string():
    words = np.frombuffer(b"12345678" * 2, np.int64)
    assert crc32_at(words.ctypes.data, 1) == 0x9AE0DAAF  # CRC-32/ISO-HDLC of "12345678"


@settings(deadline=None)
@given(st.lists(st.integers(-(2**63), 2**63 - 1), max_size=40), st.integers(0, 40))
def test_crc_goes_on_where_an_earlier_one_ended(values, first):
    words = np.array([*values, 0], np.int64)
    first = min(first, len(values))
    before = crc32_at(words.ctypes.data, first)
    whole = crc32_at(words.ctypes.data + 8 * first, len(values) - first, before)
    assert whole == zlib.crc32(words[: len(values)].tobytes())


@settings(deadline=None)
@given(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1, max_size=40))
def test_what_is_published_is_read(values):
    source = np.array(values, np.int64)
    shared = np.zeros(1 + len(values), np.int64)
    target = np.zeros_like(source)
    at = shared.ctypes.data
    publish(at, at + 8, source.ctypes.data, len(values))
    assert shared[0] == 2
    assert read(at, at + 8, target.ctypes.data, len(values))
    assert target.tolist() == values


def test_words_that_stand_already_are_left_alone():
    source, shared = np.arange(1, 7), np.array([4, -1, -2, -3, -4, -5, -6])
    at = shared.ctypes.data
    publish(at, at + 8, source.ctypes.data, len(source), 3)
    assert shared.tolist() == [6, 1, -2, -3, -4, 5, 6]


def test_an_odd_sequence_ends_a_read_after_bounded_tries():
    shared, target = np.array([1, 7]), np.zeros(1, np.int64)
    assert not read(shared.ctypes.data, shared.ctypes.data + 8, target.ctypes.data, 1)


def test_copy_stops_where_it_should():
    source, target = np.arange(1, 9), np.zeros(8, np.int64)
    copy_words(target.ctypes.data, source.ctypes.data, 5)
    assert target.tolist() == [1, 2, 3, 4, 5, 0, 0, 0]


# --- with the writer in a process of its own ------------------------------------------------------------


@jit
def judge_reads(state: int, target: int, words: int, reads: int, sequence_at: int, snapshot_at: int):
    """(consistent reads, torn ones, steps back in time, different snapshots seen)."""
    good = torn = backward = different = 0
    last = 0
    for _ in range(reads):
        if not read(state + sequence_at, state + snapshot_at, target, words):
            continue
        number = load_relaxed(target + 8)
        whole = load_relaxed(target) == crc32_at(target + 8, words - 1)
        for word in range(1, words):
            whole = whole and load_relaxed(target + 8 * word) == number
        good += whole
        torn += not whole
        backward += number < last
        different += number != last
        last = number
    return good, torn, backward, different


@pytest.fixture
def writer(arm_name):
    """Starts the writing process; removes what it leaves behind."""
    with contextlib.ExitStack() as children:

        def start(behaviour):
            child = children.enter_context(ready_process(snapshot_writer.__file__, arm_name, behaviour))
            return child, files.open_state(arm_name)

        yield start
    for path in files.DIRECTORY.glob(f"rtarm.{arm_name}.*"):
        path.unlink()


def numbers(record):
    """The distinct words of a snapshot, apart from its CRC."""
    used = layout.used_bytes(layout.Snapshot, JOINTS)
    return set(np.frombuffer(record.tobytes()[8:used], np.int64).tolist())


@pytest.mark.process
def test_no_reader_ever_sees_a_torn_snapshot(writer):
    child, memory = writer("forever")
    target = np.zeros(WORDS, np.int64)
    good = different = 0
    while good < 100_000 or different < 1_000:  # however little of the machine the writer gets
        whole, torn, backward, new = judge_reads(memory.address, target.ctypes.data, WORDS, 50_000, SEQUENCE, SNAPSHOT)
        assert torn == backward == 0
        good, different = good + whole, different + new

    reader = StateReader(memory)
    last, seen = 0, set()
    while len(seen) < 200:
        (number,) = numbers(reader.snapshot().record)
        assert number >= last
        last = number
        seen.add(number)

    child.kill()  # at a moment of nobody's choosing
    child.wait()
    try:
        assert len(numbers(reader.snapshot().record)) == 1
    except TornRead:
        assert memory.record["snapshot_sequence"][0] & 1
    reader.close()


@pytest.mark.process
def test_a_writer_killed_in_mid_write_makes_nobody_wait(writer):
    child, memory = writer("killed-in-mid-write")
    child.kill()
    child.wait()
    reader = StateReader(memory)
    with pytest.raises(TornRead, match="1000 tries: the control process died or hangs in mid-write"):
        reader.snapshot()
    target = np.zeros(WORDS, np.int64)
    state = memory.address
    assert not read(state + SEQUENCE, state + SNAPSHOT, target.ctypes.data, WORDS)
    reader.close()
