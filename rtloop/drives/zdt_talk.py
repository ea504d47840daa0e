"""What conversations in ordinary Python say to a ZDT (Emm_V5) drive, and how its answers are read.

Protocol facts: `rtloop.drives.zdt`, and for homing: `9A 02 00 6B` begins a run to the stop that ends at count 0;
`9C 48 6B` ends one; `3B 6B` → `3B flags 6B` with 2 = homing, 3 = failed; `22 6B` reads the homing parameters in three
packets (mode, direction, rpm16, time-out ms32, collision rpm16, mA16, ms16, at power-up), `4C AE store …` writes them.
"""

from collections.abc import Generator
from typing import TypeVar

from rtloop.conversation import Ask

T = TypeVar("T")
Answered = Generator[Ask, bytes | None, T]

ENABLED, PROTECTED, POWER_LOST = 0x01, 0x08, 0x80
"""Flags of `3A`."""
HOMING, HOMING_FAILED = 0x04, 0x08
"""Flags of `3B`."""
ENABLE = b"\xf3\xab\x01\x00\x6b"
RELEASE = b"\xf3\xab\x00\x00\x6b"
CLEAR_PROTECTION = b"\x0e\x52\x6b"
CLEAR_POWER_LOST = b"\x50\x00\x6b"
STOP = b"\xfe\x98\x00\x6b"
HOME_BY_COLLISION = b"\x9a\x02\x00\x6b"
END_HOMING = b"\x9c\x48\x6b"
_HOMING_BYTES = 15
_TIMEOUT = slice(4, 8)


def read_flags(function: int, before: tuple[bytes, ...] = ()) -> Answered[int | None]:
    """The flags of `3A` (status) or `3B` (homing) after commands that leave right before the question.

    None where the drive is silent or does not know the question.
    """
    answer = yield Ask(bytes((function, 0x6B)), (3,), before=before)
    return None if answer is None or answer[0] != function else answer[1]


def read_counts(function: int) -> Answered[int | None]:
    """A position in encoder counts: `36` the measured one, `33` the drive's own target."""
    answer = yield Ask(bytes((function, 0x6B)), (7,))
    if answer is None or len(answer) != 7 or answer[0] != function:
        return None
    magnitude = int.from_bytes(answer[2:6], "big")
    return -magnitude if answer[1] else magnitude


def write_homing_timeout(timeout_ms: int) -> Answered[bool]:
    """Let the drive's homing run take so long, in volatile memory only; whether it does."""
    parameters = yield from _read_homing()
    if parameters is None:
        return False
    changed = parameters[: _TIMEOUT.start] + timeout_ms.to_bytes(4, "big") + parameters[_TIMEOUT.stop :]
    yield Ask(b"\x4c\xae\x00" + changed + b"\x6b", (3,))
    return (yield from read_homing_timeout()) == timeout_ms


def read_homing_timeout() -> Answered[int | None]:
    """How long the drive's homing run may take (ms)."""
    parameters = yield from _read_homing()
    return None if parameters is None else int.from_bytes(parameters[_TIMEOUT], "big")


def _read_homing() -> Answered[bytes | None]:
    answer = yield Ask(b"\x22\x6b", (8,), packets=3)
    if answer is None or len(answer) != 1 + _HOMING_BYTES + 1:
        return None
    return answer[1:-1]
