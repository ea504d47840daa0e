"""The table of words: aligned, documented, and hashed so that two versions cannot misread each other."""

import copy

import numpy as np
import pytest

from config.buses import MOST_BUSES
from shm import layout, recording
from shm.record import offset_of

UNITS = {
    "ns": "ns",
    "_s": "s",
    "rad": "rad",
    "rad_s": "rad/s",
    "rad_s2": "rad/s²",
    "bitrates": "bit/s",
    "bits_on_bus": "bit",
    "temperature_c": "°C",
    "voltage_v": "V",
}
"""Ending of a word's name → its unit; the longest ending that fits decides."""

POLLED = {
    layout.StateFile: (
        *("consumed", "snapshot_sequence", "counters", "buses"),
        *("events_written", "records_written", "frames_written"),
    ),
    layout.CommandFile: ("front_pid", "heartbeat_ns", "announced_goal", "setpoints_written", "requests_written"),
}
"""Words that one process writes while another looks at them again and again."""

WORDS = [(table, word) for table in layout.TABLES for word in table.words]


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


@pytest.mark.parametrize("file", [layout.StateFile, layout.CommandFile])
def test_every_word_is_eight_bytes_and_aligned(file):
    for path, offset, dtype in leaves(file.dtype):
        assert offset % 8 == 0, path
        whole_words = dtype.base.str in ("<i8", "<f8") or (dtype.base.str == "|u1" and dtype.itemsize % 8 == 0)
        assert whole_words, path


@pytest.mark.parametrize(("file", "word"), [(file, word) for file in POLLED for word in POLLED[file]])
def test_polled_words_begin_a_line_that_holds_nothing_else(file, word):
    assert offset_of(file, word) % layout.LINE_BYTES == 0
    assert file.dtype[word].itemsize % layout.LINE_BYTES == 0


def test_a_goals_opening_fits_the_slot_of_a_waypoint():
    assert layout.Begin.dtype.itemsize == layout.Setpoint.dtype.itemsize
    shared = [(name, *layout.Setpoint.dtype.fields[name][:2]) for name in ("crc", "sequence", "goal_id", "kind")]
    assert [(name, *layout.Begin.dtype.fields[name][:2]) for name, _, _ in shared] == shared
    assert offset_of(layout.Begin, "joints") == offset_of(layout.Setpoint, "joints")


@pytest.mark.parametrize("record", [layout.Snapshot, layout.Setpoint, layout.Begin, layout.CycleRecord])
def test_joints_stand_last_so_that_small_arms_cost_little(record):
    assert record.dtype.names[0] == "crc" and record.dtype.names[-1] == "joints"
    assert layout.used_bytes(record, layout.MAX_JOINTS) == record.dtype.itemsize
    assert layout.used_bytes(record, 6) == offset_of(record, "joints") + 6 * record.dtype["joints"].base.itemsize


@pytest.mark.parametrize("name", ["SETPOINT_SLOTS", "REQUEST_SLOTS", "EVENT_SLOTS", "RESULT_SLOTS", "ANSWER_SLOTS"])
def test_indexes_can_be_masked(name):
    slots = getattr(layout, name)
    assert slots & (slots - 1) == 0


def test_hash_is_stable_positive_and_sees_a_changed_word(monkeypatch):
    original = layout.layout_hash()
    assert original == layout.layout_hash() and 0 < original < 2**63
    words = copy.copy(layout.CommandFile.dtype.descr)
    for changed in (
        [*words[:-1], ("records", *words[-1][1:])],  # another name
        [*words, ("more", "<i8")],
        [words[0], words[2], words[1], *words[3:]],  # another order
        [*words[:1], (words[1][0], "<f8", words[1][2]), *words[2:]],  # another type
    ):
        monkeypatch.setattr(layout.CommandFile, "dtype", np.dtype(changed))
        assert layout.layout_hash() != original


@pytest.mark.parametrize(("table", "name"), WORDS, ids=[f"{table.__name__}-{name}" for table, name in WORDS])
def test_every_word_says_its_unit_and_meaning(table, name):
    unit, meaning = table.words[name]
    assert unit == unit_of(name) or name == "measured_effort"
    assert meaning or unit or table.dtype[name].base.names or name in ("padding", "reserved", "value", "limit")


def test_every_word_of_both_files_is_in_the_table():
    listed = {word for table in layout.TABLES for word in table.words}
    for file in (layout.StateFile, layout.CommandFile, layout.CycleRecord, layout.BusFrame):
        assert {path.rsplit(".", 1)[-1] for path, _, _ in leaves(file.dtype)} <= listed


def test_the_recorder_keeps_the_changing_part_of_a_snapshot_as_it_stands():
    start, kept = offset_of(layout.Snapshot, "cycle"), offset_of(layout.CycleRecord, "cycle")
    names = layout.Snapshot.dtype.names[layout.Snapshot.dtype.names.index("cycle") :]
    assert layout.CycleRecord.dtype.names[-len(names) :] == names
    for name in names:
        dtype, at = layout.Snapshot.dtype.fields[name][:2]
        assert layout.CycleRecord.dtype.fields[name][:2] == (dtype, at - start + kept)


def test_the_recorder_keeps_all_counters_that_move_apart_from_the_cycles_themselves():
    assert [*layout.Counted.words] == [name for name in layout.Counters.words if name not in ("cycles", "padding")]


@pytest.mark.parametrize("rate_hz", [10, 120, 1000, 2000])
@pytest.mark.parametrize("joints", [1, 6, 32])
def test_the_recorder_keeps_half_a_minute_of_any_arm(joints, rate_hz):
    rings = layout.rings(joints, round(1e9 / rate_hz), 500_000)
    assert rings.record_slots >= 32 * rate_hz
    assert rings.frame_slots >= rings.record_slots * (4 * joints + 2)
    assert rings.record_bytes == layout.used_bytes(layout.CycleRecord, joints)
    assert (layout.StateFile.dtype.itemsize % layout.LINE_BYTES, rings.file_bytes % 8) == (0, 0)
    assert layout.rings(joints, round(1e9 / rate_hz), 0).frame_slots == 0
    several = layout.rings(joints, round(1e9 / rate_hz), 500_000, 1_000_000, 500_000, 0)
    assert several.frame_slots >= rings.record_slots * (4 * joints + 2 * 3)
    assert several.record_slots == rings.record_slots


def test_a_bus_counts_what_all_of_them_count_together():
    assert set(layout.BusCounters.words) - {"padding"} <= set(layout.Counted.words)


def test_no_arm_may_have_more_buses_than_there_is_room_for():
    assert MOST_BUSES == layout.MAX_BUSES
    assert layout.MAX_BUSES & recording.BUS_MASK == 0 and (layout.MAX_BUSES - 1) << recording.BUS_SHIFT < 2**63


def test_trouble_on_the_bus_is_counted():
    assert set(layout.BUS_TROUBLE) <= set(layout.Counters.words)


def test_what_seldom_changes_in_a_snapshot_stands_before_what_changes_in_every_cycle():
    assert layout.Snapshot.dtype.names[:4] == ("crc", "results", "answers", "cycle")
