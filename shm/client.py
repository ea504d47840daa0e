"""Plain Python's side of the border: reading snapshots, writing goals and requests.

CPython has no memory fences, so nothing here rests on order: what is read is checked by sequence and CRC,
what is written carries a CRC that the loop checks before it believes a word.
"""

import os
import struct
import threading
import time
import zlib

import numpy as np

from shm import layout
from shm.errors import RingFull, TornRead
from shm.files import MemoryFile, producers_lock
from shm.record import offset_of
from shm.snapshot import Snapshot
from shm.words import Request, Setpoint

READ_TRIES = 1000
MOST_WRITTEN = 1 << 62
GOALS_AHEAD = 1_000_000
"""Goal ids rise by one; a word that is this far ahead of all others was not written by a front."""

_SNAPSHOT_AT = offset_of(layout.StateFile, "snapshot")
_SEQUENCE_AT = offset_of(layout.StateFile, "snapshot_sequence") // 8
_CYCLE_AT = offset_of(layout.StateFile, "snapshot", "cycle") // 8
_SETPOINTS_CONSUMED_AT = offset_of(layout.StateFile, "consumed", "setpoints") // 8
_REQUESTS_CONSUMED_AT = offset_of(layout.StateFile, "consumed", "requests") // 8
_COMMAND_WORD = {
    name: offset_of(layout.CommandFile, name) // 8
    for name in (
        *("heartbeat_ns", "announced_goal", "setpoints_written", "requests_written"),
        *("stop_ns", "hold_ns", "resume_ns", "speed_scale", "canceled_through", "canceled_goals"),
    )
}
_REQUESTS_AT = offset_of(layout.CommandFile, "requests")
_SETPOINTS_AT = offset_of(layout.CommandFile, "setpoints")
_BEGIN_HEAD = struct.Struct("<qqqqqqdqq")
_WAYPOINT_HEAD = struct.Struct("<qqqqqqqqq")
_REQUEST = struct.Struct("<qqqdqqqd")


class StateReader:
    """Consistent snapshots of a mapped state file."""

    def __init__(self, memory: MemoryFile) -> None:
        self.memory = memory
        self.joint_count = int(memory.record["header"]["joint_count"])
        self._bytes = memoryview(memory.map)
        self._words = self._bytes.cast("q")
        self._end = _SNAPSHOT_AT + layout.used_bytes(layout.Snapshot, self.joint_count)

    def newest_cycle(self) -> int:
        """Number of the cycle whose snapshot is there or just being written, unchecked: worth a look, no more."""
        return self._words[_CYCLE_AT]

    def snapshot(self) -> Snapshot:
        """The newest complete snapshot.

        Raises TornRead after a bounded number of tries: a dead writer never makes a reader wait.
        """
        for attempt in range(READ_TRIES):
            before = self._words[_SEQUENCE_AT]
            if not before & 1:
                copy = bytes(self._bytes[_SNAPSHOT_AT : self._end])
                if self._words[_SEQUENCE_AT] == before:
                    crc = int.from_bytes(copy[:8], "little")
                    if crc == zlib.crc32(memoryview(copy)[8:]):
                        return Snapshot(copy)
            if attempt > 10:
                time.sleep(0)
        raise TornRead(
            "No consistent snapshot in {path} after {tries} tries: the control process died or hangs in mid-write; "
            "look at `rtarm status`, then start it again.",
            path=self.memory.path,
            tries=READ_TRIES,
        )

    def setpoints_consumed(self) -> int:
        return self._words[_SETPOINTS_CONSUMED_AT]

    def requests_consumed(self) -> int:
        return self._words[_REQUESTS_CONSUMED_AT]

    def close(self) -> None:
        self._words.release()
        self._bytes.release()
        self.memory.close()


