"""What the flight recorder has kept, read by ordinary Python from a mapped state file, its writer alive or dead.

A record that the writer overwrites while it is copied, or that it was writing when it died, does not pass its check sum
and is left out and counted. Nothing here rests on the order in which words become visible.
"""

import zlib
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from shm import files, layout
from shm.files import Bus, MemoryFile
from shm.record import offset_of
from shm.words import Setpoint

LENGTH_SHIFT = 32
EXTENDED = 1 << 40
SENT = 1 << 41
REMOTE = 1 << 42
BUS_SHIFT = 43
BUS_MASK = layout.MAX_BUSES - 1
LENGTH_MASK = 15
IDENTIFIER_MASK = 0x1FFFFFFF


class Position(NamedTuple):
    """How far an arm's rings have been read: the number of the next record of a cycle, frame, event …"""

    records: int = 0
    frames: int = 0
    events: int = 0
    requests: int = 0
    setpoints: int = 0


_OWN_AT = offset_of(layout.CycleRecord, "number")
_CHANGING_AT = offset_of(layout.CycleRecord, "cycle")
_KEPT = ("records_written", "frames_written", "events_written")
_ASKED = ("requests_written", "setpoints_written")


def frame_check(number: Any, time_ns: Any, head: Any, data: Any) -> Any:
    """Check word of a frame's record, of 64-bit integers; a leaf function that numba compiles and numpy broadcasts.

    A change of one word always shows; words of two frames mixed up pass by chance alone.
    """
    return number ^ time_ns ^ (time_ns << 23) ^ head ^ (head << 11) ^ data ^ (data << 37)


@dataclass(frozen=True)
class Recording:
    """Some seconds of an arm's life.

    Attributes:
        joints: names of the joints, in configuration order.
        buses: the arm's buses, in configuration order; none where it has no bus.
        records: one a cycle, in their order, dtype `record_dtype`.
        frames: one a CAN frame, in their order (layout.BusFrame).
        events: oldest first (layout.Event).
        limits: what the configuration allowed (layout.Limits), no dimensions.
        identifiers: whose frames are whose (layout.Identifiers).
        scheduling: what the control process was given (layout.Scheduling), no dimensions.
        lateness: histogram since the start of the control process (layout.Histogram), no dimensions.
        cycle_time: the same of its computing time.
        lost: records that could not be read because they were just being written.
        requests: what was asked of the arm (layout.Request); none where its command file was not to be had.
        openings: the goals that were sent to it (layout.Begin); the same.
        results: of the newest goals (layout.Result); one that was just being written may be half.
    """

    arm: str
    joints: tuple[str, ...]
    arm_hash: int
    pid: int
    period_ns: int
    buses: tuple[Bus, ...]
    records: np.ndarray
    frames: np.ndarray
    events: np.ndarray
    limits: np.ndarray
    identifiers: np.ndarray
    scheduling: np.ndarray
    lateness: np.ndarray
    cycle_time: np.ndarray
    lost: int = 0
    requests: np.ndarray = field(default_factory=lambda: np.zeros(0, layout.Request.dtype))
    openings: np.ndarray = field(default_factory=lambda: np.zeros(0, layout.Begin.dtype))
    results: np.ndarray = field(default_factory=lambda: np.zeros(0, layout.Result.dtype))

    @property
    def bus_names(self) -> tuple[str, ...]:
        """Names of the buses for sentences, where the arm has several."""
        return files.several_names(self.buses)

    @property
    def bitrate(self) -> int:
        """Of all buses together (bit/s), 0 where there is none."""
        return sum(bus.bitrate for bus in self.buses)


def record_dtype(joint_count: int) -> np.dtype:
    """A cycle's record of an arm of so many joints."""
    fields = layout.CycleRecord.dtype.fields
    assert fields is not None
    formats = {name: fields[name][0] for name in fields} | {"joints": (layout.Joint.dtype, (joint_count,))}
    return np.dtype(
        {
            "names": list(fields),
            "formats": list(formats.values()),
            "offsets": [fields[name][1] for name in fields],
            "itemsize": layout.used_bytes(layout.CycleRecord, joint_count),
        }
    )


