"""What the encoders of a running arm say, cycle by cycle, from the flight recorder of its state file.

The recorder keeps the last half minute, so a reader that is kept waiting for some seconds loses nothing.
"""

from __future__ import annotations

import numpy as np

from rtarm.teach.making import Readings
from shm.files import MemoryFile
from shm.recording import now_at, read_on
from shm.words import Fault, Mode


class FreeMotion:
    """What is read while an arm is led by hand, from now on until it is free no more.

    Attributes:
        ended: whether it is free no more, or a joint's angle is not known any more.
        lost: cycles that were overwritten before they were read.
        last: the newest cycle's record, None before the first.
    """

    def __init__(self, memory: MemoryFile) -> None:
        self._memory = memory
        self._read_to = now_at(memory)
        self._times_ns: list[np.ndarray] = []
        self._positions: list[np.ndarray] = []
        self.ended = False
        self.lost = 0
        self.last: np.void | None = None

    def take(self) -> None:
        """Read the cycles that have come since."""
        if self.ended:
            return
        recording, then = read_on(self._memory, self._read_to)
        records = recording.records
        self.lost += then.records - self._read_to.records - len(records)
        self._read_to = then
        joints = records["joints"]
        led = (
            (records["mode"] == Mode.FREE)
            & (records["fault"] == Fault.NONE)
            & np.logical_and.reduce(joints["referenced"] != 0, axis=1)
        )
        if not led.all():
            self.ended = True
            self.last = records[np.argmin(led)]
            records = records[: np.argmin(led)]
        elif len(records):
            self.last = records[-1]
        if len(records):
            self._times_ns.append(records["joints"]["measured_ns"])
            self._positions.append(records["joints"]["measured_position_rad"])

    def readings(self) -> list[Readings]:
        """What each joint's encoder said, each reading once; times count from the first of all."""
        if not self._times_ns:
            return []
        times_ns, positions_rad = np.concatenate(self._times_ns), np.concatenate(self._positions)
        begin_ns = times_ns[0].min()
        return [
            Readings((times[fresh] - begin_ns) * 1e-9, places[fresh])
            for times, places in zip(times_ns.T, positions_rad.T, strict=True)
            for fresh in (np.flatnonzero(np.diff(np.maximum.accumulate(times), prepend=times[0] - 1)),)
        ]
