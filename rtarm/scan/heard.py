"""A drive that was heard on a bus, whether it was asked or has spoken by itself."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Heard:
    """What is known of it.

    Attributes:
        family: its family in an arm file.
        called: what it is, in words.
        number: by which it is told from others of its family.
        state: what it says of itself, in words.
        settings: what an arm file says of it, by the names of its fields.
    """

    family: str
    called: str
    number: int
    state: str
    settings: dict[str, int]


def by_number(heard: Iterable[Heard | None]) -> list[Heard]:
    """Each drive once, as last heard, by family and number."""
    found = {(drive.family, drive.number): drive for drive in heard if drive is not None}
    return [found[key] for key in sorted(found)]