def is_whole(record: memoryview) -> bool:
    """Whether the bytes of a cycle's record belong together."""
    crc, decisions_crc = (int.from_bytes(record[at : at + 8], "little") for at in (0, 8))
    if decisions_crc >> 32:
        return False
    snapshot = zlib.crc32(record[_CHANGING_AT:], decisions_crc)
    return crc == zlib.crc32(record[_OWN_AT:_CHANGING_AT], snapshot)


def read_recording(memory: MemoryFile, command: MemoryFile | None = None) -> Recording:
    """Everything that stands in a mapped state file, and of the command file beside it what was asked."""
    return read_on(memory, kept_from(memory, command), command)[0]


def kept_from(memory: MemoryFile, command: MemoryFile | None = None) -> Position:
    """Where what is kept begins."""
    rings = files.rings(memory.record["header"])
    asked = (0, 0) if command is None else (int(command.record[name][0]) for name in _ASKED)
    slots = (rings.record_slots, rings.frame_slots, layout.EVENT_SLOTS, layout.REQUEST_SLOTS, layout.SETPOINT_SLOTS)
    written = (*(int(memory.record[name][0]) for name in _KEPT), *asked)
    # the slot of the one before the oldest may just be written again
    return Position(*(max(0, one - size + 1) for one, size in zip(written, slots, strict=True)))


def now_at(memory: MemoryFile, command: MemoryFile | None = None) -> Position:
    """Where what is written from now on will begin."""
    asked = () if command is None else (int(command.record[name][0]) for name in _ASKED)
    return Position(*(max(0, int(memory.record[name][0])) for name in _KEPT), *(max(0, one) for one in asked))


