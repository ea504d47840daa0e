"""A recording as an MCAP file: JSON messages with their schemas, which Foxglove plots, and back again.

Channels: `/rtarm/state` and `/rtarm/joints/<joint>` in every cycle, of which they carry the `number`, `/rtarm/events`
with their sentences (as a log), `/rtarm/frames` of the bus; made of these, so that `mcap_reader` lets them be,
`/rtarm/commands` (what was asked, and the answers) and `/rtarm/statistics` once a second. Times are those of ROS; what
the motion is timed by stands in `monotonic_ns` of the state. What else is known of the arm leads the file as metadata,
so that one that was cut off can still be told, and a file of others' is known before it is read to its end.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import IO, NamedTuple

import numpy as np

from shm import layout
from shm.recording import Recording
from shm.words import BusState, Fault, Mode, Outcome, Phase, Unreferenced

MAGIC = b"\x89MCAP0\r\n"
FORMAT = "1"
METADATA, LIMITS, TIMING = "rtarm", "rtarm.limits", "rtarm.timing"
STATE, JOINTS, EVENTS, FRAMES = "/rtarm/state", "/rtarm/joints/", "/rtarm/events", "/rtarm/frames"
COMMANDS, STATISTICS = "/rtarm/commands", "/rtarm/statistics"
LIBRARY = "rtarm "
"""So begins what our files say that they were written by."""
JSON = "json"
CHUNK_BYTES = 256 << 10
"""So much is lost at most around a spoilt byte."""
BATCH = 1000
"""Cycles that are handled at once."""
LONGEST_RECORD = 64 << 20
"""Bytes; one of ours has hardly more than a chunk, even where another tool has packed it anew."""
LONGEST_NAME, LONGEST_SENTENCE = 64, 1000
"""Characters of what a file may say to people."""
NAMED: dict[str, type[IntEnum]] = {
    "mode": Mode,
    "fault": Fault,
    "goal_phase": Phase,
    "ending": Outcome,
    "unreferenced_reason": Unreferenced,
    "bus_state": BusState,
}
"""Numbers that stand in the file by name."""
_SUMS = ("crc", "decisions_crc")
CYCLE_WORDS = [name for name in layout.CycleRecord.words if name not in (*_SUMS, "joints")]
JOINT_WORDS = list(layout.Joint.words)
LATER_CYCLE_WORDS = ("held", "stops", "epoch", "fault_silent", "fault_evidence")
"""What files of before do not have; they are 0 then."""
LATER_JOINT_WORDS = ("drive_temperature_c", "drive_voltage_v")
"""What files of before do not have; they are NaN then."""
EVENT_WORDS = list(layout.Event.words)
LATER_EVENT_WORDS = ("silent", "evidence")
"""What files of before do not have; they are 0 then."""
STATE_MESSAGE = np.dtype([(name, layout.CycleRecord.dtype[name]) for name in CYCLE_WORDS])
JOINT_MESSAGE = np.dtype([("number", np.int64), *((name, layout.Joint.dtype[name]) for name in JOINT_WORDS)])
"""A message of a cycle's state and of a joint in it, as numbers."""


Step = Callable[[float], None]
"""Is told how much of a work is done, 0…1."""


class Reason(NamedTuple):
    """Why a recording was written: a word, and a sentence."""

    word: str
    sentence: str


class Loaded(NamedTuple):
    """A recording out of a file, why it was written, and what is wrong with the file ("" if nothing)."""

    recording: Recording
    reason: Reason
    damage: str


def library_of(file: IO[bytes]) -> str | None:
    """What an MCAP file says that it was written by; None if that cannot be read."""
    from mcap.records import Header
    from mcap.stream_reader import StreamReader

    file.seek(0)
    try:
        header = next(StreamReader(file, record_size_limit=CHUNK_BYTES).records)
    except OSError:
        raise
    except Exception:  # whatever a parser makes of anything
        return None
    return header.library if isinstance(header, Header) else None
