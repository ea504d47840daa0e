"""Questions to drives that answer in one frame: what is said, and how the answer is known."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rtloop.service.conversation import TRIES, Packet, Part, Value
from rtloop.service.port import Frame


@dataclass(frozen=True)
class AskFrames:
    """Frames that leave together, and how to know the answer; `rtloop.service.conversation.Question`.

    With no frames it is a question what the drive says by itself.
    """

    frames: tuple[Frame, ...]
    is_answer: Callable[[Frame], bool]
    answered: bool = True

    def packets(self, first: bool) -> list[Packet]:
        """What is said, the first time or again."""
        return [(frame, number < len(self.frames) - 1) for number, frame in enumerate(self.frames)]

    def receive(self, frame: Frame, last_try: bool) -> Frame | None:
        """The frame, if it is the answer."""
        return frame if self.is_answer(frame) else None


def say(*frames: Frame) -> AskFrames:
    """Frames that nothing answers."""
    return AskFrames(frames, lambda frame: False, answered=False)


def surely(read: Callable[[], Part[Value | None]]) -> Part[Value | None]:
    """What two answers in a row tell, for who decides by it: one alone may be garbled. None where no two agree."""
    before = yield from read()
    for _ in range(TRIES):
        found = yield from read()
        if found is not None and found == before:
            return found
        before = found
    return None


def confirmed(read: Callable[[], Part[Value]], within: float, place: Callable[[Any], float] = float) -> Part[Value]:
    """A place that was read twice in a row: a serial line has no checksum, and a drive is told to be there.

    One that moves so fast that no two readings agree is where it was read last. `place` is that of a reading.
    """
    before = yield from read()
    for _ in range(TRIES):
        found = yield from read()
        if abs(place(found) - place(before)) <= within:
            break
        before = found
    return found
