"""Requests to ZDT (Emm_V5) drives in service dialogues, and how answers are recognised: dialogues yield an `Ask`."""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import cast

from rtloop.service.conversation import Again, Packet, Part, Value
from rtloop.service.port import Frame

NOT_UNDERSTOOD = b"\x00\xee\x6b"
"""Answer of a drive to a command that it does not know (zdt-emm-v5.md)."""


@dataclass(frozen=True)
class Ask:
    """A command and how to recognise its answer: by function byte and number of packets, or as one short reply.

    The commands `before` and `after` are sent in the same cycle, right before and right after it. Their answers are not
    waited for, and they are sent once only, even if the command itself is sent again.
    """

    payload: bytes
    reply_lengths: tuple[int, ...]
    packets: int = 1
    answered: bool = True
    before: tuple[bytes, ...] = ()
    after: tuple[bytes, ...] = ()


ZdtDialogue = Generator[Ask, bytes | None, None]
"""A dialogue with one drive that does not depend on the drive's address."""


def addressed(address: int, dialogue: Generator[Ask, bytes | None, Value]) -> Part[Value]:
    """Address a dialogue to the drive at `address`; returns what the dialogue returns."""
    answer: bytes | None = None
    while True:
        try:
            ask = dialogue.send(answer)
        except StopIteration as end:
            return cast(Value, end.value)
        answer = yield ZdtQuestion(address, ask)


@dataclass
class ZdtQuestion:
    """An `Ask` to the drive at an address; it collects the packets of the answer, which come one by one."""

    address: int
    ask: Ask
    _packets: dict[int, bytes] = field(default_factory=dict)

    @property
    def answered(self) -> bool:
        """Whether the command is repeated until an answer comes."""
        return self.ask.answered

    def packets(self, first: bool) -> list[Packet]:
        """The frames to send at the first try, or at a retry (without `before` and `after`)."""
        self._packets.clear()
        before, after = (self.ask.before, self.ask.after) if first else ((), ())
        frames = [frame for told in (*before, self.ask.payload, *after) for frame in split_packets(self.address, told)]
        return [(frame, number < len(frames) - 1) for number, frame in enumerate(frames)]

    def receive(self, frame: Frame, last_try: bool) -> bytes | Again | None:
        """The answer, once its last packet has come; `Again` if the command must be repeated, else None."""
        packet, ask = frame.id & 255, self.ask
        if not frame.data:
            return None
        if packet == 0 and frame.data == NOT_UNDERSTOOD and not last_try:
            return Again()  # half a command, left by an earlier process, spoils the first command
        if packet == 0 and _is_refusal(frame.data, ask.payload[0]):
            return frame.data
        if frame.data[0] != ask.payload[0] or packet >= ask.packets:
            return None
        if ask.packets == 1 and len(frame.data) not in ask.reply_lengths:
            return None  # an echo of the request, or an answer to another one
        self._packets[packet] = frame.data
        if len(self._packets) < ask.packets:
            return None
        joined = self._packets[0][:1] + b"".join(self._packets[number][1:] for number in range(ask.packets))
        if joined[-1] == 0x6B:
            return joined
        self._packets.clear()
        return None


def split_packets(address: int, payload: bytes) -> list[Frame]:
    """CAN frames of a command: up to 8 bytes go into one; longer ones repeat the function byte in every packet."""
    if len(payload) <= 8:
        return [Frame(address << 8, payload)]
    function, rest = payload[:1], payload[1:]
    pieces = [rest[at : at + 7] for at in range(0, len(rest), 7)]
    return [Frame((address << 8) | number, function + piece) for number, piece in enumerate(pieces)]


def _is_refusal(data: bytes, function: int) -> bool:
    """Whether an answer is `func E2 6B`, `func EE 6B` or `00 EE 6B`; of `3A`, the first two may be flags."""
    if len(data) != 3 or data[2] != 0x6B:
        return False
    return (data[0] == function and data[1] in (0xE2, 0xEE) and function != 0x3A) or data == NOT_UNDERSTOOD
