"""What stands behind the page: a running arm, or a recording."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Protocol

import numpy as np

from config.schema import ArmConfig
from rtarm.console.language import said
from rtarm.recording.playback import Playback
from rtarm.top.watch import Look, Watch
from rtarm.view.path import GoalPath, thinned
from sentences.meaning import Language
from shm import files, layout
from shm.errors import SharedMemoryError
from shm.files import MemoryFile
from shm.recording import Recording, is_whole, record_dtype

NS = 1_000_000_000
COMMANDED = ("commanded_position_rad", "commanded_velocity_rad_s", "commanded_acceleration_rad_s2")
SHOWN_S = 30.0
"""As far back as the plots go."""


class Source(Protocol):
    """What can be looked at again and again."""

    joints: tuple[str, ...]
    """Names, in the order of the arm file."""

    def look(self) -> Look:
        """What there is to be seen now."""

    def cycles(self) -> np.ndarray:
        """The cycles since the last call, oldest first, those of the last `SHOWN_S` at the most.

        Of dtype `shm.recording.record_dtype`.
        """

    def path(self) -> np.ndarray:
        """Joint angles (n, joints) along the running goal as far as it is known, none where no goal runs."""

    def close(self) -> None:
        """Nobody will look any more."""


class LiveArm:
    """A running arm, through restarts of its processes.

    Raises:
        SharedMemoryError: no control process of that arm runs now, or its files are not what they should be.
    """

    def __init__(self, arm: ArmConfig, language: Language = "en") -> None:
        self.joints = tuple(joint.name for joint in arm.joints)
        self._watch = Watch(arm.name, language)
        self._recorder = FollowedRecorder(arm.name)
        self._path = GoalPath(arm.name, len(self.joints))
        self._goal_id = 0
        self._start = np.zeros((len(self.joints), 3))

    def look(self) -> Look:
        """What there is to be seen now; never waits and never raises for what happens to the arm."""
        look = self._watch.look()
        found = () if look.report is None else tuple(joint["name"] for joint in look.report["joints"])
        if look.trouble is None and found and found != self.joints:
            return replace(look, report=None, trouble=_another_arm(look, found))
        return look

    def cycles(self) -> np.ndarray:
        """The cycles since the last call; none while another arm of that name runs."""
        records = self._recorder.take()
        if records["joints"].shape[1] != len(self.joints):
            return np.zeros(0, record_dtype(len(self.joints)))
        if len(records) and self._goal_id != (goal_id := int(records[-1]["goal_id"])):
            first = records["joints"][records["goal_id"] == goal_id][0]
            self._goal_id, self._start = goal_id, np.stack([first[word] for word in COMMANDED], axis=-1)
        return records

    def path(self) -> np.ndarray:
        """Joint angles along the running goal, as far as the ROS process has handed it over."""
        return self._path.of(self._goal_id, self._start)

    def close(self) -> None:
        """Let go of the memory files."""
        self._watch.close()
        self._recorder.close()
        self._path.close()


def _another_arm(look: Look, joints: tuple[str, ...]) -> str:
    return said(
        look.language,
        "Another arm of the name {arm} runs now, with joints {joints}: end this page and start `rtarm view` again with "
        "its arm file.",
        arm=look.arm,
        joints=", ".join(joints),
    )


class FollowedRecorder:
    """The cycles of an arm as they come, from its flight recorder.

    Plain Python has no fences; a record that is just being written does not pass its check sum and is left out.
    """

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self._memory: MemoryFile | None = None
        self._next = 0

    def take(self) -> np.ndarray:
        """The cycles since the last call; never raises for what happens to the arm."""
        if self._memory is not None and not files.is_held(self._memory.fd):
            self.close()
        if self._memory is None:
            with contextlib.suppress(SharedMemoryError):
                self._memory, self._next = files.open_state(self._arm), 0
        if self._memory is None:
            return np.zeros(0, record_dtype(1))
        return self._taken(self._memory)

    def close(self) -> None:
        """Let go of the state file."""
        if self._memory is not None:
            self._memory.close()
            self._memory = None

    def _taken(self, memory: MemoryFile) -> np.ndarray:
        header = memory.record["header"]
        joints, period_ns, rings = int(header["joint_count"]), int(header["period_ns"]), files.rings(header)
        written = int(memory.record["records_written"][0])
        most = min(round(SHOWN_S * NS / period_ns), rings.record_slots - 1)
        numbers = range(max(self._next, written - most), written)
        self._next = written
        size, start = rings.record_bytes, layout.StateFile.dtype.itemsize
        copies = (start + number % rings.record_slots * size for number in numbers)
        records = [memory.map[at : at + size] for at in copies]
        whole = b"".join(record for record in records if is_whole(memoryview(record)))
        return np.frombuffer(whole, record_dtype(joints))


class RecordedArm:
    """A recording, played in its own time or slower or quicker."""

    def __init__(self, recording: Recording, playback: Playback) -> None:
        """`playback` is of that recording."""
        self.joints = recording.joints
        self._playback = playback
        self._records = recording.records
        self._next = 0

    def look(self) -> Look:
        """What was to be seen at the time that has been reached."""
        return self._playback.look()

    def cycles(self) -> np.ndarray:
        """The cycles that were reached since the last call."""
        first, self._next = self._next, self._playback.reached()
        oldest_ns = int(self._records["monotonic_ns"][max(self._next - 1, 0)]) - round(SHOWN_S * NS)
        first = max(first, int(np.searchsorted(self._records["monotonic_ns"], oldest_ns)))
        return self._records[first : self._next]

    def path(self) -> np.ndarray:
        """Joint angles along the goal that was running, what is still to come included."""
        goal_id = int(self._records["goal_id"][max(self._next - 1, 0)])
        of_goal = self._records[self._records["goal_id"] == goal_id] if goal_id else self._records[:0]
        return thinned(of_goal["joints"]["commanded_position_rad"])

    def close(self) -> None:
        """Nothing is held open."""
        self._playback.close()