def read_on(
    memory: MemoryFile, since: Position, command: MemoryFile | None = None, most: int | None = None
) -> tuple[Recording, Position]:
    """What was written since a position, and the position behind it.

    At most `most` cycles, and frames in the proportion of their rings. A record that is not whole yet is left for the
    next time; what was overwritten before it was read is missing, so that the positions lie further apart than there
    are records.
    """
    record = memory.record
    header = record["header"]
    joint_count = int(header["joint_count"])
    rings = files.rings(header)
    most_frames = None if most is None else most * max(rings.frame_slots // rings.record_slots, 1)
    frames, frames_lost, next_frame = _frames(memory, rings, since.frames, most_frames)
    records, records_lost, next_record = _records(memory, rings, joint_count, since.records, most)
    happened = int(record["events_written"][0])
    events = _events(record, max(0, since.events, happened - layout.EVENT_SLOTS), happened)
    requests, openings = np.zeros(0, layout.Request.dtype), np.zeros(0, layout.Begin.dtype)
    next_request, next_setpoint = since.requests, since.setpoints
    if command is not None:
        requests, next_request = _requests(command.record, since.requests)
        openings, next_setpoint = _openings(command.record, joint_count, since.setpoints)
    recording = Recording(
        arm=files.arm_name(header),
        joints=files.joint_names(header),
        arm_hash=int(header["arm_hash"]),
        pid=int(header["pid"]),
        period_ns=int(header["period_ns"]),
        buses=files.buses(header),
        records=records,
        frames=frames,
        events=events,
        limits=np.array(record["limits"]),
        identifiers=np.array(record["identifiers"][record["identifiers"]["mask"] != 0]),
        scheduling=np.array(record["scheduling"]),
        lateness=np.array(record["lateness"]),
        cycle_time=np.array(record["cycle_time"]),
        lost=records_lost + frames_lost,
        requests=requests,
        openings=openings,
        results=np.array(record["snapshot"]["results"]),
    )
    return recording, Position(next_record, next_frame, max(happened, since.events), next_request, next_setpoint)


def newest_events(record: np.void, count: int) -> np.ndarray:
    """Copies of the newest `count` events of a mapped state file, oldest first.

    Plain Python has no fences, so an event that is just being written may be read half: whoever shows it reads it
    again at the next look and keeps nothing of it.
    """
    written = int(record["events_written"][0])
    return _events(record, max(0, written - count), written)


def _events(record: np.void, first: int, written: int) -> np.ndarray:
    """The events of these numbers, as far as they are kept."""
    events: np.ndarray = record["events"][np.arange(first, written) % layout.EVENT_SLOTS]
    intact_from = int(record["events_written"][0]) - layout.EVENT_SLOTS + 1  # older ones were overwritten meanwhile
    return events[max(0, intact_from - first) :]


def _records(
    memory: MemoryFile, rings: layout.Rings, joint_count: int, since: int, most: int | None
) -> tuple[np.ndarray, int, int]:
    """The whole records of cycles in their order, how many are not whole, and the number behind the last whole one."""
    size, at = rings.record_bytes, layout.StateFile.dtype.itemsize
    copy, numbers = _copied(memory, at, size, rings.record_slots, "records_written", since, most)
    found = np.frombuffer(copy, record_dtype(joint_count))
    view = memoryview(copy)
    whole = found["number"] == numbers
    for row in np.flatnonzero(whole).tolist():
        whole[row] = is_whole(view[row * size : (row + 1) * size])
    return found[whole], int(np.count_nonzero(~whole)), _behind(numbers, whole, since)


def _frames(memory: MemoryFile, rings: layout.Rings, since: int, most: int | None) -> tuple[np.ndarray, int, int]:
    """The whole records of frames in their order, how many are not whole, and the number behind the last whole one."""
    dtype = layout.BusFrame.dtype
    if rings.frame_slots == 0:
        return np.zeros(0, dtype), 0, since
    copy, numbers = _copied(memory, rings.frames_at, dtype.itemsize, rings.frame_slots, "frames_written", since, most)
    found = np.frombuffer(copy, dtype)
    whole = found["check"] == frame_check(numbers, found["monotonic_ns"], found["head"], found["data"])
    return found[whole], int(np.count_nonzero(~whole)), _behind(numbers, whole, since)


def _behind(numbers: np.ndarray, whole: np.ndarray, since: int) -> int:
    """Where to read on: behind the last whole record, or at the oldest there is where none is whole."""
    if whole.any():
        return int(numbers[whole][-1]) + 1
    return int(numbers[0]) if len(numbers) else since


def _copied(
    memory: MemoryFile, at: int, size: int, slots: int, head: str, since: int, most: int | None
) -> tuple[bytes, np.ndarray]:
    """Copies of a ring's records from a number on that were not overwritten meanwhile, and their numbers."""
    written = int(memory.record[head][0])
    first = max(since, written - slots, 0)
    last = written if most is None else min(written, first + most)
    if last <= first:
        return b"", np.zeros(0, np.int64)
    start, end = first % slots, first % slots + last - first
    copy = (
        memory.map[at + start * size : at + min(end, slots) * size] + memory.map[at : at + max(end - slots, 0) * size]
    )
    oldest = int(memory.record[head][0]) - slots + 1  # the slot of the one before it may just be written again
    skipped = min(max(oldest - first, 0), last - first)
    return copy[skipped * size :], np.arange(first + skipped, last)


def _requests(record: np.void, since: int) -> tuple[np.ndarray, int]:
    """The whole requests of a command file from a number on, and the number of the next."""
    written = int(record["requests_written"][0])
    numbers = np.arange(max(since, written - layout.REQUEST_SLOTS, 0), written)
    rows: np.ndarray = record["requests"][numbers % layout.REQUEST_SLOTS]
    whole = [zlib.crc32(row.tobytes()[8:]) == int(row["crc"]) for row in rows]
    return rows[(rows["sequence"] == numbers + 1) & np.array(whole, bool)], max(written, since)


def _openings(record: np.void, joint_count: int, since: int) -> tuple[np.ndarray, int]:
    """The whole BEGIN records of a command file from a number on, and the number of the next."""
    written = int(record["setpoints_written"][0])
    numbers = np.arange(max(since, written - layout.SETPOINT_SLOTS, 0), written)
    slots = numbers % layout.SETPOINT_SLOTS
    begins = record["setpoints"]["kind"][slots] == Setpoint.BEGIN
    rows: np.ndarray = record["setpoints"][slots[begins]].view(layout.Begin.dtype)
    used = layout.used_bytes(layout.Begin, joint_count)
    whole = [zlib.crc32(row.tobytes()[8:used]) == int(row["crc"]) for row in rows]
    return rows[(rows["sequence"] == numbers[begins]) & np.array(whole, bool)], max(written, since)
