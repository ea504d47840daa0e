"""Dialogues that read and write the settings of a ZDT (Emm_V5) drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.zdt_ask import NOT_UNDERSTOOD, Ask, ZdtDialogue, ZdtQuestion
from rtloop.drives.zdt_protocol import Block, HomingParameters, Trip, Version
from rtloop.drives.zdt_talk import Answered, read_block, read_counts, read_flags, read_homing, read_watchdog
from rtloop.service.conversation import TRIES, Question
from rtloop.service.port import Frame

Value = TypeVar("Value")

MOST_MISUNDERSTANDINGS = 4 * TRIES
"""A single drive does not understand a request or two that its firmware lacks, each sent `TRIES` times."""
STANDS_WITHIN_COUNTS = 200
"""About a degree of the motor: a closed loop that holds dithers by less."""
READ_BACK_TRIES = 4
"""A drive that writes its flash may not answer for a while; each of these tries repeats its request several times."""


@dataclass
class Reading:
    """What a drive has reported about itself; None for what it did not report, or does not have."""

    version: Version | None = None
    block: Block | None = None
    homing: HomingParameters | None = None
    trip: Trip | None = None
    watchdog_ms: int | None = None
    supply_mv: int | None = None
    flags: int | None = None
    homing_flags: int | None = None
    rpm: int | None = None
    position_counts: int | None = None
    other_checksum: bool = False
    """Whether answers came whose last byte was not 6B."""
    other_block: tuple[int, int] | None = None
    """Byte count and field count of a configuration block of an unsupported kind."""
    questions: int = field(default=0, repr=False)
    answers: int = field(default=0, repr=False)
    misunderstandings: int = field(default=0, repr=False)

    @property
    def shared_address(self) -> bool:
        """Whether more drives than one have answered at this address.

        Commands and answers share their identifiers. So each of two drives takes the other's answers for commands that
        it does not understand, and answers with a refusal, which the other does not understand either: an endless loop.
        """
        return self.answers > self.questions or self.misunderstandings > MOST_MISUNDERSTANDINGS

    def note_question(self, question: Question) -> None:
        """Count requests for the firmware."""
        if isinstance(question, ZdtQuestion) and question.ask.payload == protocol.ASK_FIRMWARE:
            self.questions += 1

    def note_frame(self, frame: Frame) -> None:
        """Look for signs of a drive with another protocol, or of two drives at one address."""
        if frame.id & 0xFF != 0 or len(frame.data) <= 2:
            return
        data = frame.data
        function, last = data[0], data[-1]
        self.misunderstandings += data == NOT_UNDERSTOOD
        short = data[:2] == NOT_UNDERSTOOD[:2] and len(data) == 3
        if (short or (function == protocol.ASK_FIRMWARE[0] and len(data) in (4, 6))) and last != protocol.CHECKSUM:
            self.other_checksum = True
        elif function == protocol.ASK_FIRMWARE[0] and len(data) in (4, 6):
            self.answers += 1
        elif function == protocol.ASK_BLOCK[0] and len(data) == 8 and data[1:3] != protocol.BLOCK_HEAD:
            self.other_block = data[1], data[2]

    def may_move_since(self, before: Reading) -> bool:
        """Whether a drive that answers is moving, has moved since `before`, or does not report that it stands."""
        return self.version is not None and (bool(self.rpm) or has_moved(before, self))

    def is_written_alike(self, before: Reading) -> bool:
        """Whether the configuration block, whose fields are all written back, is the same as in `before`."""
        return self.block == before.block


def has_moved(before: Reading, after: Reading) -> bool:
    """Whether a drive's position has changed between two readings, or is not known in one of them."""
    if before.position_counts is None or after.position_counts is None:
        return True
    return abs(after.position_counts - before.position_counts) > STANDS_WITHIN_COUNTS


def read(found: Reading) -> ZdtDialogue:
    """Read a drive's settings into `found`; a drive that does not answer is not asked further."""
    found.version = protocol.version_of((yield Ask(protocol.ASK_FIRMWARE, (4, 6))))
    if found.version is None:
        return
    found.block = yield from read_block()
    found.homing = yield from read_homing()
    if found.version.newer:
        found.watchdog_ms = yield from read_watchdog()
        found.trip = protocol.trip_of((yield Ask(protocol.ASK_TRIP, (8,))))
    found.supply_mv = protocol.number_of((yield Ask(protocol.ASK_SUPPLY, (4,))), protocol.ASK_SUPPLY, 2)
    found.flags = yield from read_flags(protocol.ASK_STATUS)
    found.homing_flags = yield from read_flags(protocol.ASK_HOMING_STATUS)
    found.rpm = protocol.signed_of((yield Ask(protocol.ASK_SPEED, (5,))), protocol.ASK_SPEED, 2)
    found.position_counts = yield from read_counts(protocol.ASK_POSITION)


def write(block: Block | None, watchdog_ms: int | None, store: bool) -> Answered[str | None]:
    """Write a new block, a new watchdog time (ms), or both, each once, and read them back.

    A write command is never repeated because its answer is missing: flash wears out, and reading back shows the effect.

    Returns:
        Why the new values are not known to be in effect, to follow the drive's name; None if they are.
    """
    problem: str | None = None
    if block is not None:
        answer = yield Ask(protocol.write_block(block, store=store), (3,), answered=False)
        problem = yield from _read_back(answer, read_block, block)
    if watchdog_ms is not None and problem is None:
        answer = yield Ask(protocol.write_watchdog(watchdog_ms, store=store), (3,), answered=False)
        problem = yield from _read_back(answer, read_watchdog, watchdog_ms)
    return problem


def _read_back(answer: bytes | None, read: Callable[[], Answered[Value | None]], wanted: Value) -> Answered[str | None]:
    if answer is not None and answer[1] in protocol.REFUSALS:
        return "refuses to be written"
    after = None
    for _ in range(READ_BACK_TRIES):
        after = yield from read()
        if after == wanted:
            return None
    if after is None:
        return "stopped answering when it was told, so what it has now is not known"
    return "keeps other values than it was told"
