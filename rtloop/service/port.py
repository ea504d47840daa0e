"""The in-process rings between the cycle and ordinary Python, through which conversations use the bus.

The cycle alone accesses the bus. A conversation (bring-up, clearing a fault …) puts frames and orders into
`service_in`. The cycle sends the frames in bus time that is left over, and puts every frame that a drive
sends meanwhile into `service_out`. The cycle's side is `rtloop.service.rings`.
"""

from collections import deque
from typing import NamedTuple, Protocol

import numpy as np

from rtloop.memory import status as status_bits
from rtloop.memory.frame_words import EXTENDED
from rtloop.memory.link import GRIPPER, NOBODY, SERVICE_SLOTS
from rtloop.memory.state import Loop
from shm.record import offset_of
from shm.words import Unreferenced

SEND = 1  # send a CAN frame
SYNC_SETPOINT = 2  # command joint to stay at `value` (rad); code = Unreferenced reason (0: referenced)
BRING_UP_BEGINS = 3  # code = 1: automatic recovery after a stall, which no operator has requested
BRING_UP_DONE = 4
BRING_UP_FAILED = 5  # this or another conversation has failed: joint, code = shm.words.Fault
COUNT_FROM = 6  # joint's zero is `value` (rad) from its drive's own; code = 1: ignore the drive's lost-power flag
REFERENCING = 7  # joint is being referenced; code = 1: its drive begins a homing run, so its count is no angle any more
REFERENCING_DONE = 8
HOME_ALL = 9  # begin the arm's homing run
FAST_READY = 10  # joint's drive takes FC as absolute, and its speed and ramp for that are set
HOLDS_STALLED = 11  # joint's drive goes on holding where it stalls: its protection that releases a stalled shaft is off
POWER_KEPT = 12  # joint's drive has proven that it had power while it was silent

SOUND = status_bits.ENABLED | status_bits.REACHED | status_bits.ANSWERED
"""The only bits that the status of a drive without an error may have set."""
IN = offset_of(Loop, "service_in")
OUT = offset_of(Loop, "service_out")
WRITTEN = 0
TAKEN = 16 * 8


class Frame(NamedTuple):
    """A CAN frame as ordinary Python sees it."""

    id: int
    data: bytes
    time_ns: int = 0
    kind: int = EXTENDED
    """Bits of `rtloop.memory.frame_words`."""
    joint: int = NOBODY
    """The joint, or GRIPPER, whose drive sends or receives it."""


class Words(Protocol):
    """Access to words that another thread reads or writes; Python itself has no memory order to offer."""

    def load_word(self, address: int, /) -> int:
        """A 64-bit word; what was written before it is seen by what comes after."""

    def store_word(self, address: int, value: int, /) -> None:
        """Write a 64-bit word after everything that was written before."""


