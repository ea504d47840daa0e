"""The words of a transcript by name, and where they stand today.

The names are those of the recordings and stay. When a word moves or is renamed, what changes is this file: a name in
`RENAMED`, or the way in which `tables` and `words_of` look it up.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from motion.gripping import Grip
from shm import layout
from shm import words as numbers

CYCLE = (
    *("cycle", "monotonic_ns", "epoch_ns", "mode", "fault", "fault_joint", "fault_value", "fault_limit", "fault_ns"),
    *("goal_id", "goal_phase", "trajectory_clock_ns", "trajectory_end_ns", "speed_scale", "speed_scale_target"),
    *("speed_scale_asked", "motion_started", "referencing_joint", "pose_due", "held", "stops", "epoch"),
    *("fault_silent", "fault_evidence"),
)
JOINT = (
    *("commanded_position_rad", "commanded_velocity_rad_s", "commanded_acceleration_rad_s2", "measured_position_rad"),
    *("measured_velocity_rad_s", "measured_effort", "measured_ns", "reference_position_rad"),
    *("reference_velocity_rad_s", "drive_temperature_c", "drive_voltage_v", "drive_status", "referenced"),
    "unreferenced_reason",
)
COUNTERS = (
    *("overruns", "frames_sent", "frames_received", "bits_on_bus", "bytes_sent", "bytes_received", "wire_errors"),
    *("bytes_unsent", "receive_overflows", "stale_reads", "drive_errors", "knots_taken", "error_frames"),
    *("unacknowledged", "bus_state"),
)
GRIPPER = (
    *("written", "monotonic_ns", "order", "grip", "trouble", "trouble_value", "measured_ns", "position_rad"),
    *("velocity_rad_s", "measured_effort", "target_rad"),
)
RESULT = ("goal_id", "outcome", "joint", "value", "limit", "monotonic_ns")
ANSWER = ("sequence", "answer")
EVENT = ("monotonic_ns", "kind", "joint", "code", "value", "limit", "silent", "evidence")

LATER = frozenset({"fault_silent", "fault_evidence", "silent", "evidence"})
"""Words that a recording may lack, since they were 0 in all of its cycles and there were none when it was made."""

RENAMED: dict[str, str] = {}
"""Words that bear another name in the layout of today: recorded name, present one."""

MEANINGS: dict[str, type[IntEnum]] = {
    "mode": numbers.Mode,
    "fault": numbers.Fault,
    "goal_phase": numbers.Phase,
    "unreferenced_reason": numbers.Unreferenced,
    "outcome": numbers.Outcome,
    "answer": numbers.Answer,
    "kind": numbers.Event,
    "bus_state": numbers.BusState,
    "gripper.grip": Grip,
    "gripper.trouble": numbers.GripTrouble,
}
CODES: dict[int, type[IntEnum]] = {
    numbers.Event.MODE: numbers.Mode,
    numbers.Event.FAULT: numbers.Fault,
    numbers.Event.RESULT: numbers.Outcome,
    numbers.Event.REQUEST: numbers.Answer,
    numbers.Event.COMMAND: numbers.Request,
}
"""What an event's code means, by its kind."""

Row = dict[str, int | float]


def is_fast(name: str) -> bool:
    """Whether a word changes in every cycle of a moving arm: scenarios may keep it in some cycles only."""
    last = name.rpartition(".")[2]
    return name.startswith(("counters.", "gripper.")) or (
        "." in name and last not in ("drive_status", "referenced", "unreferenced_reason")
    )


class Published:
    """What a control process has published, read cycle by cycle from its state file's record (layout.StateFile)."""

    def __init__(self) -> None:
        self._cycles: list[Any] = []
        self._counters: list[Any] = []
        self._grippers: list[Any] = []
        self._events = 0
        self._decided = b""
        self._decisions: dict[str, np.ndarray] = {}
        self.joints: list[str] = []

    def take(self, shared: Any) -> list[tuple[str, Row]]:
        """Keep the words of a cycle that has just ended; what it decided and told, in order: table and row."""
        if not self.joints:
            names = bytes(shared["header"]["joint_names"]).split(b"\0")
            self.joints = [name.decode() for name in names if name]
        snapshot = shared["snapshot"]
        self._cycles.append(snapshot.copy())
        self._counters.append(shared["counters"].copy())
        self._grippers.append(shared["gripper"].copy())
        return [*self._told(shared), *self._changed(snapshot)]

    def _told(self, shared: Any) -> list[tuple[str, Row]]:
        written, ring = int(shared["events_written"][0]), shared["events"]
        numbers_told = range(max(self._events, written - len(ring)), written)
        self._events = written
        events = [_row(ring[number % len(ring)], EVENT) for number in numbers_told]
        for event in events:
            if event["kind"] == numbers.Event.COMMAND and event["code"] != numbers.Request.SPEED_SCALE:
                event["value"] = 0.0  # which process asked
        return [("event", event) for event in events]

    def _changed(self, snapshot: Any) -> list[tuple[str, Row]]:
        """Results and answers that are new in this cycle."""
        decided = snapshot["results"].tobytes() + snapshot["answers"].tobytes()
        if decided == self._decided:
            return []
        self._decided = decided
        found: list[tuple[str, Row]] = []
        for table, key, names in (("result", "results", RESULT), ("answer", "answers", ANSWER)):
            now = snapshot[key].copy()
            before = self._decisions.get(key, np.zeros_like(now))
            found += [
                (table, _row(row, names))
                for row, was in zip(now, before, strict=True)
                if row.tobytes() != was.tobytes()
            ]
            self._decisions[key] = now
        return found

    def words(self) -> dict[str, np.ndarray]:
        """Every word by its recorded name, (cycles,) int64 or float64."""
        cycles = np.array(self._cycles, layout.Snapshot.dtype)
        counters = np.array(self._counters, layout.Counters.dtype)
        grippers = np.array(self._grippers, layout.Gripper.dtype)
        found = {name: cycles[_today(name)] for name in CYCLE}
        for name in JOINT:
            for number, joint in enumerate(self.joints):
                found[f"{joint}.{name}"] = cycles["joints"][_today(name)][:, number]
        found |= {f"counters.{name}": counters[_today(name)] for name in COUNTERS}
        if grippers["written"].any():
            found |= {f"gripper.{name}": grippers[_today(name)] for name in GRIPPER}
        return {name: np.ascontiguousarray(values) for name, values in found.items()}


def meaning(name: str, value: float, row: Row | None = None) -> str:
    """A number as people read it; `row` is the one that it stands in, of an event."""
    kind = CODES.get(int(row["kind"])) if row is not None and name == "code" else MEANINGS.get(name.rpartition(".")[2])
    kind = MEANINGS.get(name, kind)
    if kind is not None and value in list(kind):
        return f"{kind(int(value)).name} ({value})"
    return repr(value)


def _row(record: Any, names: Sequence[str]) -> Row:
    return {name: record[_today(name)].item() for name in names}


def _today(name: str) -> str:
    return RENAMED.get(name, name)
