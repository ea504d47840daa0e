"""Running a scenario and listening: each cycle of virtual time passes through `Tape`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import numpy as np
from virtual import VirtualArm

from transcripts.words import Published, Row, is_fast

Entry = tuple[int, str, Row]
"""Cycle, table ("event", "result" or "answer") and row."""


@dataclass
class Transcript:
    """What the control cycle said from a scenario's first cycle (0) to its last.

    Attributes:
        words: by name; int64 or float64, one value for each cycle, or for each of `kept` of a fast word.
        kept: numbers of the cycles in which fast words are kept.
        sent: bytes that each cycle transmitted, bus after bus.
        told: events, results and answers.
        place: processor and libraries, which decide how floats are rounded.
        broke_off: why the scenario did not come to its end; "" when it did.
    """

    joints: list[str]
    words: dict[str, np.ndarray]
    kept: np.ndarray
    sent: list[bytes]
    told: list[Entry]
    place: dict[str, str] = field(default_factory=dict)
    broke_off: str = ""

    def thinned(self, every: int) -> "Transcript":
        """Fast words in every so-manieth cycle only, and wherever anything is told or another word changes."""
        cycles = np.arange(len(self.sent))
        wanted = cycles % every == 0
        wanted[[cycle for cycle, *_ in self.told]] = True
        for name, values in self.words.items():
            if not is_fast(name) and name not in CLOCKS:
                wanted[1:] |= values[1:].view(np.int64) != values[:-1].view(np.int64)
        kept = cycles[wanted]
        words = {name: values[kept] if is_fast(name) else values for name, values in self.words.items()}
        return Transcript(self.joints, words, kept, self.sent, self.told, self.place, self.broke_off)


CLOCKS = ("cycle", "monotonic_ns", "epoch_ns", "trajectory_clock_ns", "speed_scale")


class Tape:
    """Keeps what each cycle of a virtual arm published and transmitted."""

    def __init__(self) -> None:
        self._published = Published()
        self._sent: list[bytes] = []
        self._told: list[Entry] = []
        self._listened_to = 0

    def keep(self, shared: Any, sent: bytes) -> None:
        """A cycle has ended."""
        address = shared["events"].ctypes.data
        if self._listened_to not in (0, address):
            raise RuntimeError("a transcript is that of one arm")
        self._listened_to = address
        self._told += [(len(self._sent), table, row) for table, row in self._published.take(shared)]
        self._sent.append(sent)

    def transcript(self, broke_off: str) -> Transcript:
        """Everything so far, with every word of every cycle."""
        every = np.arange(len(self._sent))
        words = self._published.words()
        return Transcript(self._published.joints, words, every, self._sent, self._told, broke_off=broke_off)


def listen(play: Callable[[], None]) -> Transcript:
    """Run what plays one arm in virtual time; an exception ends the transcript and stands in `broke_off`."""
    tape, broke_off = Tape(), ""
    step = VirtualArm.step

    def kept(arm: VirtualArm, now_ns: int) -> bytes:
        sent = step(arm, now_ns)
        tape.keep(arm.state.array[0], b"".join(arm.for_the_wire(bus) for bus in range(len(arm.arm.buses))))
        return sent

    with mock.patch.object(VirtualArm, "step", kept):
        try:
            play()
        except Exception as problem:
            broke_off = f"{type(problem).__name__}: {problem}"
    return tape.transcript(broke_off)