class ServicePort:
    """Ordinary Python's end of the rings, for use from one thread.

    It serves one conversation at a time with the joints' drives, and beside it one with the gripper's.
    """

    def __init__(self, loop: np.ndarray, words: Words) -> None:
        self._record = loop[0]
        self._address = int(loop.ctypes.data)
        self._words = words
        self._heard_of_joints: deque[Frame] = deque(maxlen=SERVICE_SLOTS)
        self._heard_of_gripper: deque[Frame] = deque(maxlen=SERVICE_SLOTS)

    def zero_rad(self, joint: int) -> float:
        """The joint's zero, counted from the drive's own; not the arm file's if an operator has stated the angle."""
        return float(self._record["joints"][joint]["zero_rad"])

    def reading_per_rad(self, joint: int) -> float:
        """Units of a drive's reading for a radian of the joint; the sign is the joint's direction."""
        return float(self._record["joints"][joint]["reading_per_rad"])

    def reading_step_rad(self, joint: int) -> float:
        """The smallest difference between two of the joint's readings."""
        return float(self._record["joints"][joint]["reading_step_rad"])

    def referenced(self, joint: int) -> bool:
        """Whether the joint is referenced: its drive's count is known to mean an angle."""
        return bool(self._record["axes"][joint]["reference"]["referenced"])

    def unreferenced_reason(self, joint: int) -> Unreferenced:
        """Why the joint is not referenced."""
        return Unreferenced(self._record["axes"][joint]["reference"]["unreferenced_reason"])

    def measured_rad(self, joint: int) -> float:
        """The joint's last reading."""
        return float(self._record["axes"][joint]["measured"]["position_rad"])

    def measured_ns(self, joint: int) -> int:
        """When the joint's last reading was taken (CLOCK_MONOTONIC)."""
        return int(self._record["axes"][joint]["measured"]["time_ns"])

    def unasked(self, joint: int) -> int:
        """Number of positions that the joint's drive has sent unasked: its reports."""
        return int(self._record["axes"][joint]["reply"]["reports"])

    def commanded_rad(self, joint: int) -> float:
        """Where the joint is commanded to be."""
        return float(self._record["axes"][joint]["commanded"]["position_rad"])

    def holds(self, joint: int) -> bool:
        """Whether the joint's drive has last reported that it holds, without an error."""
        status = int(self._record["axes"][joint]["drive"]["status"])
        if self.power_loss_known(joint):
            status &= ~status_bits.POWER_LOST
        return status & status_bits.ENABLED != 0 and status & ~SOUND == 0

    def is_loose(self, joint: int) -> bool:
        """Whether the drive has last reported that it does not hold, or an error; False before its first status."""
        return bool(self._record["axes"][joint]["drive"]["status"]) and not self.holds(joint)

    def power_loss_known(self, joint: int) -> bool:
        """Whether the drive's lost-power flag means nothing, because an operator has stated the joint's angle since."""
        return bool(self._record["axes"][joint]["reference"]["power_loss_known"])

    def post(
        self,
        kind: int,
        *,
        frame: Frame | None = None,
        joined: bool = False,
        joint: int = -1,
        value: float = 0.0,
        code: int = 0,
    ) -> bool:
        """Put a record into the ring to the cycle; False when it is full."""
        written, taken = self._counts(IN)
        if written - taken >= SERVICE_SLOTS:
            return False
        record = self._record["service_in"]["records"][written % SERVICE_SLOTS]
        record["kind"] = kind
        record["joint"] = joint
        record["value"] = value
        record["code"] = code
        record["joined"] = int(joined)
        if frame is not None:
            record["id"] = frame.id
            record["frame_kind"] = frame.kind
            record["joint"] = frame.joint
            record["length"] = len(frame.data)
            record["payload"] = int.from_bytes(frame.data.ljust(8, b"\0"), "little", signed=True)
        self._words.store_word(self._address + IN + WRITTEN, written + 1)
        return True

    def room(self) -> int:
        """Number of records that the ring to the cycle has room for."""
        written, taken = self._counts(IN)
        return SERVICE_SLOTS - (written - taken)

    def received(self, of_gripper: bool = False) -> list[Frame]:
        """Every frame since the last such call from the joints' drives, or from the gripper's (`of_gripper`)."""
        written, taken = self._counts(OUT)
        for number in range(taken, written):
            record = self._record["service_out"]["records"][number % SERVICE_SLOTS]
            data = int(record["payload"]).to_bytes(8, "little", signed=True)[: int(record["length"])]
            joint = int(record["joint"])
            frame = Frame(int(record["id"]), data, int(record["time_ns"]), int(record["frame_kind"]), joint)
            (self._heard_of_gripper if joint == GRIPPER else self._heard_of_joints).append(frame)
            self._words.store_word(self._address + OUT + TAKEN, number + 1)
        heard = self._heard_of_gripper if of_gripper else self._heard_of_joints
        frames = list(heard)
        heard.clear()
        return frames

    def _counts(self, ring_at: int) -> tuple[int, int]:
        """Number of records written into a ring, and taken out of it, since the start."""
        ring = self._address + ring_at
        return self._words.load_word(ring + WRITTEN), self._words.load_word(ring + TAKEN)
