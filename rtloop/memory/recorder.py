"""The flight recorder: every cycle and every CAN frame of the last half minute, in rings of the state file.

A cycle's record is the changing part of its snapshot, copied as it stands, behind what only the recorder keeps. Readers
never make the cycle wait; they tell a record that is whole from one that is just being overwritten, or was when
its writer died, by its check sum, whatever order their processor reads in. The snapshot's own CRC goes into it, so
that only the recorder's few words are summed again.
"""

from compilation.jit import jit
from rtloop.memory.frame_words import EXTENDED, REMOTE
from rtloop.memory.state import Loop
from shm import layout, recording
from shm.atomics import load_relaxed, store_relaxed, store_release
from shm.layout import StateFile
from shm.record import offset_of
from shm.seqlock import copy_words, crc32_at
from shm.words import Outcome, Phase, Slowed

SENT = recording.SENT

_RECORDS_WRITTEN = offset_of(layout.StateFile, "records_written")
_FRAMES_WRITTEN = offset_of(layout.StateFile, "frames_written")
_RINGS = layout.StateFile.dtype.itemsize
_FRAME_BYTES = layout.BusFrame.dtype.itemsize
_HEARTBEAT = offset_of(layout.CommandFile, "heartbeat_ns")
_FIRST_COUNTED = next(iter(layout.Counted.words))
_COUNTED = offset_of(layout.StateFile, "counters", _FIRST_COUNTED)
_COUNTED_WORDS = len(layout.Counted.words)

_RECORD = offset_of(Loop, "record")
_NUMBER = offset_of(layout.CycleRecord, "number")
_OWN_COUNTED = offset_of(layout.CycleRecord, _FIRST_COUNTED)
_OWN_BYTES = offset_of(layout.CycleRecord, "cycle")
_OWN_WORDS = (_OWN_BYTES - _NUMBER) // 8
_CHANGING = offset_of(Loop, "snapshot") + offset_of(layout.Snapshot, "cycle")

# numba adds up no members of an enumeration, so they are plain integers here.
_HELD, _CLOSING, _OWN_BRAKE = int(Slowed.HELD), int(Slowed.CLOSING), int(Slowed.OWN_BRAKE)

frame_check = jit(recording.frame_check)


@jit
def slowed(loop: Loop) -> int:
    """Why the arm is slowed down or stopped, as bits of shm.words.Slowed."""
    why = loop.goals.slowed
    if loop.paths[loop.goals.active].phase == Phase.PAUSED:
        why |= _HELD
    if loop.motion.closing == 1:
        why |= _CLOSING
    if loop.motion.per_joint_stop == 1:
        why |= _OWN_BRAKE
    return why


@jit
def record_cycle(loop: Loop, shared: StateFile) -> None:
    """Keep this cycle, whose snapshot has just been made and summed; allocates nothing, waits for nobody."""
    params, record = loop.params, loop.record
    slots = shared.recorder.record_slots
    if slots == 0:
        return
    head = params.state_address + _RECORDS_WRITTEN
    number = load_relaxed(head)
    record.number = number
    record.lateness_ns = loop.timing.lateness_ns
    record.cycle_time_ns = loop.timing.cycle_time_ns
    record.heartbeat_ns = load_relaxed(params.command_address + _HEARTBEAT)
    record.slowed = slowed(loop)
    running = loop.paths[loop.goals.active]
    record.ending = running.reason if running.phase == Phase.STOPPING else Outcome.NONE
    record.decisions_crc = loop.published.decisions_crc
    own = params.address + _RECORD
    copy_words(own + _OWN_COUNTED, params.state_address + _COUNTED, _COUNTED_WORDS)
    record.crc = crc32_at(own + _NUMBER, _OWN_WORDS, loop.snapshot.crc)
    target = params.state_address + _RINGS + number % slots * shared.recorder.record_bytes
    copy_words(target, own, _OWN_BYTES // 8)
    words = (shared.recorder.record_bytes - _OWN_BYTES) // 8
    copy_words(target + _OWN_BYTES, params.address + _CHANGING, words)
    # pairs with `shm.recording`, which also checks number and sum: the record is whole before it is counted
    store_release(head, number + 1)


@jit
def marks_of(kind: int) -> int:
    """A frame's kind (`rtloop.memory.frame_words`) as it is recorded."""
    marks = recording.EXTENDED if kind & EXTENDED else 0
    return marks | recording.REMOTE if kind & REMOTE else marks


@jit
def record_frame(
    loop: Loop, shared: StateFile, bus: int, time_ns: int, frame_id: int, marks: int, length: int, data: int
) -> None:
    """Keep a CAN frame of the bus of a number; `marks` are SENT and those of its kind."""
    slots = shared.recorder.frame_slots
    if slots == 0:
        return
    written = loop.params.state_address + _FRAMES_WRITTEN
    number = load_relaxed(written)
    head = frame_id | (length << recording.LENGTH_SHIFT) | marks | (bus << recording.BUS_SHIFT)
    ring = _RINGS + shared.recorder.record_slots * shared.recorder.record_bytes
    target = loop.params.state_address + ring + number % slots * _FRAME_BYTES
    store_relaxed(target, frame_check(number, time_ns, head, data))
    store_relaxed(target + 8, time_ns)
    store_relaxed(target + 16, head)
    store_relaxed(target + 24, data)
    # pairs with `shm.recording`, which also checks number and sum: the frame is whole before it is counted
    store_release(written, number + 1)
