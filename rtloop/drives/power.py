"""Proof that a drive has kept its power, so that a silence of it has cost no angle.

Each family proves it in its bring-up in its own way, or not at all: by a mark, which is something that the drive was
told or has said and that a loss of power takes from it. What it was is remembered, also beyond the life of a control
process, so that a crash costs no angle either. What a drive does not prove stays as it would be without all this.

| family | its mark |
|---|---|
| ZDT | an odd homing time-out in volatile memory; the flag for lost power (3A bit 7) speaks against it |
| MyActuator | its uptime (B1): longer than the time since the mark, and grown by it |
| CiA 402 | armed (*operation enabled*), since rtarm armed it |
| Damiao | armed (*enabled*), likewise |
| RobStride | armed (*run*), likewise |
| ODrive | none: an axis may be set to close its loop when power comes, and CANSimple does not tell whether it is |
| MKS | none: it keeps whatever it is told, and tells no uptime |
| any with an absolute encoder | none is needed; MyActuator's is, before an arm goes on by itself: a target enables it |

A count that begins where power came is given its angle by a person, or a homing run, in each control process. So what
these drives prove saves an angle from a silence, not from the end of the process that was told it; ZDT's does both.
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

        `unproven`: joints whose drive keeps a mark over a loss of power, or takes none (`rtloop.kept.commissioned`).
        Theirs proves nothing, and they get no other; one that is surely gone speaks against the angle all the same.
        """
        self._keep, self._unproven = keep, unproven
        self._marks = dict(known or {})
        self._until_referenced: dict[int, str | None] = {}

    def takes(self, joint: int) -> bool:
        """Whether a mark of the joint's drive would prove anything."""
        return joint not in self._unproven

    def known(self, joint: int) -> str | None:
        """What the joint's drive was marked with, whether or not that proves anything."""
        return self._marks.get(joint)

    def __getitem__(self, joint: int) -> str | None:
        return self.known(joint) if self.takes(joint) else None

    def __setitem__(self, joint: int, mark: str | None) -> None:
        self._until_referenced.pop(joint, None)
        if mark == self.known(joint) or (mark is not None and not self.takes(joint)):
            return
        self._marks.pop(joint, None)
        if mark is not None:
            self._marks[joint] = mark
        self._keep(self._marks)

    def give_once_referenced(self, joint: int, mark: str | None) -> None:
        """A drive whose joint's angle is lost has no mark, and gets one that speaks for the angle that is said next."""
        self[joint] = None
        self._until_referenced[joint] = mark

    def borne(self, joint: int) -> str | None:
        """What the joint's drive is marked with, also where that waits for a reference."""
        return self[joint] or self._until_referenced.get(joint)

    def referenced(self, joint: int) -> None:
        """The joint's angle is known again."""
        if joint in self._until_referenced:
            self[joint] = self._until_referenced.pop(joint)
