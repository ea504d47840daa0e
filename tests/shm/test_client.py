"""Plain Python's side of the border: goals, requests, heartbeats and snapshots, byte by byte."""

import contextlib
import itertools
import mmap
import os
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import ready_process

from shm import client, files, layout
from shm.client import CommandWriter, StateReader
from shm.errors import RingFull, TornRead
from shm.files import MemoryFile
from shm.words import Entry, Request, Setpoint

JOINTS = 3
USED = layout.used_bytes(layout.Setpoint, JOINTS)


def private_file(record):
    """A memory file nobody else can find, for an arm of three joints."""
    fd = os.memfd_create("rtarm-test")
    os.truncate(fd, record.dtype.itemsize)
    mapped = mmap.mmap(fd, record.dtype.itemsize)
    memory = MemoryFile(Path("memfd"), fd, mapped, np.frombuffer(mapped, record.dtype, 1))
    memory.record["header"]["joint_count"] = JOINTS
    return memory


@pytest.fixture
def writer():
    made = CommandWriter(private_file(layout.CommandFile))
    yield made
    made.close()


@pytest.fixture
def reader():
    made = StateReader(private_file(layout.StateFile))
    yield made
    made.close()


def slot(writer, sequence, dtype=layout.Setpoint.dtype):
    return writer.memory.record["setpoints"][sequence % layout.SETPOINT_SLOTS].view(dtype)


NO_TOLERANCES = np.zeros((JOINTS, 3))


def is_whole(record, used):
    data = record.tobytes()[:used]
    return int(record["crc"]) == zlib.crc32(data[8:])


# --- goals --------------------------------------------------------------------------------------------


def test_a_goal_record_by_record(writer):
    tolerances = np.arange(9.0).reshape(JOINTS, 3)
    waypoint = np.arange(9.0).reshape(JOINTS, 3) / 8
    writer.announce(12)
    terms = {"goal_time_s": 0.4, "entry": Entry.APPROACH, "epoch": 7, "tolerances": tolerances}
    writer.begin(12, start_ns=99, joint_mask=0b101, consumed=0, **terms)
    writer.waypoint(12, 5_000_000, 3, waypoint, 0)
    writer.end(12, 2 * tolerances, 0)
    assert writer.announced_goal == 12 and writer.setpoints_written == 3

    begin = slot(writer, 0, layout.Begin.dtype)
    names = ("sequence", "goal_id", "kind", "start_ns", "joint_mask", "entry", "epoch")
    assert [int(begin[name]) for name in names] == [0, 12, Setpoint.BEGIN, 99, 0b101, 1, 7]
    assert begin["goal_time_s"] == 0.4
    assert begin["joints"]["velocity_rad_s"][:JOINTS].tolist() == [1.0, 4.0, 7.0]

    record = slot(writer, 1)
    names = ("sequence", "goal_id", "kind", "time_ns", "order")
    assert [int(record[name]) for name in names] == [1, 12, Setpoint.WAYPOINT, 5_000_000, 3]
    assert record["joints"]["position_rad"][:JOINTS].tolist() == waypoint[:, 0].tolist()
    assert record["joints"]["velocity_rad_s"][:JOINTS].tolist() == waypoint[:, 1].tolist()
    assert record["joints"]["acceleration_rad_s2"][:JOINTS].tolist() == waypoint[:, 2].tolist()

    end = slot(writer, 2)
    assert (end["kind"], end["sequence"]) == (Setpoint.END, 2)
    assert end["joints"]["acceleration_rad_s2"][:JOINTS].tolist() == [4.0, 10.0, 16.0]
    assert all(is_whole(slot(writer, sequence), USED) for sequence in range(3))


@given(
    time_ns=st.integers(0, 2**62),
    order=st.sampled_from([1, 3, 5]),
    values=st.lists(st.floats(), min_size=3 * JOINTS, max_size=3 * JOINTS),
)
def test_every_waypoint_arrives_bit_by_bit(time_ns, order, values):
    writer = CommandWriter(private_file(layout.CommandFile))
    waypoint = np.array(values).reshape(JOINTS, 3)
    writer.waypoint(1, time_ns, order, waypoint, 0)
    record = slot(writer, 0)
    assert is_whole(record, USED)
    assert record.tobytes()[USED - 8 * waypoint.size : USED] == waypoint.tobytes()
    assert (record["time_ns"], record["order"]) == (time_ns, order)
    writer.close()


