"""A snapshot's copy says in Python's numbers what numpy reads in the same bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shm import layout
from shm.snapshot import Snapshot

SIZE = layout.Snapshot.dtype.itemsize
TABLES = ("results", "answers", "joints")
WORDS = [name for name in layout.Changing.hints if name not in TABLES]


@st.composite
def records(draw):
    """The number of joints in use and a record of any words, of which those of other joints are zero."""
    joints = draw(st.integers(1, layout.MAX_JOINTS))
    used = layout.used_bytes(layout.Snapshot, joints)
    noise = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).bytes(used)
    return joints, np.frombuffer(noise.ljust(SIZE, b"\0"), layout.Snapshot.dtype)[0]


def copy_of(joints, record):
    return Snapshot(record.tobytes()[: layout.used_bytes(layout.Snapshot, joints)])


def same(found, expected):
    """Bit for bit, NaN included, and of Python's own type."""
    assert type(found) is type(expected.item())
    return np.array(found, expected.dtype).tobytes() == expected.tobytes()


@given(made=records())
def test_each_word_and_column_is_numpys(made):
    joints, record = made
    snapshot = copy_of(*made)
    assert all(same(snapshot[word], record[word]) for word in WORDS)
    for table in TABLES:
        rows = record[table][:joints] if table == "joints" else record[table]
        for name in rows.dtype.names:
            column = snapshot.column(table, name)
            assert len(column) == len(rows)
            assert all(same(word, row) for word, row in zip(column, rows[name], strict=True))


@given(made=records())
def test_numpy_sees_all_of_it_and_zero_where_no_joint_is(made):
    joints, record = made
    snapshot = copy_of(*made)
    assert snapshot.record.tobytes() == record.tobytes()
    assert all(snapshot[table].tobytes() == record[table].tobytes() for table in TABLES)
    assert not snapshot["joints"][joints:].tobytes().strip(b"\0")
    with pytest.raises(ValueError, match="read-only"):
        snapshot["joints"]["measured_ns"] = 0


@given(
    goals=st.lists(st.integers(0, 5), min_size=layout.RESULT_SLOTS, max_size=layout.RESULT_SLOTS),
    wanted=st.integers(0, 6),
)
def test_the_first_row_with_a_word_is_found(goals, wanted):
    record = np.zeros((), layout.Snapshot.dtype)
    record["results"]["goal_id"], record["results"]["joint"] = goals, np.arange(layout.RESULT_SLOTS)
    found = copy_of(1, record).find("results", "goal_id", wanted)
    assert (None if found is None else found["joint"]) == (goals.index(wanted) if wanted in goals else None)


@pytest.mark.parametrize("name", ["goal", "joint", ""])
def test_a_word_that_is_none_is_a_mistake(name):
    snapshot = Snapshot(bytes(SIZE))
    with pytest.raises((KeyError, ValueError)):
        snapshot[name]
    with pytest.raises(KeyError):
        snapshot.column("joints", name)


def test_it_is_no_sequence():
    snapshot = Snapshot(bytes(SIZE))
    with pytest.raises(TypeError):
        list(snapshot)
    with pytest.raises(TypeError):
        assert "mode" in snapshot
    assert repr(snapshot).startswith("Snapshot(")
