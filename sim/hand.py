"""A hand that leads the limp joints of a simulated arm along a motion, as somebody does who teaches it.

It takes hold once all joints are limp, waits a moment, and leads each joint along its motion from where it took hold;
then it holds still, until the drives take over. Let go again, the arm is led again. What is led is the shaft: the
drives' encoders count what they see, and the host reads it over the bus as ever.

A motion is a CSV file: `time_s,joint1,joint4`, then a row a moment, in degrees from where the hand took hold, straight
lines between; a joint that is not named stays where it is. The names of `HANDS_FOLDER` come with rtarm.

Not modelled: what the arm weighs, and how a hand gives way. A stop stands in the hand's way as in a drive's; a drive
that holds does not give way, and ends the leading.
"""

from __future__ import annotations

import csv
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from config.joint import JointConfig
from sim.bus import Frame, Outbox
from sim.drives.drive import Drive

HANDS_FOLDER = Path(__file__).parent / "hands"
LONGEST_FILE_BYTES = 10_000_000
TAKES_HOLD_NS = 1_500_000_000
"""From the moment all joints are limp to the first motion."""
LOOKS_NS = 20_000_000
"""How often it feels whether the joints are limp."""
STEP_NS = 2_000_000
"""How often its speed changes while it leads."""


@dataclass(frozen=True)
class Guided:
    """A motion of joints by their names: `angles_rad` (rows, joints) from where they were, at `times_s` (rows,)."""

    joints: tuple[str, ...]
    times_s: NDArray[np.float64]
    angles_rad: NDArray[np.float64]

    def of(self, joints: Sequence[str]) -> Guided:
        """What of the motion is of these joints."""
        led = [name in joints for name in self.joints]
        return Guided(tuple(compress(self.joints, led)), self.times_s, self.angles_rad[:, led])


def load_guided(name_or_path: str, joints: Sequence[str]) -> Guided:
    """Read a hand's motion of an arm with these joints.

    Raises:
        ValueError: with a sentence; there is no such file, or no such motion in it.
    """
    own = {path.stem: path for path in sorted(HANDS_FOLDER.glob("*.csv"))}
    path = own.get(name_or_path, Path(name_or_path))
    form = "give a CSV file: time_s and names of joints, then rows of seconds and degrees"
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_FILE_BYTES + 1)
    except OSError as error:
        raise ValueError(
            f"the hand's motion {name_or_path} cannot be read ({error.strerror}); give a CSV file, or one of "
            f"{', '.join(own)}."
        ) from None
    if len(data) > LONGEST_FILE_BYTES:
        raise ValueError(f"the hand's motion {path} has more than {LONGEST_FILE_BYTES} bytes; give a shorter one.")
    try:
        head, *rows = [row for row in csv.reader(data.decode().splitlines()) if row]
        values = np.array([[float(value) for value in row] for row in rows])
    except ValueError:
        raise ValueError(f"the hand's motion {path} is no table of numbers below a line of names; {form}.") from None
    names = tuple(head[1:])
    strangers = [name for name in names if name not in joints]
    if head[0] != "time_s" or not names or strangers or len(set(names)) != len(names):
        raise ValueError(
            f"the hand's motion {path} begins with {','.join(head)!r}, but must name time_s and joints of "
            f"{', '.join(joints)}; {form}."
        )
    if values.shape != (len(rows), len(head)) or len(rows) < 2 or not np.isfinite(values).all():
        raise ValueError(f"the hand's motion {path} is no table of {len(head)} finite columns; {form}.")
    times_s = values[:, 0]
    if times_s[0] != 0.0 or not (np.diff(times_s) > 0.0).all():
        raise ValueError(f"the times of the hand's motion {path} must begin with 0 and rise; {form}.")
    return Guided(names, times_s, np.radians(values[:, 1:] - values[0, 1:]))


class Hand:
    """Somebody who leads an arm's joints; on the bus only so as to be woken in order.

    Args:
        guided: where to.
        joints, drives: of the arm, in its order.
        start_ns: when it begins to exist.
    """

    def __init__(self, guided: Guided, joints: Sequence[JointConfig], drives: Sequence[Drive], start_ns: int) -> None:
        self.outbox: Outbox = deque()
        self.listening = False
        self.address: int | None = None
        self.wake_ns = start_ns
        self._drives = drives
        self._end_ns = round(guided.times_s[-1] * 1e9)
        self._times_s = guided.times_s
        self._led = []
        for name, angles_rad in zip(guided.joints, guided.angles_rad.T, strict=True):
            index = [joint.name for joint in joints].index(name)
            turns_per_rad = joints[index].direction * joints[index].ratio / (2.0 * math.pi)
            self._led.append((drives[index], angles_rad * turns_per_rad))
        self._begin_ns: int | None = None
        self._held_at: list[float] = []

    def wake(self, now_ns: int) -> None:
        """Take hold, lead on, or let go."""
        for drive in self._drives:
            drive.advance(now_ns)
        if not all(drive.limp for drive in self._drives):
            if self._begin_ns is not None:
                self._lead(now_ns, [0.0] * len(self._led))
            self._begin_ns = None
        elif self._begin_ns is None:
            self._begin_ns = now_ns + TAKES_HOLD_NS
            self._held_at = [drive.shaft.past(now_ns)[0] for drive, _ in self._led]
        leads = self._begin_ns is not None and self._begin_ns <= now_ns <= self._begin_ns + self._end_ns + STEP_NS
        if leads:
            self._lead(now_ns, [self._speed(now_ns, number) for number in range(len(self._led))])
        self.wake_ns = now_ns + (STEP_NS if leads else LOOKS_NS)

    def _speed(self, now_ns: int, number: int) -> float:
        """Revolutions a second with which a joint's shaft is where it should be at the next step; 0 at the end."""
        assert self._begin_ns is not None
        after_ns = now_ns + STEP_NS - self._begin_ns
        if after_ns > self._end_ns + STEP_NS:
            return 0.0
        drive, turns = self._led[number]
        wanted = self._held_at[number] + float(np.interp(after_ns * 1e-9, self._times_s, turns))
        return (wanted - drive.shaft.past(now_ns)[0]) / (STEP_NS * 1e-9)

    def _lead(self, now_ns: int, speeds: Sequence[float]) -> None:
        for (drive, _), speed in zip(self._led, speeds, strict=True):
            if drive.limp:
                drive.lead(now_ns, speed)

    def receive(self, now_ns: int, frame: Frame) -> None:
        """It does not listen."""

    def sent(self, now_ns: int, frame: Frame) -> None:
        """It does not send."""