def test_a_full_ring_refuses_and_overwrites_nothing(writer):
    for goal in range(layout.SETPOINT_SLOTS - 1):
        writer.end(goal, NO_TOLERANCES, 0)
    before = writer.memory.array.tobytes()
    for put in (
        lambda: writer.end(1, NO_TOLERANCES, 0),
        lambda: writer.waypoint(1, 1, 5, np.zeros((JOINTS, 3)), 0),
    ):
        with pytest.raises(RingFull, match=f"{layout.SETPOINT_SLOTS - 1} records wait"):
            put()
    assert writer.memory.array.tobytes() == before
    writer.end(7777, NO_TOLERANCES, 1)  # one was taken
    assert slot(writer, layout.SETPOINT_SLOTS - 1)["goal_id"] == 7777


def test_the_ring_goes_round(writer):
    for number in range(2 * layout.SETPOINT_SLOTS + 5):
        writer.end(number, NO_TOLERANCES, number)
        assert slot(writer, number)["sequence"] == number
    assert writer.setpoints_written == 2 * layout.SETPOINT_SLOTS + 5
    assert is_whole(slot(writer, 3), USED)


# --- requests and the heartbeat -------------------------------------------------------------------------


def test_requests_are_numbered_from_one(writer):
    assert writer.request(Request.REFERENCE, consumed=0, epoch=0, value=0.25) == 1
    assert writer.request(Request.HOME, consumed=0, epoch=0, joint_mask=9) == 2
    first, second = writer.memory.record["requests"][:2]
    assert (first["sequence"], first["kind"], first["value"]) == (1, Request.REFERENCE, 0.25)
    assert (second["sequence"], second["kind"], second["joint_mask"]) == (2, Request.HOME, 9)
    assert is_whole(first, layout.Request.dtype.itemsize) and is_whole(second, layout.Request.dtype.itemsize)
    assert second["monotonic_ns"] >= first["monotonic_ns"] > 0


def test_a_full_request_ring_refuses_the_asker_and_overwrites_nothing(writer):
    for _ in range(layout.REQUEST_SLOTS - 1):
        writer.request(Request.ENABLE, consumed=0, epoch=0)
    before = writer.memory.array.tobytes()
    with pytest.raises(RingFull, match="63 requests wait for the control process"):
        writer.request(Request.DISABLE, consumed=0, epoch=0)
    assert writer.memory.array.tobytes() == before
    assert writer.request(Request.DISABLE, consumed=1, epoch=0) == layout.REQUEST_SLOTS


@given(st.lists(st.sampled_from(["stop", "hold", "resume"]), min_size=1, max_size=8), st.integers(0, 2**63 - 1))
def test_a_resume_is_later_than_every_stop_and_hold_before_it(asked, spoilt_ns):
    """Also where the file holds a time that has not come yet."""
    writer = CommandWriter(private_file(layout.CommandFile))
    record = writer.memory.record
    record["hold_ns"][0] = spoilt_ns
    for name in asked:
        getattr(writer, name)()
        assert record[f"{name}_ns"][1] == os.getpid()
        if name == "resume" and spoilt_ns <= 2**62:
            assert record["resume_ns"][0] > max(record["stop_ns"][0], record["hold_ns"][0])
    writer.close()


def test_nobody_waits_for_a_process_that_stands_still_with_the_producers_lock(writer, monkeypatch):
    other = os.open(f"/proc/self/fd/{writer.memory.fd}", os.O_RDWR)  # a description of its own, as another process has
    try:
        with files.producers_lock(other):
            with pytest.raises(RingFull, match="stands still in the middle of it"):
                writer.request(Request.HOME, consumed=0, epoch=0)
            writer.stop()
            assert writer.memory.record["stop_ns"][0] > 0
    finally:
        os.close(other)
    assert writer.request(Request.HOME, consumed=0, epoch=0) == 1


