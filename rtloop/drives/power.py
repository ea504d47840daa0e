"""Proof that a drive has kept its power, so that a silence of the drive did not cost the joint its angle.

Each family proves it in its bring-up in its own way, or not at all. The proof is a mark: something that the drive was
told or has reported, and that it loses with its power. Marks are stored beyond the life of a control process, so that a
crash costs no angle either. Without a proof everything stays as it would be without marks.

| family | its mark |
|---|---|
| ZDT | an odd homing time-out in volatile memory; the flag for lost power (3A bit 7) speaks against it |
| MyActuator | its uptime (B1): longer than the time since the mark, and grown by it |
| CiA 402 | armed (*operation enabled*), since rtarm armed it |
| Damiao | armed (*enabled*), likewise |
| RobStride | armed (*run*), likewise |
| ODrive | none: an axis may be set to close its loop when power comes, and CANSimple does not tell whether it is |
| VESC | none: nothing tells how long it has had power, and a target enables it |
| MKS | none: it keeps every setting without power, and reports no uptime |
| any with an absolute encoder | none is needed; MyActuator's is, before an arm goes on by itself: a target enables it |

A count that begins where the power came gets its angle from a person or a homing run, in each control process. So the
proof of these drives saves an angle over a silence, but not over the end of the process; ZDT's proof does both.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping


class Marks:
    """The mark of each joint's drive, by the joint's number; a drive without a mark proves nothing."""

    def __init__(
        self,
        known: Mapping[int, str] | None = None,
        keep: Callable[[Mapping[int, str]], object] = lambda marks: None,
        unproven: Collection[int] = (),
    ) -> None:
        """`known` are the stored marks; `keep` is called with all marks whenever one changes, and stores them.

        `unproven`: joints whose drive keeps a mark over a loss of power, or takes none (`rtloop.kept.commissioned`).
        Their mark proves nothing, and they get no new one. If such a mark is surely gone, that still speaks against the
        angle.
        """
        self._keep, self._unproven = keep, unproven
        self._marks = dict(known or {})
        self._until_referenced: dict[int, str | None] = {}

    def takes(self, joint: int) -> bool:
        """Whether a mark of the joint's drive would prove anything."""
        return joint not in self._unproven

    def known(self, joint: int) -> str | None:
        """The mark of the joint's drive, whether or not it proves anything."""
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
        """Remove the mark of a drive whose joint's angle is lost; once the joint is referenced, `mark` replaces it."""
        self[joint] = None
        self._until_referenced[joint] = mark

    def borne(self, joint: int) -> str | None:
        """The mark of the joint's drive, or the one that waits until the joint is referenced."""
        return self[joint] or self._until_referenced.get(joint)

    def referenced(self, joint: int) -> None:
        """Set the mark that has waited for the joint's reference: its angle is known again."""
        if joint in self._until_referenced:
            self[joint] = self._until_referenced.pop(joint)
