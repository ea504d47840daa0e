"""The table of words: aligned, documented, and hashed so that two versions cannot misread each other."""

import copy

import numpy as np
import pytest

from shm import layout

UNITS = {
    "ns": "ns",
    "_s": "s",
    "rad": "rad",
    "rad_s": "rad/s",
    "rad_s2": "rad/s²",
    "bitrate": "bit/s",
    "bits_on_bus": "bit",
    "temperature_c": "°C",
    "voltage_v": "V",
}
"""Ending of a word's name → its unit; the longest ending that fits decides."""

POLLED = {
    "STATE": ("consumed", "snapshot_sequence", "counters", "events_written", "records_written", "frames_written"),
    "COMMAND": ("front_pid", "heartbeat_ns", "announced_goal", "setpoints_written", "requests_written"),
}
"""Words that one process writes while another looks at them again and again."""

WORDS = [(table, word) for table, words in layout.TABLES.items() for word in words]


def leaves(dtype: np.dtype, at: int = 0, path: str = "") -> list[tuple[str, int, np.dtype]]:
    """Path, offset and type of every plain word, once for each element of an array of records."""
    found = []
    for name in dtype.names or ():
        here, offset = dtype.fields[name][:2]
        if here.base.fields is None:
            found.append((f"{path}{name}", at + offset, here))
            continue
        for index in range(int(np.prod(here.shape, dtype=int))):
            start = at + offset + index * here.base.itemsize
            found += leaves(here.base, start, f"{path}{name}.")
    return found


def unit_of(name: str) -> str:
    endings = [ending for ending in UNITS if name == ending or name.endswith(f"_{ending.removeprefix('_')}")]
    return UNITS[max(endings, key=len)] if endings else ""


@pytest.mark.parametrize("file", ["STATE", "COMMAND"])
def test_every_word_is_eight_bytes_and_aligned(file):
    for path, offset, dtype in leaves(getattr(layout, file)):
        assert offset % 8 == 0, path
        whole_words = dtype.base.str in ("<i8", "<f8") or (dtype.base.str == "|u1" and dtype.itemsize % 8 == 0)
        assert whole_words, path


@pytest.mark.parametrize(("file", "word"), [(file, word) for file in POLLED for word in POLLED[file]])
def test_polled_words_begin_a_line_that_holds_nothing_else(file, word):
    dtype = getattr(layout, file)
    here, start = dtype.fields[word][:2]
    assert start % layout.LINE_BYTES == 0
    assert here.itemsize % layout.LINE_BYTES == 0


def test_a_goals_opening_fits_the_slot_of_a_waypoint():
    assert layout.BEGIN.itemsize == layout.SETPOINT.itemsize
    shared = [(name, *layout.SETPOINT.fields[name][:2]) for name in ("crc", "sequence", "goal_id", "kind")]
    assert [(name, *layout.BEGIN.fields[name][:2]) for name, _, _ in shared] == shared
    assert layout.BEGIN.fields["joints"][1] == layout.SETPOINT.fields["joints"][1]


@pytest.mark.parametrize("record", ["SNAPSHOT", "SETPOINT", "BEGIN", "RECORD"])
def test_joints_stand_last_so_that_small_arms_cost_little(record):
    dtype = getattr(layout, record)
    assert dtype.names[0] == "crc" and dtype.names[-1] == "joints"
    assert layout.used_bytes(dtype, layout.MAX_JOINTS) == dtype.itemsize
    assert layout.used_bytes(dtype, 6) == dtype.fields["joints"][1] + 6 * dtype["joints"].base.itemsize


@pytest.mark.parametrize("name", ["SETPOINT_SLOTS", "REQUEST_SLOTS", "EVENT_SLOTS", "RESULT_SLOTS", "ANSWER_SLOTS"])
def test_indexes_can_be_masked(name):
    slots = getattr(layout, name)
    assert slots & (slots - 1) == 0


def test_hash_is_stable_positive_and_sees_a_changed_word(monkeypatch):
    original = layout.layout_hash()
    assert original == layout.layout_hash() and 0 < original < 2**63
    words = copy.copy(layout.COMMAND.descr)
    for changed in (
        [*words[:-1], ("records", *words[-1][1:])],  # another name
        [*words, ("more", "<i8")],
        [words[0], words[2], words[1], *words[3:]],  # another order
        [*words[:1], (words[1][0], "<f8", words[1][2]), *words[2:]],  # another type
    ):
        monkeypatch.setattr(layout, "COMMAND", np.dtype(changed))
        assert layout.layout_hash() != original


@pytest.mark.parametrize(("table", "word"), WORDS, ids=[f"{table}-{word.name}" for table, word in WORDS])
def test_every_word_says_its_unit_and_meaning(table, word):
    nested = isinstance(word.type, np.dtype) or (isinstance(word.type, tuple) and isinstance(word.type[0], np.dtype))
    assert word.unit == unit_of(word.name) or word.name == "measured_effort"
    assert word.meaning or word.unit or nested or word.name in ("padding", "reserved", "value", "limit")


def test_every_word_of_both_files_is_in_the_table():
    listed = {word.name for words in layout.TABLES.values() for word in words}
    for file in (layout.STATE, layout.COMMAND, layout.RECORD, layout.BUS_FRAME):
        assert {path.rsplit(".", 1)[-1] for path, _, _ in leaves(file)} <= listed


def test_the_recorder_keeps_the_changing_part_of_a_snapshot_as_it_stands():
    start, kept = layout.SNAPSHOT.fields["cycle"][1], layout.RECORD.fields["cycle"][1]
    names = layout.SNAPSHOT.names[layout.SNAPSHOT.names.index("cycle") :]
    assert layout.RECORD.names[-len(names) :] == names
    for name in names:
        dtype, at = layout.SNAPSHOT.fields[name][:2]
        assert layout.RECORD.fields[name][:2] == (dtype, at - start + kept)


def test_the_recorder_keeps_all_counters_that_move_apart_from_the_cycles_themselves():
    assert [word.name for word in layout.COUNTED] == [
        name for name in layout.COUNTERS.names if name not in ("cycles", "padding")
    ]


@pytest.mark.parametrize("rate_hz", [10, 120, 1000, 2000])
@pytest.mark.parametrize("joints", [1, 6, 32])
def test_the_recorder_keeps_half_a_minute_of_any_arm(joints, rate_hz):
    rings = layout.rings(joints, round(1e9 / rate_hz), 500_000)
    assert rings.record_slots >= 32 * rate_hz
    assert rings.frame_slots >= rings.record_slots * (4 * joints + 2)
    assert rings.record_bytes == layout.used_bytes(layout.RECORD, joints)
    assert (layout.STATE.itemsize % layout.LINE_BYTES, rings.file_bytes % 8) == (0, 0)
    assert layout.rings(joints, round(1e9 / rate_hz), 0).frame_slots == 0


def test_trouble_on_the_bus_is_counted():
    assert set(layout.BUS_TROUBLE) <= set(layout.COUNTERS.names)


def test_what_seldom_changes_in_a_snapshot_stands_before_what_changes_in_every_cycle():
    assert layout.SNAPSHOT.names[:4] == ("crc", "results", "answers", "cycle")