def test_cancels_have_a_place_each(writer):
    for goal in (3, 5, 3 + layout.CANCELED_SLOTS):
        writer.cancel(goal)
    assert sorted(set(writer.memory.record["canceled_goals"].tolist())) == [0, 5, 3 + layout.CANCELED_SLOTS]
    writer.announce(9)
    writer.cancel_all()
    assert writer.memory.record["canceled_through"][0] == 9


PRODUCER = """
import sys
from shm import files
from shm.client import CommandWriter
from shm.words import Request
writer = CommandWriter(files.open_command(sys.argv[1]))
print("ready", flush=True)
sys.stdin.readline()
options = {"consumed": 1 << 40, "epoch": 0, "joint_mask": int(sys.argv[2])}
print(*(writer.request(Request.HOME, **options) for _ in range(int(sys.argv[3]))))
"""


@pytest.mark.process
def test_producers_in_several_processes_never_take_the_same_number(arm_name):
    producers, requests = 3, 400
    pair = files.create(files.Identity(arm_name, tuple("abc"), 1, 10_000_000))
    with contextlib.ExitStack() as stack:
        children = [
            stack.enter_context(ready_process("-c", PRODUCER, arm_name, str(number), str(requests)))
            for number in range(producers)
        ]
        for child in children:
            child.stdin.write("go\n")
            child.stdin.flush()
        taken = [[int(number) for number in child.stdout.read().split()] for child in children]
    assert sorted(itertools.chain(*taken)) == list(range(1, producers * requests + 1))
    record = pair.command.record
    assert record["requests_written"][0] == producers * requests
    owner = {number: index for index, numbers in enumerate(taken) for number in numbers}
    for request in record["requests"]:
        assert is_whole(request, layout.Request.dtype.itemsize)
        assert request["joint_mask"] == owner[int(request["sequence"])]
    pair.remove()


def test_the_heartbeat(writer):
    writer.beat(77)
    assert writer.memory.record["heartbeat_ns"][0] == 77
    writer.beat()
    assert writer.memory.record["heartbeat_ns"][0] > 77


# --- snapshots ----------------------------------------------------------------------------------------


def publish(reader, sequence=2, **words):
    """A snapshot as the loop would leave it."""
    record = reader.memory.record
    for name, value in words.items():
        record["snapshot"][name] = value
    used = layout.used_bytes(layout.Snapshot, JOINTS)
    record["snapshot"]["crc"] = zlib.crc32(record["snapshot"].tobytes()[8:used])
    record["snapshot_sequence"][0] = sequence


def test_a_snapshot_is_a_copy(reader):
    publish(reader, cycle=5)
    first = reader.snapshot()
    publish(reader, sequence=4, cycle=6)
    assert (first["cycle"], reader.snapshot()["cycle"]) == (5, 6)


def test_joints_that_are_not_there_read_as_zero(reader):
    reader.memory.record["snapshot"]["joints"]["measured_position_rad"] = 1.5
    publish(reader)
    assert reader.snapshot()["joints"]["measured_position_rad"].tolist() == [1.5] * JOINTS + [0.0] * (
        layout.MAX_JOINTS - JOINTS
    )


@pytest.mark.parametrize("damage", ["odd sequence", "wrong crc"])
def test_a_snapshot_that_never_becomes_whole_is_an_error(reader, damage, monkeypatch):
    monkeypatch.setattr(client, "READ_TRIES", 20)
    publish(reader, cycle=5)
    if damage == "odd sequence":
        reader.memory.record["snapshot_sequence"][0] = 3
    else:
        reader.memory.record["snapshot"]["cycle"] = 6
    with pytest.raises(TornRead, match="after 20 tries"):
        reader.snapshot()


def test_consumed_records_are_read_from_the_loops_file(reader):
    reader.memory.record["consumed"]["setpoints"] = 31
    assert reader.setpoints_consumed() == 31
