"""The wire of one bus while the control process runs: opened, given to its threads, let go, opened again."""

import threading
import time
from collections.abc import Callable

import numpy as np

from config.schema import ArmConfig
from rtloop.memory.link import Bus
from rtloop.memory.state import Loop
from rtloop.process.compiled import CompiledCycle
from rtloop.process.opening import OpenWire, close_wire, keeps_frames, lost_bytes, open_wire, unsent_bytes
from rtloop.system import realtime
from rtloop.wire.refusal import WireRefused
from sentences.english import STILL_QUEUED, WIRE_IS_BACK
from sentences.told import of_bus
from shm.record import offset_of

LOOK_EVERY_S = 0.05
REOPEN_EVERY_S = 0.5
LET_GO_POLL_S = 0.001


class AttendedWire:
    """The wire of the bus with this number in the loop; `arm` is the part of the arm (`ArmConfig.parts`) on it.

    `name` is that of the bus where there are several, else "": sentences about it begin with that. `start` starts the
    thread that the function it is given runs in, and returns it. `tell` gets every message for the operator.
    """

    def __init__(
        self,
        arm: ArmConfig,
        number: int,
        name: str,
        loop: np.ndarray,
        compiled: CompiledCycle,
        *,
        start: Callable[[Callable[[], None]], threading.Thread],
        tell: Callable[[str], None],
    ) -> None:
        self._arm = arm
        self._number = number
        self._name = name
        self._loop = loop
        self._compiled = compiled
        self._start = start
        self._tell = tell
        self._wire: OpenWire | None = None
        self._reader: threading.Thread | None = None
        self._attending: threading.Thread | None = None
        self._ends = threading.Event()
        self._dropped_before = self._unsent_before = 0

    @property
    def _channel(self) -> str:
        """The device or interface that it is opened at."""
        return self._arm.bus.resolved_channel

    @property
    def _is_gone(self) -> bool:
        """Whether one of the threads has found that it is gone."""
        return self._wire is not None and self._load("received", "arrived", "closed") != 0

    def require(self) -> None:
        """Raise WireRefused if the adapter is gone, in a conversation that cannot go on without it."""
        if self._is_gone:
            raise self._refusal(
                f"The adapter at {self._channel} is gone in the middle of a conversation, so what a drive was told "
                "last may have arrived or not: plug it in again and read what the drives have."
            )

    def open(self) -> None:
        """Open it and give it to the threads; raises WireRefused."""
        try:
            wire = open_wire(self._arm)
        except WireRefused as refused:
            raise self._refusal(str(refused)) from refused
        if wire is None:
            return
        for complaint in wire.complaints:
            self._say(complaint)
        self._wire = wire
        self._dropped_before = self._load("received", "arrived", "dropped")
        self._unsent_before = self._load("received", "arrived", "unsent")
        self._store(wire.fd, "wire", "fd")
        self._store(0, "received", "arrived", "closed")  # the last: the cycle makes frames from here on

    def start_reader(self) -> None:
        """Start its reader, if it is open."""
        if self._wire is not None:
            self._reader = self._start(self._read)

    def _read(self) -> None:
        kept = self._loop  # keeps it mapped while this runs
        self._compiled.read_wire(kept.ctypes.data, self._number)

    def attend(self, cycle_is_alive: Callable[[], bool]) -> None:
        """Start the thread that detects that the adapter is gone, and reopens it when it is back.

        Only an operator's clear moves the arm then. Each wire has a thread of its own for it, because an adapter that
        is there and does not open keeps whoever tries for 0.35 s (SLCAN), or as long as its library likes (python-can).
        """
        if self._wire is not None:
            attending = threading.Thread(target=self._attend, args=(cycle_is_alive,), name="adapter", daemon=True)
            attending.start()
            self._attending = attending

    def leave(self) -> None:
        """Ask the thread that `attend` has started to end."""
        self._ends.set()

    def join(self, until_s: float) -> None:
        """Wait until both threads have ended, until `until_s` (time.monotonic) at the latest; see `leave`.

        The reader ends because of the stop word.
        """
        if self._attending is not None:
            self._attending.join(max(until_s - time.monotonic(), 0.0))
        if self._reader is not None:  # only now: the other thread may have started it
            self._reader.join(max(until_s - time.monotonic(), 0.0))

    def release(self) -> None:
        """Close it, at the end; one that is just being opened is left to the system, which closes it."""
        if self._attending is not None and self._attending.is_alive():
            return
        if self._wire is not None:
            if keeps_frames(self._arm, self._wire):
                self._say(STILL_QUEUED.sentence.format(channel=self._channel))
            self._close(self._wire)

    def _attend(self, cycle_is_alive: Callable[[], bool]) -> None:
        realtime.leave_signals_to_main()
        try:
            while not self._ends.wait(LOOK_EVERY_S):
                if self._wire is None:
                    self._reopen()
                elif self._is_gone:
                    self._let_go(self._wire, cycle_is_alive)
                else:
                    self._count_lost(self._wire)
        except Exception:
            self._say(
                f"The adapter at {self._channel} is not opened again if it goes, because of an exception, which is a "
                "defect of rtarm: please report what follows, and start rtarm again."
            )
            raise

    def _count_lost(self, wire: OpenWire) -> None:
        """Pass to the cycle the counts of dropped and unsent bytes, which ordinary Python alone can find out."""
        self._store(self._dropped_before + lost_bytes(self._arm, wire), "received", "arrived", "dropped")
        self._store(self._unsent_before + unsent_bytes(wire), "received", "arrived", "unsent")

    def _let_go(self, wire: OpenWire, cycle_is_alive: Callable[[], bool]) -> None:
        """Close a wire that is gone, once neither thread uses it any more."""
        self._store(-1, "wire", "fd")
        while self._load("wire", "fd_in_use") != -1 and cycle_is_alive():
            time.sleep(LET_GO_POLL_S)
        if self._reader is not None:
            self._reader.join()
            self._reader = None
        self._close(wire)
        self._store(self._unsent_before + unsent_bytes(wire), "received", "arrived", "unsent")

    def _reopen(self) -> None:
        """Open it again as soon as that can be done; each reason why it cannot is told once, until there is another."""
        told = ""
        while not self._ends.is_set():
            try:
                self.open()
            except WireRefused as refused:
                if str(refused) != told:
                    told = str(refused)
                    self._tell(told)
                self._ends.wait(REOPEN_EVERY_S)
            else:
                self.start_reader()
                self._say(WIRE_IS_BACK)
                return

    def _close(self, wire: OpenWire) -> None:
        self._wire = None  # first: what fails to close is not closed again
        for complaint in close_wire(self._arm, wire):
            self._say(complaint)

    def _say(self, sentence: str) -> None:
        self._tell(of_bus(sentence, self._name))

    def _refusal(self, sentence: str) -> WireRefused:
        return WireRefused(of_bus(sentence, self._name))

    def _address(self, *word: str) -> int:
        buses = offset_of(Loop, "buses") + self._number * Bus.dtype.itemsize
        return int(self._loop.ctypes.data) + buses + offset_of(Bus, *word)

    def _store(self, value: int, *word: str) -> None:
        """Publish a word of the bus' record to the threads."""
        self._compiled.store_word(self._address(*word), value)

    def _load(self, *word: str) -> int:
        found: int = self._compiled.load_word(self._address(*word))
        return found
