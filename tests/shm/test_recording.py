"""The flight recorder's rings as a reader sees them: whole records in order, whatever the writer does meanwhile."""

import contextlib

import numpy as np
import pytest
import record_writer
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual import private_file
from waiting import ready_process

from config.loader import load_arm
from rtloop.memory import frame_words, recorder
from rtloop.process.initial_state import new_loop
from shm import files, layout, recording
from shm.recording import frame_check, read_recording

SLOTS = 5
WORDS = st.integers(-(2**63), 2**63 - 1)


@pytest.fixture
def small(monkeypatch):
    """A loop of six mock joints whose rings hold five cycles, and 130 frames."""
    arm = load_arm("episode1", overrides={"bus": {"channel": "nowhere"}})
    monkeypatch.setattr(layout, "RECORDED_NS", SLOTS * arm.control.period_ns)
    state, command = private_file(layout.StateFile, arm), private_file(layout.CommandFile, arm)
    yield new_loop(arm, state.address, command.address), state
    state.close()
    command.close()


def record(small, number, count=1):
    """Record cycles whose words are their numbers."""
    loop, state = small
    words = layout.used_bytes(layout.Snapshot, 6) // 8
    for one in range(number, number + count):
        record_writer.record_one(loop[0], state.array[0], one, words)


def numbers(found):
    return found.records["number"].tolist()


@settings(deadline=None, max_examples=examples(40))
@given(st.lists(st.integers(0, 2 * SLOTS + 1), min_size=1, max_size=4))
def test_the_newest_cycles_are_read_in_order_however_often_the_ring_has_gone_round(batches):
    with pytest.MonkeyPatch.context() as patch:
        arm = load_arm("mock")
        patch.setattr(layout, "RECORDED_NS", SLOTS * arm.control.period_ns)
        state, command = private_file(layout.StateFile, arm), private_file(layout.CommandFile, arm)
        made = new_loop(arm, state.address, command.address), state
        written = 0
        for batch in batches:
            record(made, written, batch)
            written += batch
            found = read_recording(state)
            # the slot of the oldest may be the one that is just being written, so it is not believed
            assert numbers(found) == list(range(max(0, written - SLOTS + 1), written))
            assert found.records["cycle"].tolist() == numbers(found)
            assert found.lost == 0
        state.close()
        command.close()


