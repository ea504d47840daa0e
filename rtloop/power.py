"""Proof that a drive has kept its power, so that a silence of it has cost no angle.

Each family proves it in its bring-up in its own way, or not at all: by a mark, which is something that the drive was
told or has said and that a loss of power takes from it. What it was is remembered, also beyond the life of a control
process, so that a crash costs no angle either. What a drive does not prove stays as it would be without all this.

| family | its mark |
|---|---|
| ZDT | an odd homing time-out in volatile memory; the flag for lost power (3A bit 7) speaks against it |
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping


class Marks:
    """The mark of each joint's drive, by the joint's number; a drive without one proves nothing."""

    def __init__(
        self,
        known: Mapping[int, str] | None = None,
        keep: Callable[[Mapping[int, str]], object] = lambda marks: None,
        unproven: Collection[int] = (),
    ) -> None:
        """`known` are those of before, `keep` remembers them all whenever one changes.

        `unproven`: joints whose drive keeps a mark over a loss of power, or takes none (`rtloop.commissioned`).
        """
        self._keep, self._unproven = keep, unproven
        self._marks = {joint: mark for joint, mark in (known or {}).items() if joint not in unproven}

    def __getitem__(self, joint: int) -> str | None:
        return self._marks.get(joint)

    def __setitem__(self, joint: int, mark: str | None) -> None:
        if mark == self[joint] or joint in self._unproven:
            return
        self._marks.pop(joint, None)
        if mark is not None:
            self._marks[joint] = mark
        self._keep(self._marks)
