"""Requests to a ZDT (Emm_V5) drive as parts of a service dialogue; the bytes are those of `zdt_protocol`."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import TypeVar

from config.joint import JointConfig
from rtloop.drives import zdt_protocol as protocol
from rtloop.drives.zdt_ask import Ask
from rtloop.drives.zdt_protocol import Block, HomingParameters
from rtloop.service.conversation import TRIES, DialogueFailed, silent_amid

AGREEING = 2
"""Answers in a row that must agree: a single one may be garbled."""
SURE_TRIES = 4
LOOKS = 6
"""Status requests for the beginning of a homing run: a collision of 60 ms (factory setting) outlasts two of them."""
HOMING_MARKS = 900
"""Number of different marks; the clock chooses one of them, so that a value stored in the drive is hardly the same."""
Value = TypeVar("Value")
Answered = Generator[Ask, bytes | None, Value]
"""Part of a dialogue that ends in a value."""


def read_flags(question: bytes, before: tuple[bytes, ...] = ()) -> Answered[int | None]:
    """The flags of ASK_STATUS or ASK_HOMING_STATUS; the commands `before` are sent right before the request.

    None if the drive does not answer or does not know the request.
    """
    return protocol.number_of((yield Ask(question, (3,), before=before)), question, 1)


def read_counts(question: bytes) -> Answered[int | None]:
    """A position in encoder counts: with ASK_POSITION the measured one, with ASK_TARGET the drive's own target.

    None if the drive does not answer or does not know the request.
    """
    return protocol.signed_of((yield Ask(question, (7,))), question, 4)


def status_of(joint: int, config: JointConfig) -> Answered[int]:
    """The flags of ASK_STATUS; raises DialogueFailed if the drive does not answer."""
    flags = yield from read_flags(protocol.ASK_STATUS)
    if flags is None:
        raise DialogueFailed(joint, silent_amid(config, "status"))
    return flags


def counts_of(joint: int, config: JointConfig, question: bytes) -> Answered[int]:
    """A position as `read_counts` reads it; raises DialogueFailed if the drive does not answer."""
    counts = yield from read_counts(question)
    if counts is None:
        raise DialogueFailed(joint, silent_amid(config, "position"))
    return counts


def read_block() -> Answered[Block | None]:
    """The configuration block; None if the drive does not answer, or with another block."""
    return protocol.block_of((yield Ask(protocol.ASK_BLOCK, (8,), packets=protocol.BLOCK_PACKETS)))


def surely(read: Callable[[], Answered[Value | None]]) -> Answered[Value | None]:
    """Read until two answers in a row agree, for decisions and before a value is written back; None if no two agree.

    All fields of what was read are written to the drive again, and a serial line may garble any of them unnoticed.
    """
    before = None
    for _ in range(SURE_TRIES):
        found = yield from read()
        if found is not None and found == before:
            return found
        before = found
    return None


def read_watchdog() -> Answered[int | None]:
    """The watchdog's time (ms); None if the drive does not answer or does not know the request."""
    return protocol.number_of((yield Ask(protocol.ASK_WATCHDOG, (6,))), protocol.ASK_WATCHDOG, 4)


def set_reports(period_ms: int) -> Answered[bool]:
    """Let the drive send its position by itself every `period_ms`, or with 0 stop that; False if it refuses.

    A missing answer is no refusal.
    """
    answer = yield Ask(protocol.report_position(period_ms), tuple(len(a) for a in protocol.REPORT_ACCEPTED))
    return answer is None or answer in protocol.REPORT_ACCEPTED


def read_homing() -> Answered[HomingParameters | None]:
    """The homing parameters; None if the drive does not answer or does not know the request."""
    return protocol.homing_of((yield Ask(protocol.ASK_HOMING, (8,), packets=protocol.HOMING_PACKETS)))


def homing_mark_ms(limit_ms: int, now_ns: int) -> int:
    """A homing time-out just above `limit_ms` (ms) as a mark, by which a drive is recognised after its run.

    Any other value in the drive's volatile memory equals the mark by chance only. So a drive that still has the mark
    after the run was not switched off and on meanwhile; after that it would count 0 anywhere.
    """
    return limit_ms + 1 + now_ns // 1_000_000 % HOMING_MARKS


def set_homing_timeout(timeout_ms: int) -> Answered[bool]:
    """Set the time-out of the drive's homing run, in volatile memory only; whether the drive then has it."""
    parameters = yield from surely(read_homing)
    if parameters is None:
        return False
    changed = replace(parameters, timeout_ms=timeout_ms)
    yield Ask(protocol.write_homing(changed), (3,))
    return (yield from read_homing()) == changed


def has_mark(mark: str | None) -> Answered[bool | None]:
    """Whether the drive still has the homing time-out `mark` (`drives.power`); None if that cannot be found out."""
    parameters = None if mark is None else (yield from surely(read_homing))
    return None if parameters is None else str(parameters.timeout_ms) == mark


def mark(now_ns: int) -> Answered[str | None]:
    """Give the drive a mark, a little above its time-out, and return it; None if it takes none (older firmware)."""
    parameters = yield from surely(read_homing)
    if parameters is None:
        return None
    mark_ms = homing_mark_ms(parameters.timeout_ms - parameters.timeout_ms % 1000, now_ns)
    mark_ms += mark_ms == parameters.timeout_ms  # the drive may have stored that value
    return str(mark_ms) if (yield from set_homing_timeout(mark_ms)) else None


def begin_homing() -> Answered[bool]:
    """Start the drive's homing run to its stop; whether the drive reports, in answers that agree, that it runs.

    The command is repeated until then: no acknowledgement is waited for, and a command may be lost.
    """
    for _ in range(TRIES):
        before: tuple[bytes, ...] = (protocol.HOME_BY_COLLISION,)
        seen = 0
        for _ in range(LOOKS):
            flags = yield from read_flags(protocol.ASK_HOMING_STATUS, before)
            before = ()
            seen = seen + 1 if flags is not None and flags & protocol.HOMING else 0
            if seen >= AGREEING:
                return True
    return False
