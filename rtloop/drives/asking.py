"""Requests to drives that answer in one frame: what is sent, and how the answer is recognised."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rtloop.service.conversation import TRIES, Packet, Part, Value
from rtloop.service.port import Frame


@dataclass(frozen=True)
class AskFrames:
    """Frames that are sent together, and a test for the answer; a `rtloop.service.conversation.Question`.

    Without frames nothing is sent, and it waits for a frame that the drive sends by itself.
    """

    frames: tuple[Frame, ...]
    is_answer: Callable[[Frame], bool]
    answered: bool = True

    def packets(self, first: bool) -> list[Packet]:
        """The frames to send, at the first try and at every retry."""
        return [(frame, number < len(self.frames) - 1) for number, frame in enumerate(self.frames)]

    def receive(self, frame: Frame, last_try: bool) -> Frame | None:
        """The frame if it is the answer, else None."""
        return frame if self.is_answer(frame) else None


def say(*frames: Frame) -> AskFrames:
    """A command without an answer: its frames are sent once."""
    return AskFrames(frames, lambda frame: False, answered=False)


def surely(read: Callable[[], Part[Value | None]]) -> Part[Value | None]:
    """Read until two answers in a row agree, for decisions: a single answer may be garbled. None if no two agree."""
    before = yield from read()
    for _ in range(TRIES):
        found = yield from read()
        if found is not None and found == before:
            return found
        before = found
    return None


def confirmed(read: Callable[[], Part[Value]], within: float, place: Callable[[Any], float] = float) -> Part[Value]:
    """Read a position until two readings in a row agree within `within`.

    The drive will be commanded to be there, and a serial line has no checksum. If a drive moves so fast that no two
    readings agree, the last reading counts. `place` gives the position in a reading.
    """
    before = yield from read()
    for _ in range(TRIES):
        found = yield from read()
        if abs(place(found) - place(before)) <= within:
            break
        before = found
    return found
