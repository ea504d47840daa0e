"""What conversations ask a ZDT (Emm_V5) drive, as parts of a dialogue; the bytes are those of `zdt_registers`."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import TypeVar

from config.joint import JointConfig
from rtloop.drives import zdt_registers as registers
from rtloop.drives.zdt_ask import Ask
from rtloop.drives.zdt_registers import Block, HomingParameters
from rtloop.service.conversation import TRIES, DialogueFailed, silent_amid

AGREEING = 2
"""Answers in a row that say the same: one alone may be garbled."""
SURE_TRIES = 4
LOOKS = 6
"""For the beginning of a homing run: a collision of the factory's 60 ms lasts longer than two of them."""
HOMING_MARKS = 900
"""Which of the marks a homing run gets is the clock's: a value that somebody has stored is hardly that one."""
Value = TypeVar("Value")
Answered = Generator[Ask, bytes | None, Value]
"""Part of a dialogue that ends in a value."""


def read_flags(question: bytes, before: tuple[bytes, ...] = ()) -> Answered[int | None]:
    """The flags of ASK_STATUS or ASK_HOMING_STATUS, after commands that leave right before the question.

    None where the drive is silent or does not know the question.
    """
    return registers.number_of((yield Ask(question, (3,), before=before)), question, 1)


def read_counts(question: bytes) -> Answered[int | None]:
    """A position in encoder counts: ASK_POSITION the measured one, ASK_TARGET the drive's own target."""
    return registers.signed_of((yield Ask(question, (7,))), question, 4)


def status_of(joint: int, config: JointConfig) -> Answered[int]:
    """The flags of ASK_STATUS; raises DialogueFailed where the drive is silent."""
    flags = yield from read_flags(registers.ASK_STATUS)
    if flags is None:
        raise DialogueFailed(joint, silent_amid(config, "status"))
    return flags


def counts_of(joint: int, config: JointConfig, question: bytes) -> Answered[int]:
    """A position as `read_counts` reads it; raises DialogueFailed where the drive is silent."""
    counts = yield from read_counts(question)
    if counts is None:
        raise DialogueFailed(joint, silent_amid(config, "position"))
    return counts


def read_block() -> Answered[Block | None]:
    """The configuration block."""
    return registers.block_of((yield Ask(registers.ASK_BLOCK, (8,), packets=registers.BLOCK_PACKETS)))


def surely(read: Callable[[], Answered[Value | None]]) -> Answered[Value | None]:
    """What two answers in a row tell, for whoever writes it back or decides by it; None where no two agree.

    All of its fields go into the drive again, and a serial line may garble any of them unseen.
    """
    before = None
    for _ in range(SURE_TRIES):
        found = yield from read()
        if found is not None and found == before:
            return found
        before = found
    return None


def read_watchdog() -> Answered[int | None]:
    """The watchdog's time (ms)."""
    return registers.number_of((yield Ask(registers.ASK_WATCHDOG, (6,))), registers.ASK_WATCHDOG, 4)


def set_reports(period_ms: int) -> Answered[bool]:
    """Let the drive send its position by itself, or with 0 no more; False where it refuses, silence is none."""
    answer = yield Ask(registers.report_position(period_ms), tuple(len(a) for a in registers.REPORT_ACCEPTED))
    return answer is None or answer in registers.REPORT_ACCEPTED


def read_homing() -> Answered[HomingParameters | None]:
    """The homing parameters."""
    return registers.homing_of((yield Ask(registers.ASK_HOMING, (8,), packets=registers.HOMING_PACKETS)))


def homing_mark_ms(limit_ms: int, now_ns: int) -> int:
    """A homing time-out just above `limit_ms` (ms) by which a drive is known again after its run.

    No other value of volatile memory is the same but by chance, so one that is there afterwards says that the drive has
    not been switched off and on meanwhile, after which it counts 0 anywhere.
    """
    return limit_ms + 1 + now_ns // 1_000_000 % HOMING_MARKS


def set_homing_timeout(timeout_ms: int) -> Answered[bool]:
    """Let the drive's homing run take so long, in volatile memory only; whether it does."""
    parameters = yield from surely(read_homing)
    if parameters is None:
        return False
    changed = replace(parameters, timeout_ms=timeout_ms)
    yield Ask(registers.write_homing(changed), (3,))
    return (yield from read_homing()) == changed


def has_mark(mark: str | None) -> Answered[bool | None]:
    """Whether the drive still has the homing time-out that `mark` has given it (`drives.power`); None: nobody knows."""
    parameters = None if mark is None else (yield from surely(read_homing))
    return None if parameters is None else str(parameters.timeout_ms) == mark


def mark(now_ns: int) -> Answered[str | None]:
    """Give the drive one, a little above the time-out that it has; None where it takes none, as older firmware may."""
    parameters = yield from surely(read_homing)
    if parameters is None:
        return None
    mark_ms = homing_mark_ms(parameters.timeout_ms - parameters.timeout_ms % 1000, now_ns)
    mark_ms += mark_ms == parameters.timeout_ms  # that may be what it has stored
    return str(mark_ms) if (yield from set_homing_timeout(mark_ms)) else None


def begin_homing() -> Answered[bool]:
    """Let the drive run to its stop; whether it has said, in answers that agree, that it does.

    It is told until then: no acknowledgement is waited for, and a command may be lost.
    """
    for _ in range(TRIES):
        before: tuple[bytes, ...] = (registers.HOME_BY_COLLISION,)
        seen = 0
        for _ in range(LOOKS):
            flags = yield from read_flags(registers.ASK_HOMING_STATUS, before)
            before = ()
            seen = seen + 1 if flags is not None and flags & registers.HOMING else 0
            if seen >= AGREEING:
                return True
    return False
