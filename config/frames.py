"""Classic CAN frames as the budget counts them: bits on the bus, characters on an SLCAN line, and whose they are."""

from __future__ import annotations

from dataclasses import dataclass


def check_data_bytes(data_bytes: int) -> None:
    """Raise ValueError for more data than a classic CAN frame has."""
    if not 0 <= data_bytes <= 8:
        raise ValueError(f"a classic CAN frame has 0 to 8 data bytes, not {data_bytes}")


def frame_bits(extended: bool, data_bytes: int) -> int:
    """Bits of a classic CAN data frame with worst-case stuffing and the three bits of interframe space."""
    check_data_bytes(data_bytes)
    return unchecked_frame_bits(extended, data_bytes)


def unchecked_frame_bits(extended: bool, data_bytes: int) -> int:
    """The same without the check, which would bring the interpreter into compiled code."""
    if extended:
        return 67 + 8 * data_bytes + (53 + 8 * data_bytes) // 4
    return 47 + 8 * data_bytes + (33 + 8 * data_bytes) // 4


def slcan_chars(extended: bool, data_bytes: int) -> int:
    """Characters of an SLCAN data frame: letter, identifier, length digit, two a byte, carriage return."""
    check_data_bytes(data_bytes)
    return 1 + (8 if extended else 3) + 1 + 2 * data_bytes + 1


@dataclass(frozen=True)
class CycleFrames:
    """Frames of one kind in one control cycle."""

    what: str
    count: int
    data_bytes: int
    from_host: bool
    extended: bool = True
    remote: bool = False
    """A remote frame asks for data and carries none: `data_bytes` is 0."""

    @property
    def bits(self) -> int:
        """Bits of all of them on the bus."""
        return self.count * frame_bits(self.extended, self.data_bytes)


@dataclass(frozen=True)
class PeriodicFrames:
    """Frames that a drive sends at its own clock, whatever the control cycle does."""

    frames: CycleFrames
    rate_hz: float
    whose: str = "what drives send by themselves"


@dataclass(frozen=True)
class Identifiers:
    """CAN identifiers that a drive uses: all with the bits of `match` where `mask` has ones.

    `shared`: drives of the same family use them together, and what they mean to whom stands in the data.
    `field`: what says them in the drive's section of an arm file, where that is not the drive's number.
    """

    match: int
    mask: int
    extended: bool
    from_drive: bool
    shared: bool = False
    field: str | None = None

    def meets(self, other: Identifiers) -> bool:
        """Whether there is an identifier that belongs to both."""
        return self.extended == other.extended and (self.match ^ other.match) & self.mask & other.mask == 0


ADAPTER_FRAMES = 64
"""Frames that an adapter is taken to hold back: for a bus that is busy, or while nobody on it acknowledges any."""

STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFFFFFF


def standard(
    identifier: int, *, from_drive: bool, mask: int = STANDARD_MASK, shared: bool = False, field: str | None = None
) -> Identifiers:
    """Standard identifiers (11 bits)."""
    return Identifiers(identifier, mask, extended=False, from_drive=from_drive, shared=shared, field=field)


def extended(identifier: int, *, from_drive: bool, mask: int = EXTENDED_MASK, shared: bool = False) -> Identifiers:
    """Extended identifiers (29 bits)."""
    return Identifiers(identifier, mask, extended=True, from_drive=from_drive, shared=shared)
