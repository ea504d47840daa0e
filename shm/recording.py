"""What the flight recorder has kept, read by ordinary Python from a mapped state file, its writer alive or dead.

A record that the writer overwrites while it is copied, or that it was writing when it died, does not pass its check sum
and is left out and counted. Nothing here rests on the order in which words become visible.
"""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from shm import files, layout
from shm.files import MemoryFile

LENGTH_SHIFT = 32
EXTENDED = 1 << 40
SENT = 1 << 41
REMOTE = 1 << 42
LENGTH_MASK = 15
IDENTIFIER_MASK = 0x1FFFFFFF

_OWN_AT: int = layout.RECORD.fields["number"][1]  # type: ignore[index]
_CHANGING_AT: int = layout.RECORD.fields["cycle"][1]  # type: ignore[index]


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
        records: one a cycle, in their order, dtype `record_dtype`.
        frames: one a CAN frame, in their order, dtype layout.BUS_FRAME.
        events: of dtype layout.EVENT, oldest first.
        limits: what the configuration allowed, dtype layout.LIMITS, no dimensions.
        identifiers: whose frames are whose, of dtype layout.IDENTIFIERS.
        scheduling: what the control process was given, dtype layout.SCHEDULING, no dimensions.
        lateness: histogram since the start of the control process, dtype layout.HISTOGRAM, no dimensions.
        cycle_time: the same of its computing time.
        lost: records that could not be read because they were just being written.
    """

    arm: str
    joints: tuple[str, ...]
    arm_hash: int
    pid: int
    period_ns: int
    bitrate: int
    records: np.ndarray
    frames: np.ndarray
    events: np.ndarray
    limits: np.ndarray
    identifiers: np.ndarray
    scheduling: np.ndarray
    lateness: np.ndarray
    cycle_time: np.ndarray
    lost: int = 0


def record_dtype(joint_count: int) -> np.dtype:
    """A cycle's record of an arm of so many joints."""
    fields = layout.RECORD.fields
    assert fields is not None
    return np.dtype(
        {
            "names": list(fields),
            "formats": [fields[name][0] if name != "joints" else (layout.JOINT, (joint_count,)) for name in fields],
            "offsets": [fields[name][1] for name in fields],
            "itemsize": layout.used_bytes(layout.RECORD, joint_count),
        }
    )


def is_whole(record: memoryview) -> bool:
    """Whether the bytes of a cycle's record belong together."""
    crc, decisions_crc = (int.from_bytes(record[at : at + 8], "little") for at in (0, 8))
    if decisions_crc >> 32:
        return False
    snapshot = zlib.crc32(record[_CHANGING_AT:], decisions_crc)
    return crc == zlib.crc32(record[_OWN_AT:_CHANGING_AT], snapshot)


def read_recording(memory: MemoryFile) -> Recording:
    """Everything that stands in a mapped state file."""
    record = memory.record
    header = record["header"]
    joint_count = int(header["joint_count"])
    rings = layout.rings(joint_count, int(header["period_ns"]), int(header["bitrate"]))
    frames, frames_lost = _frames(memory, rings)
    records, records_lost = _records(memory, rings, joint_count)
    return Recording(
        arm=files.arm_name(header),
        joints=files.joint_names(header),
        arm_hash=int(header["arm_hash"]),
        pid=int(header["pid"]),
        period_ns=int(header["period_ns"]),
        bitrate=int(header["bitrate"]),
        records=records,
        frames=frames,
        events=newest_events(record, layout.EVENT_SLOTS),
        limits=np.array(record["limits"]),
        identifiers=np.array(record["identifiers"][record["identifiers"]["mask"] != 0]),
        scheduling=np.array(record["scheduling"]),
        lateness=np.array(record["lateness"]),
        cycle_time=np.array(record["cycle_time"]),
        lost=records_lost + frames_lost,
    )


def newest_events(record: np.void, count: int) -> np.ndarray:
    """Copies of the newest `count` events of a mapped state file, oldest first.

    Plain Python has no fences, so an event that is just being written may be read half: whoever shows it reads it
    again at the next look and keeps nothing of it.
    """
    written = int(record["events_written"][0])
    first = max(0, written - count)
    events: np.ndarray = record["events"][np.arange(first, written) % layout.EVENT_SLOTS]
    intact_from = int(record["events_written"][0]) - layout.EVENT_SLOTS + 1  # older ones were overwritten meanwhile
    return events[max(0, intact_from - first) :]


def _records(memory: MemoryFile, rings: layout.Rings, joint_count: int) -> tuple[np.ndarray, int]:
    """The whole records of cycles in their order, and how many are not whole."""
    dtype = record_dtype(joint_count)
    copy, numbers = _copied(memory, layout.STATE.itemsize, rings.record_bytes, rings.record_slots, "records_written")
    found = np.frombuffer(copy, dtype)
    view = memoryview(copy)
    slots = numbers % rings.record_slots
    whole = [
        int(slot)
        for slot, number in zip(slots.tolist(), numbers.tolist(), strict=True)
        if int(found["number"][slot]) == number
        and is_whole(view[slot * rings.record_bytes : (slot + 1) * rings.record_bytes])
    ]
    return found[whole], len(numbers) - len(whole)


def _frames(memory: MemoryFile, rings: layout.Rings) -> tuple[np.ndarray, int]:
    """The whole records of frames in their order, and how many are not whole."""
    dtype = layout.BUS_FRAME
    if rings.frame_slots == 0:
        return np.zeros(0, dtype), 0
    copy, numbers = _copied(memory, rings.frames_at, dtype.itemsize, rings.frame_slots, "frames_written")
    found = np.frombuffer(copy, dtype)[numbers % rings.frame_slots]
    whole = found["check"] == frame_check(numbers, found["monotonic_ns"], found["head"], found["data"])
    return found[whole], int(np.count_nonzero(~whole))


def _copied(memory: MemoryFile, at: int, size: int, slots: int, head: str) -> tuple[bytes, np.ndarray]:
    """A copy of a ring, and the numbers of the records that were written before and not overwritten meanwhile."""
    written = int(memory.record[head][0])
    copy = memory.map[at : at + size * slots]
    latest = max(int(memory.record[head][0]), written)
    oldest = max(latest - slots + 1, 0)  # the slot of the one before it may just be written again
    return copy, np.arange(min(oldest, written), written)