@settings(deadline=None, max_examples=examples(60))
@given(data=st.data())
def test_a_spoilt_word_anywhere_in_a_record_is_noticed(data):
    with pytest.MonkeyPatch.context() as patch:
        arm = load_arm("mock")
        patch.setattr(layout, "RECORDED_NS", SLOTS * arm.control.period_ns)
        state, command = private_file(layout.StateFile, arm), private_file(layout.CommandFile, arm)
        record((new_loop(arm, state.address, command.address), state), 0, 3)
        size = layout.used_bytes(layout.CycleRecord, len(arm.joints))
        word = data.draw(st.integers(0, 3 * size // 8 - 1))
        words = np.frombuffer(state.map, np.int64)
        at = layout.StateFile.dtype.itemsize // 8 + word
        words[at] ^= data.draw(st.integers(1, 2**63 - 1))
        found = read_recording(state)
        assert (len(found.records), found.lost) == (2, 1)
        assert word // (size // 8) not in numbers(found)
        del words
        state.close()
        command.close()


def test_a_half_overwritten_record_is_left_out_and_counted(small):
    _, state = small
    record(small, 0, SLOTS + 2)
    newest = (SLOTS + 1) % SLOTS
    size = layout.used_bytes(layout.CycleRecord, 6)
    at = layout.StateFile.dtype.itemsize + newest * size
    half = size // 2
    older = (newest + 2) % SLOTS
    state.map[at : at + half] = state.map[layout.StateFile.dtype.itemsize + older * size :][:half]
    found = read_recording(state)
    assert (numbers(found), found.lost) == ([3, 4, 5], 1)


@settings(deadline=None, max_examples=examples(200))
@given(words=st.lists(WORDS, min_size=4, max_size=4), at=st.integers(0, 3), change=st.integers(1, 2**64 - 1))
def test_a_spoilt_word_of_a_frame_is_noticed(words, at, change):
    def check(values):
        return int(frame_check(*(np.array([value], np.int64) for value in values))[0])

    spoilt = list(words)
    spoilt[at] = int(np.uint64(spoilt[at] % 2**64 ^ change).astype(np.int64))
    assert check(words) != check(spoilt)


def test_frames_are_read_as_they_were_recorded(small):
    loop, state = small
    sent = recorder.SENT | recorder.marks_of(frame_words.EXTENDED)
    recorder.record_frame(loop[0], state.array[0], 3, 5, 0x101, sent, 8, -3)
    recorder.record_frame(loop[0], state.array[0], 0, 6, 0x7FF, 0, 2, 0x6B36)
    first, second = read_recording(state).frames
    marks = recording.SENT | recording.EXTENDED | 3 << recording.BUS_SHIFT
    assert first["head"] == 0x101 | 8 << recording.LENGTH_SHIFT | marks
    assert (first["monotonic_ns"], first["data"]) == (5, -3)
    assert (second["monotonic_ns"], second["head"], second["data"]) == (6, 0x7FF | 2 << 32, 0x6B36)
    slots = int(state.record["recorder"]["frame_slots"])
    assert slots == SLOTS * 26
    for number in range(2, 3 * slots):
        recorder.record_frame(loop[0], state.array[0], 0, number, 1, 0, 1, number)
    found = read_recording(state)
    assert found.frames["data"].tolist() == list(range(2 * slots + 1, 3 * slots))
    assert found.lost == 0
    described = state.record["recorder"]
    rings_at = int(described["record_slots"] * described["record_bytes"])
    ring = np.frombuffer(state.map, layout.BusFrame.dtype, slots, rings_at + layout.StateFile.dtype.itemsize)
    ring["data"][7] += 1
    assert read_recording(state).lost == 1
    del ring


@pytest.mark.parametrize("written", [-1, -(2**63), 2**62, 2**63 - 1])
def test_a_nonsensical_count_of_records_makes_no_reader_fail(small, written):
    _, state = small
    record(small, 0, 3)
    state.record["records_written"][0] = state.record["frames_written"][0] = written
    found = read_recording(state)
    assert (len(found.records), len(found.frames)) == (0, 0)


def test_an_arm_without_rings_records_nothing(small):
    _, state = small
    state.record["recorder"]["record_slots"] = state.record["recorder"]["frame_slots"] = 0
    record(small, 0, 2)
    assert state.record["records_written"][0] == state.record["frames_written"][0] == 0


# --- with the writer in a process of its own ------------------------------------------------------------


def judge(found, newest):
    """Every record says its own number with every word; says the newest number."""
    cycles = found.records
    assert np.array_equal(cycles["number"], cycles["cycle"])
    for name in ("lateness_ns", "cycle_time_ns", "monotonic_ns", "goal_id"):
        assert np.array_equal(cycles[name], cycles["number"]), name
    assert np.array_equal(cycles["joints"]["measured_ns"], np.repeat(cycles["number"][:, None], 6, axis=1))
    assert np.array_equal(found.frames["data"], found.frames["monotonic_ns"])
    assert np.all(np.diff(cycles["number"]) > 0) and np.all(np.diff(found.frames["data"]) > 0)
    return max(newest, int(cycles["number"][-1])) if len(cycles) else newest


@pytest.mark.process
def test_reading_while_it_is_written_and_after_a_kill(arm_name):
    try:
        writer = ready_process(record_writer.__file__, arm_name)
        with writer as child, contextlib.closing(files.open_state(arm_name)) as memory:
            newest = kept = 0
            while newest < 20_000 or kept < 200:
                found = read_recording(memory)
                newest, kept = judge(found, newest), kept + len(found.records)
            child.kill()  # at a moment of nobody's choosing
            child.wait()
            found = read_recording(memory)
            judge(found, 0)
            assert len(found.records) == memory.record["recorder"]["record_slots"] - 1
            assert found.lost == 0  # what it was writing takes the place of the oldest, which is not asked for
    finally:
        for path in files.DIRECTORY.glob(f"rtarm.{arm_name}.*"):
            path.unlink()
