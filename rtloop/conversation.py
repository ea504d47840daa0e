"""Conversations with the drives in ordinary Python, beside the cycle and through its service rings.

Every drive has a dialogue of its own, a generator that yields what it wants to ask and gets the answer; all
dialogues advance together. `poll(now_ns)` is called from time to time and never waits, so the same
conversation works at start, at run time, and in tests in virtual time.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field

from config.drives.zdt import ZdtDrive
from config.joint import JointConfig
from config.schema import ArmConfig
from rtloop.port import BRING_UP_FAILED, SEND, Frame, ServicePort
from shm.words import Fault

ANSWER_PATIENCE_NS = 60_000_000
ANSWER_PERIODS = 3
"""A question waits for the next cycle and its answer for the one after; at low rates that is what lasts."""
TRIES = 5
NOT_UNDERSTOOD = b"\x00\xee\x6b"
"""What a drive answers to a command that is none to it (zdt-emm-v5.md)."""


class TalkFailed(Exception):
    """A conversation cannot go on; the text is the sentence people read."""

    def __init__(self, joint: int, sentence: str) -> None:
        super().__init__(sentence)
        self.joint = joint


@dataclass(frozen=True)
class Ask:
    """A command and how to know its answer: function byte and number of packets, or one short reply.

    The commands `before` and `after` leave with it, in the same cycle and right before and behind it. Their answers are
    not waited for, and they are said once, however often the question is.
    """

    payload: bytes
    reply_lengths: tuple[int, ...]
    packets: int = 1
    answered: bool = True
    before: tuple[bytes, ...] = ()
    after: tuple[bytes, ...] = ()


def silent_amid(config: JointConfig, what: str) -> str:
    """The sentence about a drive that has answered before."""
    return (
        f"The drive of {config.name} stopped answering while its {what} was read: check its power and the CAN wires, "
        "then `rtarm clear-fault`, or `rtarm up` where it has ended."
    )


Dialogue = Generator[Ask, bytes | None, None]


@dataclass
class _Exchange:
    """A running question to one drive."""

    ask: Ask
    sent_ns: int
    tries: int
    packets: dict[int, bytes] = field(default_factory=dict)


def split_packets(address: int, payload: bytes) -> list[Frame]:
    """CAN frames of a ZDT command: ≤ 8 bytes in one; longer ones repeat the function byte in every packet."""
    if len(payload) <= 8:
        return [Frame(address << 8, payload)]
    function, rest = payload[:1], payload[1:]
    pieces = [rest[at : at + 7] for at in range(0, len(rest), 7)]
    return [Frame((address << 8) | number, function + piece) for number, piece in enumerate(pieces)]


def drive_addresses(arm: ArmConfig) -> dict[int, int]:
    """Joint → address, of every joint whose drive is spoken to on the bus."""
    return {j: joint.drive.address for j, joint in enumerate(arm.joints) if isinstance(joint.drive, ZdtDrive)}


class Conversation:
    """One exchange of questions and answers with the drives of an arm, from its beginning to `done`.

    `failure` says why it could not go on, and the cycle is then told to latch `fault`; an orderly end is told to it by
    `last_order`, if there is one.
    """

    def __init__(
        self, arm: ArmConfig, port: ServicePort, now_ns: int, *, fault: Fault, last_order: int | None = None
    ) -> None:
        self.arm = arm
        self.now_ns = now_ns
        self.done = False
        self.failure: TalkFailed | None = None
        self._port = port
        self._patience_ns = max(ANSWER_PATIENCE_NS, ANSWER_PERIODS * arm.control.period_ns)
        self._addresses = drive_addresses(arm)
        self._fault = fault
        self._last_order = last_order
        self._dialogues: dict[int, Dialogue] = {}
        self._exchanges: dict[int, _Exchange] = {}
        self._outbox: list[tuple[Frame, bool]] = []
        self._received()  # what was said before this conversation does not belong to it

    def begin(self, dialogues: Mapping[int, Dialogue]) -> None:
        """Let every joint's dialogue ask its first question."""
        self._dialogues.update(dialogues)
        for joint in dialogues:
            self._advance(joint, None)

    def poll(self, now_ns: int) -> bool:
        """Take answers, ask on; True once the conversation is over (see `failure`)."""
        self.now_ns = now_ns
        if self.done:
            return True
        try:
            for frame in self._received():
                self._hear(frame)
            for joint in list(self._exchanges):
                self._repeat_or_give_up(joint)
        except TalkFailed as failure:
            self.failure = failure
            self.done = True
            self.post(BRING_UP_FAILED, joint=failure.joint, code=self._fault)
            return True
        self._flush()
        self.done = not self._dialogues and not self._outbox and not self._goes_on()
        if self.done and self._last_order is not None:
            self.post(self._last_order)
        return self.done

    def _received(self) -> list[Frame]:
        """What the drives of this conversation have said since the last look."""
        return self._port.received()

    def _goes_on(self) -> bool:
        """Begin what follows when every dialogue is over; whether there is something."""
        return False

    def post(self, kind: int, joint: int = -1, value: float = 0.0, code: int = 0) -> None:
        """Tell the cycle a decision."""
        if not self._port.post(kind, joint=joint, value=value, code=code):
            raise TalkFailed(joint, "The control cycle takes no orders: it has stopped; start rtarm again.")

    def _flush(self) -> None:
        """Put commands in as far as there is room, each as a whole: another conversation may speak after it."""
        while self._outbox:
            frames = 1 + next(number for number, (_, joined) in enumerate(self._outbox) if not joined)
            if self._port.room() < frames:
                return
            for frame, joined in self._outbox[:frames]:
                self._port.post(SEND, frame=frame, joined=joined)
            del self._outbox[:frames]

    def _advance(self, joint: int, answer: bytes | None) -> None:
        self._exchanges.pop(joint, None)
        try:
            ask = self._dialogues[joint].send(answer)
        except StopIteration:
            del self._dialogues[joint]
            return
        self._exchanges[joint] = _Exchange(ask, self.now_ns, 1)
        self._say(joint, ask)

    def _say(self, joint: int, ask: Ask) -> None:
        told_once = self._exchanges[joint].tries == 1
        before, after = (ask.before, ask.after) if told_once else ((), ())
        frames = [f for told in (*before, ask.payload, *after) for f in split_packets(self._addresses[joint], told)]
        self._outbox += [(frame, number < len(frames) - 1) for number, frame in enumerate(frames)]
        self._flush()

    def _hear(self, frame: Frame) -> None:
        for joint, exchange in list(self._exchanges.items()):
            if frame.id >> 8 != self._addresses[joint] or not frame.data:
                continue
            if frame.time_ns < exchange.sent_ns:
                continue  # the late answer to an earlier question
            packet, ask = frame.id & 255, exchange.ask
            if packet == 0 and frame.data == NOT_UNDERSTOOD and exchange.tries < TRIES:
                self._repeat(joint)  # the half of a command that a predecessor left spoils what is said first
            elif packet == 0 and (_is_refusal(frame.data, ask.payload[0])):
                self._advance(joint, frame.data)
            elif frame.data[0] == ask.payload[0] and packet < ask.packets:
                if ask.packets == 1 and len(frame.data) not in ask.reply_lengths:
                    continue  # an echo of the question, or an answer to somebody else's
                exchange.packets[packet] = frame.data
                if len(exchange.packets) == ask.packets:
                    joined = exchange.packets[0][:1]
                    for number in range(ask.packets):
                        joined += exchange.packets[number][1:]
                    if joined[-1] == 0x6B:
                        self._advance(joint, joined)
                    else:
                        exchange.packets.clear()

    def _repeat_or_give_up(self, joint: int) -> None:
        exchange = self._exchanges[joint]
        if self.now_ns - exchange.sent_ns < self._patience_ns:
            return
        if not exchange.ask.answered or exchange.tries >= TRIES:
            self._advance(joint, None)
            return
        self._repeat(joint)

    def _repeat(self, joint: int) -> None:
        exchange = self._exchanges[joint]
        exchange.tries += 1
        exchange.sent_ns = self.now_ns
        exchange.packets.clear()
        self._say(joint, exchange.ask)


def _is_refusal(data: bytes, function: int) -> bool:
    """`func E2 6B`, `func EE 6B` or `00 EE 6B`."""
    if len(data) != 3 or data[2] != 0x6B:
        return False
    return (data[0] == function and data[1] in (0xE2, 0xEE) and function != 0x3A) or data == NOT_UNDERSTOOD
