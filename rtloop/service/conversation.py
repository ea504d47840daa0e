"""Conversations: requests and responses between ordinary Python and the drives, through the cycle's service rings.

Each drive has a dialogue of its own: a generator that yields a question and receives the answer. All dialogues of
a conversation advance together. `poll(now_ns)` is called periodically and never blocks, so the same conversation
works at start, at run time, and in tests in virtual time.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.service.port import BRING_UP_FAILED, SEND, Frame, ServicePort
from shm.words import Fault

ANSWER_PATIENCE_NS = 60_000_000
ANSWER_PERIODS = 3
"""The timeout at low rates: a question waits for the next cycle, and its answer for the one after."""
TRIES = 5


def answer_patience_s(arm: ArmConfig) -> float:
    """Timeout of one try, for an answer or for a frame that a drive sends unasked."""
    return max(ANSWER_PATIENCE_NS, ANSWER_PERIODS * arm.control.period_ns) * 1e-9


class DialogueFailed(Exception):
    """A conversation cannot go on; the text is the message for the operator."""

    def __init__(self, joint: int, sentence: str) -> None:
        super().__init__(sentence)
        self.joint = joint


class Again:
    """What `Question.receive` returns for a frame that shows that the question must be sent again."""


Packet = tuple[Frame, bool]
"""A frame, and whether the next one belongs to the same command."""


class Question(Protocol):
    """A request to a drive, as the drive's family encodes it."""

    @property
    def answered(self) -> bool:
        """Whether the question is repeated, up to `TRIES` times in all, until an answer has come."""

    def packets(self, first: bool) -> list[Packet]:
        """The frames to send, the first time or again."""

    def receive(self, frame: Frame, last_try: bool) -> Any | Again | None:
        """The answer, if this frame from the drive completes it; Again to send the question again; else None."""


def silent_amid(config: JointConfig, what: str) -> str:
    """The message about a drive that has answered before, and stopped while its `what` was read."""
    return (
        f"The drive of {config.name} stopped answering while its {what} was read: check its power and the CAN wires, "
        "then `rtarm clear-fault`, or `rtarm up` where it has ended."
    )


Dialogue = Generator[Question, Any, None]
"""The questions to one drive; it receives None for a question that gets no answer."""
Value = TypeVar("Value")
Part = Generator[Question, Any, Value]
"""Part of a dialogue that returns a value."""
Unaddressed = Generator[Any, Any, Value]
"""The same in the form of the drive's family, not yet addressed to a drive."""


@dataclass
class _Exchange:
    """An open question to one drive; `sent_ns` is the time of the last try."""

    question: Question
    sent_ns: int
    tries: int


class Conversation:
    """One exchange of questions and answers with the drives of an arm, from its beginning to `done`.

    If it cannot go on, `failure` holds the reason, and the cycle is ordered to latch `fault`. After an orderly end the
    cycle gets `last_order`, if there is one.
    """

    def __init__(
        self, arm: ArmConfig, port: ServicePort, now_ns: int, *, fault: Fault, last_order: int | None = None
    ) -> None:
        self.arm = arm
        self.now_ns = now_ns
        self.done = False
        self.failure: DialogueFailed | None = None
        self.port = port
        self._patience_ns = round(answer_patience_s(arm) * 1e9)
        self._fault = fault
        self._last_order = last_order
        self._dialogues: dict[int, Dialogue] = {}
        self._exchanges: dict[int, _Exchange] = {}
        self._outbox: list[tuple[Frame, bool]] = []
        self._received()  # discards frames from before this conversation

    def begin(self, dialogues: Mapping[int, Dialogue]) -> None:
        """Start dialogues, given by joint number: each sends its first question."""
        self._dialogues.update(dialogues)
        for joint in dialogues:
            self._advance(joint, None)

    def poll(self, now_ns: int) -> bool:
        """Take answers and send the next questions; True once the conversation is over (see `failure`)."""
        self.now_ns = now_ns
        if self.done:
            return True
        try:
            for frame in self._received():
                self._hear(frame)
            for joint in list(self._exchanges):
                self._repeat_or_give_up(joint)
            self._flush()
            self.done = not self._dialogues and not self._outbox and not self._goes_on()
        except DialogueFailed as failure:
            self.failure = failure
            self.done = True
            self.post(BRING_UP_FAILED, joint=failure.joint, code=self._fault)
            return True
        if self.done and self._last_order is not None:
            self.post(self._last_order)
        return self.done

    def _received(self) -> list[Frame]:
        """The frames from this conversation's drives since the last call."""
        return self.port.received()

    def _goes_on(self) -> bool:
        """Called when every dialogue is over: begin what follows; False if nothing does."""
        return False

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Send the cycle an order (see `rtloop.service.port`); raises DialogueFailed when the ring is full."""
        if not self.port.post(kind, joint=joint, value=value, code=code):
            raise DialogueFailed(joint, "The control cycle takes no orders: it has stopped; start rtarm again.")

    def _flush(self) -> None:
        """Post commands while there is room, each as a whole, since another conversation may post after it."""
        while self._outbox:
            frames = 1 + next(number for number, (_, joined) in enumerate(self._outbox) if not joined)
            if self.port.room() < frames:
                return
            for frame, joined in self._outbox[:frames]:
                self.port.post(SEND, frame=frame, joined=joined)
            del self._outbox[:frames]

    def _advance(self, joint: int, answer: Any) -> None:
        self._exchanges.pop(joint, None)
        try:
            question = self._dialogues[joint].send(answer)
        except StopIteration:
            del self._dialogues[joint]
            return
        self._exchanges[joint] = _Exchange(question, self.now_ns, 1)
        self._say(joint, question)

    def _say(self, joint: int, question: Question) -> None:
        told_once = self._exchanges[joint].tries == 1
        self._outbox += [(frame._replace(joint=joint), joined) for frame, joined in question.packets(told_once)]
        self._flush()

    def _hear(self, frame: Frame) -> None:
        exchange = self._exchanges.get(frame.joint)
        if exchange is None or frame.time_ns < exchange.sent_ns:
            return  # no question is open, or this is the late answer to an earlier one
        answer = exchange.question.receive(frame, exchange.tries >= TRIES)
        if isinstance(answer, Again):
            self._repeat(frame.joint)
        elif answer is not None:
            self._advance(frame.joint, answer)

    def _repeat_or_give_up(self, joint: int) -> None:
        exchange = self._exchanges[joint]
        if self.now_ns - exchange.sent_ns < self._patience_ns:
            return
        if not exchange.question.answered or exchange.tries >= TRIES:
            self._advance(joint, None)
            return
        self._repeat(joint)

    def _repeat(self, joint: int) -> None:
        exchange = self._exchanges[joint]
        exchange.tries += 1
        exchange.sent_ns = self.now_ns
        self._say(joint, exchange.question)