class CommandWriter:
    """Writes what is asked of an arm and, for the front that owns the file, goals and the heartbeat.

    Stop, hold, resume, speed scale and cancels are one store each, of which the newest counts: nothing stands before
    them, none is lost, and no process that holds a lock keeps them.
    """

    def __init__(self, memory: MemoryFile) -> None:
        self.memory = memory
        self.joint_count = int(memory.record["header"]["joint_count"])
        self._bytes = memoryview(memory.map)
        self._words = self._bytes.cast("q")
        self._reals = self._bytes.cast("d")
        self._threads = threading.Lock()

    def beat(self, now_ns: int | None = None) -> None:
        """The front's sign of life."""
        self._words[_COMMAND_WORD["heartbeat_ns"]] = time.monotonic_ns() if now_ns is None else now_ns

    @property
    def setpoints_written(self) -> int:
        return self._words[_COMMAND_WORD["setpoints_written"]]

    @property
    def announced_goal(self) -> int:
        return self._words[_COMMAND_WORD["announced_goal"]]

    def announce(self, goal_id: int) -> None:
        """Say that records of a newer goal follow: the loop stops taking waypoints of older ones."""
        self._words[_COMMAND_WORD["announced_goal"]] = goal_id

    def begin(
        self,
        goal_id: int,
        *,
        start_ns: int,
        joint_mask: int,
        goal_time_s: float,
        entry: int,
        epoch: int,
        tolerances: np.ndarray,
        consumed: int,
    ) -> None:
        """Open a goal; `entry` is a shm.words.Entry, `tolerances` (joint_count, 3) those on the way, in SI.

        `epoch` is the snapshot's when the goal arrived.
        """
        head = _BEGIN_HEAD.pack(
            0, self.setpoints_written, goal_id, Setpoint.BEGIN, start_ns, joint_mask, goal_time_s, entry, epoch
        )
        self._append(head, np.ascontiguousarray(tolerances, "f8").tobytes(), consumed)

    def waypoint(self, goal_id: int, time_ns: int, order: int, joints: np.ndarray, consumed: int) -> None:
        """Append a waypoint; `joints` is (joint_count, 3): position, velocity, acceleration in SI.

        Raises RingFull when the loop has not taken earlier records yet.
        """
        head = _WAYPOINT_HEAD.pack(0, self.setpoints_written, goal_id, Setpoint.WAYPOINT, time_ns, order, 0, 0, 0)
        self._append(head, np.ascontiguousarray(joints, "f8").tobytes(), consumed)

    def end(self, goal_id: int, tolerances: np.ndarray, consumed: int) -> None:
        """Close a goal: no waypoint follows; `tolerances` (joint_count, 3) are those at its end, in SI."""
        head = _WAYPOINT_HEAD.pack(0, self.setpoints_written, goal_id, Setpoint.END, 0, 0, 0, 0, 0)
        self._append(head, np.ascontiguousarray(tolerances, "f8").tobytes(), consumed)

    def _append(self, head: bytes, joints: bytes, consumed: int) -> None:
        written = self.setpoints_written
        if not 0 <= written - consumed < layout.SETPOINT_SLOTS - 1:  # below 0 somebody else has written there
            raise RingFull(f"{written - consumed} records wait in the ring of {layout.SETPOINT_SLOTS}.")
        body = head[8:] + joints
        at = _SETPOINTS_AT + (written % layout.SETPOINT_SLOTS) * layout.Setpoint.dtype.itemsize
        self._bytes[at : at + 8 + len(body)] = zlib.crc32(body).to_bytes(8, "little") + body
        self._words[_COMMAND_WORD["setpoints_written"]] = written + 1

    def stop(self) -> None:
        """A person's stop: on the path, every goal ends, and nothing begins before a resume."""
        self._store("stop_ns", time.monotonic_ns())

    def hold(self) -> None:
        """Pause what runs; nothing begins before a resume."""
        self._store("hold_ns", time.monotonic_ns())

    def resume(self) -> None:
        """Let a held goal go on, and a stopped arm take goals again."""
        last_ns = max(self._words[_COMMAND_WORD[name]] for name in ("stop_ns", "hold_ns"))
        # Later than both, also in a file that somebody has spoilt.
        self._store("resume_ns", max(time.monotonic_ns(), min(last_ns, MOST_WRITTEN) + 1))

    def cancel(self, goal_id: int) -> None:
        """End a goal by a stop on its path, whether it has begun, waits or is still to come."""
        self._words[_COMMAND_WORD["canceled_goals"] + goal_id % layout.CANCELED_SLOTS] = goal_id

    def cancel_all(self) -> None:
        """The same with every goal that was ever announced."""
        self._words[_COMMAND_WORD["canceled_through"]] = self.announced_goal

    def scale(self, speed_scale: float) -> None:
        """Let every goal run at 0…1 of its own speed."""
        at = _COMMAND_WORD["speed_scale"]
        self._reals[at + 1] = os.getpid()
        self._reals[at] = speed_scale or -0.0  # whose bits are not those of a file in which nobody has asked

    def _store(self, name: str, word: int) -> None:
        """Who asks first: what counts is one word."""
        at = _COMMAND_WORD[name]
        self._words[at + 1] = os.getpid()
        self._words[at] = word

    def request(
        self,
        kind: Request,
        *,
        consumed: int,
        epoch: int,
        value: float = 0.0,
        joint_mask: int = 0,
        effort: float = 0.0,
    ) -> int:
        """Append a request and return its sequence number, under which the snapshot will answer.

        `consumed` is the number of requests that the control process has taken, `epoch` the snapshot's. Raises RingFull
        when it has not taken earlier ones yet, or another process that asks stands still in the middle of it.
        """
        with self._threads, producers_lock(self.memory.fd):
            written = self._words[_COMMAND_WORD["requests_written"]]
            if not 0 <= written <= MOST_WRITTEN:
                written = 0  # nobody asks so much: the loop says that the ring is corrupt, and then goes on from here
            if written - consumed >= layout.REQUEST_SLOTS - 1:
                raise RingFull(
                    "{waiting} requests wait for the control process: try again in a moment.",
                    waiting=written - consumed,
                )
            packed = _REQUEST.pack(0, written + 1, kind, value, time.monotonic_ns(), joint_mask, epoch, effort)
            at = _REQUESTS_AT + (written % layout.REQUEST_SLOTS) * layout.Request.dtype.itemsize
            crc = zlib.crc32(packed[8:]).to_bytes(8, "little")
            self._bytes[at : at + len(packed)] = crc + packed[8:]
            self._words[_COMMAND_WORD["requests_written"]] = written + 1
        return int(written) + 1

    def close(self) -> None:
        self._words.release()
        self._reals.release()
        self._bytes.release()
        self.memory.close()
